# SPDX-License-Identifier: Apache-2.0
"""Which cable pulls how much: the map P, its null space, and the bounded tension distribution."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skyhaul.control.active_set import add_cut, new_cuts
from skyhaul.control.vectors import across, add, axpy, put, row, scaled, sub
from skyhaul.geometry.kernels import cross, dot, norm
from skyhaul.jit import njit
from skyhaul.params import Params
from skyhaul.types import Array, Mask


@dataclass(frozen=True, kw_only=True)
class AllocationLimits(Params):
    """What the tension distribution keeps, and what it gives up first."""

    cone_deg: float = 50.0
    """Largest angle between a cable and its direction in the formation [deg]."""
    yaw_weight: float = 1e3
    """Cost of yaw moment given up, over that of moving the forces; moments are divided by the
    radius of the hooks."""
    horizontal_weight: float = 3e4
    """Cost of horizontal force given up."""
    tilt_weight: float = 1e6
    """Cost of roll and pitch moment given up."""
    vertical_weight: float = 3e7
    """Cost of vertical force given up."""
    tolerance_n: float = 1e-4
    """Limits may be missed by this [N]."""
    max_cuts: int = 60
    """Largest number of steps of the active-set method."""

    def __post_init__(self) -> None:
        if not 0.0 < self.cone_deg < 85.0:
            raise ValueError(f"cone_deg must lie in (0, 85), got {self.cone_deg}")
        order = (self.yaw_weight, self.horizontal_weight, self.tilt_weight, self.vertical_weight)
        if not (order[0] > 0.0 and order == tuple(sorted(order))):
            raise ValueError(
                f"the weights of yaw, horizontal, tilt, vertical must be > 0 and rise, got {order}"
            )
        if not (self.tolerance_n > 0.0 and self.max_cuts >= 1):
            raise ValueError("tolerance_n must be > 0 and max_cuts >= 1")


class ForceLimits(NamedTuple):
    """Limits on the forces of the carrying cables, all in W axes."""

    axis: Array  # (n, 3) unit direction hook -> vehicle in the formation
    arm: Array  # (n, 3) hooks from the centre of mass [m]
    offset: Array  # (n, 3) thrust needed besides the cable force: |f + offset| is the thrust [N]
    thrust_max: Array  # (n,) [N]
    length: Array  # (n,) [m]
    active: Array  # (n,) 1: the cable carries; 0: its force is left alone
    tension_min: float  # along the axis [N]
    cone_tan: float  # tangent of the cone's half angle
    separation: float  # smallest distance of two vehicles [m]; 0: not limited
    weight: Array  # (6,) of force x y z and moment x y z given up, see `wrench_weights`
    tolerance: float  # [N]


class Allocation(NamedTuple):
    """Outcome of `distribute`; the forces are in its argument."""

    steps: int  # of the active-set method; 0: the wanted forces keep every limit
    kept: bool  # every limit holds within the tolerance


def wrench_map(p_LA: Array, active: Mask | None = None) -> Array:
    """P: cable forces, stacked, to force and moment on the load; forces and hooks in one frame.

    P = [I .. I; hat(r_1) .. hat(r_n)]

    Args:
        p_LA: Hooks from the centre of mass, (n, 3) [m].
        active: Cables that carry, (n,); the columns of the others are zero. Default: all.

    Returns:
        (6, 3n).

    Source: Paper eq. (26), where P is not defined; PAPER_NOTES 15.
    """
    n = len(p_LA)
    P = np.zeros((6, 3 * n))
    for i in range(n):
        if active is None or active[i]:
            x, y, z = p_LA[i]
            P[:3, 3 * i : 3 * i + 3] = np.eye(3)
            P[3:, 3 * i : 3 * i + 3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    return P


def pseudo_inverse(p_LA: Array, active: Mask | None = None) -> Array:
    """P^+: wrench (6,) to the smallest cable forces that give it, (3n, 6)."""
    return np.asarray(np.linalg.pinv(wrench_map(p_LA, active), rcond=1e-9), dtype=np.float64)


def null_space(p_LA: Array, active: Mask | None = None) -> Array:
    """Orthonormal basis of the internal forces: cable forces without wrench, (3n, k)."""
    carries = np.ones(len(p_LA), dtype=np.bool_) if active is None else np.array(active)
    columns = np.flatnonzero(np.repeat(carries, 3))
    _, s, Vt = np.linalg.svd(wrench_map(p_LA)[:, columns])
    rank = int(np.sum(s > 1e-9))
    basis = np.zeros((3 * len(p_LA), len(columns) - rank))
    basis[columns] = Vt[rank:].T
    return basis


def wrench_weights(limits: AllocationLimits, hook_radius_m: float) -> Array:
    """Weights of force x y z [1/N^2] and moment x y z [1/(N m)^2] given up, (6,)."""
    lever2 = max(hook_radius_m, 1e-3) ** 2
    h, t = limits.horizontal_weight, limits.tilt_weight / lever2
    return np.array([h, h, limits.vertical_weight, t, t, limits.yaw_weight / lever2])


@njit
def distribute(f: Array, lim: ForceLimits, max_cuts: int, slack: Array) -> Allocation:
    """Change cable forces as little as the limits ask, and the wrench as little as they force.

    min |f - f_0|^2 + sum_j w_j s_j^2,  s = P (f - f_0)
    tension  axis . f >= t_min            cone  |f across axis| <= tan(cone) axis . f
    thrust   |f + offset| <= thrust_max   distance of any two vehicles >= separation

    The weights rise by 30 each from yaw moment over horizontal force and roll and pitch moment to
    vertical force, which so is given up last. A dual active-set method (Goldfarb and Idnani 1983)
    starts at f_0, which is the optimum without limits. Each step adds the tangent plane of the
    limit that is broken most: exact for the tension, cutting planes for cone and thrust, and the
    linearised distance for the separation.

    Args:
        f: Wanted cable forces f_0, (n, 3), W axes [N]; changed into the result.
        lim: The limits.
        max_cuts: Largest number of steps.
        slack: Wrench given up, P (f - f_0), (6,), force and moment, W axes; written.

    Returns:
        Steps taken and whether every limit is kept; if not, f is the last iterate.

    Source: PAPER_NOTES 15-17, for the paper's minimum-norm eq. (26).
    """
    n = f.shape[0]
    slack[:] = 0.0
    gradient = np.empty((n, 3))
    worst = _worst(f, lim, gradient)
    if worst >= -lim.tolerance:
        return Allocation(0, True)
    wanted = f.copy()
    cuts = new_cuts(lim.arm, lim.weight, lim.active)
    steps, kept = 0, False
    while steps < max_cuts:
        steps += 1
        if not add_cut(cuts, gradient, worst, f):
            break
        worst = _worst(f, lim, gradient)
        if worst >= -lim.tolerance:
            kept = True
            break
    for i in range(n):
        d = sub(row(f, i), row(wanted, i))
        m = cross(row(lim.arm, i), d)
        for j in range(3):
            slack[j] += d[j]
            slack[3 + j] += m[j]
    return Allocation(steps, kept)


@njit
def _worst(f: Array, lim: ForceLimits, gradient: Array) -> float:
    """Value of the limit that is broken most (negative) [N] and its gradient, (n, 3)."""
    worst, kind, at, other = -lim.tolerance, 0, -1, -1
    n = f.shape[0]
    for i in range(n):
        if lim.active[i] == 0.0:
            continue
        fi, a = row(f, i), row(lim.axis, i)
        along = dot(a, fi)
        value = along - lim.tension_min
        if value < worst:
            worst, kind, at = value, 1, i
        value = lim.cone_tan * along - norm(across(fi, a))
        if value < worst:
            worst, kind, at = value, 2, i
        value = lim.thrust_max[i] - norm(add(fi, row(lim.offset, i)))
        if value < worst:
            worst, kind, at = value, 3, i
        if lim.separation > 0.0:
            for k in range(i):
                value = _separation_value(f, lim, i, k)
                if lim.active[k] != 0.0 and value < worst:
                    worst, kind, at, other = value, 4, i, k
    if kind > 0:
        gradient[:] = 0.0
        _gradient(f, lim, kind, at, other, gradient)
    return worst if kind > 0 else 0.0


@njit
def _gradient(f: Array, lim: ForceLimits, kind: int, i: int, k: int, out: Array) -> None:
    """Gradient of one limit into `out`, (n, 3), zero before."""
    fi, a = row(f, i), row(lim.axis, i)
    if kind == 1:
        put(out, i, a)
    elif kind == 2:
        side = across(fi, a)
        put(out, i, axpy(-1.0 / max(norm(side), 1e-9), side, scaled(lim.cone_tan, a)))
    elif kind == 3:
        u = add(fi, row(lim.offset, i))
        put(out, i, scaled(-1.0 / norm(u), u))
    else:
        apart = _apart(f, lim, i, k)
        d = max(norm(apart), 1e-9)
        scale = _newton_per_metre(f, lim, i, k)
        line = scaled(scale / d, apart)
        put(out, i, _turn(line, fi, lim.length[i]))
        put(out, k, scaled(-1.0, _turn(line, row(f, k), lim.length[k])))


@njit
def _apart(f: Array, lim: ForceLimits, i: int, k: int) -> tuple[float, float, float]:
    """Vehicle i from vehicle k, were the cables along their forces [m]."""
    hooks = sub(row(lim.arm, i), row(lim.arm, k))
    fi, fk = row(f, i), row(f, k)
    tip = axpy(lim.length[i] / max(norm(fi), 1e-9), fi, hooks)
    return axpy(-lim.length[k] / max(norm(fk), 1e-9), fk, tip)


@njit
def _newton_per_metre(f: Array, lim: ForceLimits, i: int, k: int) -> float:
    """Force that moves one of two vehicles by a metre, to first order: scales the separation."""
    scale: float = min(norm(row(f, i)) / lim.length[i], norm(row(f, k)) / lim.length[k])
    return scale


@njit
def _separation_value(f: Array, lim: ForceLimits, i: int, k: int) -> float:
    """Distance of two vehicles beyond the separation, as a force [N]."""
    return (norm(_apart(f, lim, i, k)) - lim.separation) * _newton_per_metre(f, lim, i, k)


@njit
def _turn(
    line: tuple[float, float, float], f: tuple[float, float, float], length: float
) -> tuple[float, float, float]:
    """Gradient of line . (length f / |f|) with respect to f."""
    size = max(norm(f), 1e-9)
    return scaled(length / size, across(line, scaled(1.0 / size, f)))
