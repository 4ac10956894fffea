# SPDX-License-Identifier: Apache-2.0
"""Tensions that keep the load upright while the cables still turn to where they shall be."""

import numpy as np

from skyhaul.control.vectors import axpy, row, scaled
from skyhaul.geometry.kernels import Vec3Out, cross
from skyhaul.jit import njit
from skyhaul.types import Array

_SWEEPS = 40
_WEAK = 0.02  # weight of horizontal force and yaw moment, and of the change itself


@njit
def make_up_for_direction(
    wanted: tuple[Array, Vec3Out],
    xi: Array,
    arm: Array,
    free: Array,
    reach: tuple[float, float, float],
    out: Array,
) -> None:
    """Change of the tensions that gives most of the wrench that wrong cable directions lose.

    A taut cable gives only the part of its force along itself. What is lost, Delta, is made up for
    by tensions, which are quick, where the cables, which are slow, still turn:

        min |A delta - Delta|_W^2 + rho |delta|^2,  columns of A = (-xi_i, arm_i x -xi_i)
        tension_min <= tension_i + delta_i <= tension_max

    W counts vertical force, roll and pitch moment fully, the rest by 1/50; moments over the radius
    of the hooks. Solved by projected Gauss-Seidel.

    Args:
        wanted: Forces on the load, (n, 3), W axes, 0 for cables that shall not carry [N]; moment
            on the load besides theirs, W axes [N m].
        xi: Directions of the cables, vehicle to load, (n, 3).
        arm: Hooks from the centre of mass, W axes, (n, 3) [m].
        free: 1 for cables that carry and are taut, (n,); of the others all force is lost.
        reach: Smallest and largest tension [N]; radius of the hooks [m], 0 for a point mass.
        out: delta, (n,) [N], written; 0 for the others.

    Source: PAPER_NOTES 33: with one of four cables lost, the load turns over within 0.3 s if
        forces along the old directions are let stand; see
        `test_tensions_hold_the_load_upright_while_a_cable_leans_wrongly`.
    """
    force, moment = wanted
    n = force.shape[0]
    lever = 1.0 / reach[2] if reach[2] > 0.0 else 0.0
    A, lost, tension = np.zeros((n, 6)), np.zeros(6), np.zeros(n)
    out[:] = 0.0
    _add_wrench(lost, (0.0, 0.0, 0.0), moment, lever)
    for i in range(n):
        f, d = row(force, i), row(xi, i)
        if free[i] == 0.0:
            _add_wrench(lost, f, cross(row(arm, i), f), lever)
            continue
        tension[i] = -(f[0] * d[0] + f[1] * d[1] + f[2] * d[2])
        side = axpy(tension[i], d, f)
        _add_wrench(lost, side, cross(row(arm, i), side), lever)
        _add_wrench(A[i], scaled(-1.0, d), cross(row(arm, i), scaled(-1.0, d)), lever)
    if np.max(np.abs(lost)) < 1e-6:
        return
    H, b = np.empty((n, n)), np.empty(n)
    for i in range(n):
        b[i] = _weighted(A[i], lost)
        for j in range(n):
            H[i, j] = _weighted(A[i], A[j]) + (_WEAK if i == j else 0.0)
    for _ in range(_SWEEPS):
        change = 0.0
        for i in range(n):
            if free[i] == 0.0:
                continue
            s = b[i]
            for j in range(n):
                s -= H[i, j] * out[j]
            low, high = min(0.0, reach[0] - tension[i]), max(0.0, reach[1] - tension[i])
            new = min(max(out[i] + s / H[i, i], low), high)
            change = max(change, abs(new - out[i]))
            out[i] = new
        if change < 1e-5:
            break


@njit
def _add_wrench(w: Array, f: Vec3Out, m: Vec3Out, lever: float) -> None:
    for j in range(3):
        w[j] += f[j]
        w[3 + j] += lever * m[j]


@njit
def _weighted(a: Array, b: Array) -> float:
    """Scalar product of two wrenches, weak parts weighted down."""
    weak = a[0] * b[0] + a[1] * b[1] + a[5] * b[5]
    product: float = _WEAK * weak + a[2] * b[2] + a[3] * b[3] + a[4] * b[4]
    return product
