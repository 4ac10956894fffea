# SPDX-License-Identifier: Apache-2.0
"""Differential flatness: the motion of the load and the internal forces fix everything else."""

from typing import NamedTuple

import numpy as np

from skyhaul.geometry.kernels import R_to_quat, norm
from skyhaul.jit import njit
from skyhaul.model.dynamics import arrays_of
from skyhaul.model.formation import Formation, formation, formation_forces
from skyhaul.model.jets import (
    factorials,
    jet_body_rate,
    jet_cross,
    jet_euler,
    jet_heading,
    jet_mat_t_vec,
    jet_mat_vec,
    jet_rate,
    jet_unit,
)
from skyhaul.model.team import Team, TeamArrays
from skyhaul.types import Array, Mask

__all__ = ["FlatOutputs", "attitude_jet", "flat_outputs", "formation_forces"]


class FlatOutputs(NamedTuple):
    """What the load's motion asks of cables and vehicles at k times.

    Rows of cables that do not carry are nan; their forces are 0.
    """

    w_WL_L: Array  # (k, 3) of the load [rad/s]
    dw_WL_L: Array  # (k, 3) [rad/s^2]
    force_W: Array  # (k, 5, n, 3) force of each cable on the load, derivatives 0..4 [N, N/s, ...]
    cable_dir_W: Array  # (k, 5, n, 3) derivatives 0..4
    cable_w_W: Array  # (k, n, 3) [rad/s]
    cable_dw_W: Array  # (k, n, 3) [rad/s^2]
    p_WB: Array  # (k, 5, n, 3) positions of the vehicles, derivatives 0..4 [m, m/s, ...]
    thrust_W: Array  # (k, n, 3) thrust as a vector [N]
    q_WB: Array  # (k, n, 4)
    w_WB_B: Array  # (k, n, 3) [rad/s]
    dw_WB_B: Array  # (k, n, 3) [rad/s^2]
    wrench: Array  # (k, n, 4) thrust and body moment, as `step` takes them [N, N m]


def flat_outputs(
    team: Team, p_WD: Array, R_WD: Array, yaw: Array, active: Mask | None = None
) -> FlatOutputs:
    """Cables, vehicles and their inputs along a motion of the load.

    f = R (internal + P^+ (m R^T (a + g e_3), J dw + w x J w))
    cable_dir = -f / |f|;  p_WB = p_WL + R p_LA - l cable_dir
    thrust z_B = m_B (ddp_WB + g e_3) + f;  y_B = z_B x heading / |..|;  tau = J dw + w x J w

    Args:
        team: The team.
        p_WD: Derivatives 0..6 of the load's position, (k, 7, 3) [m, m/s, ...].
        R_WD: Derivatives 0..6 of its rotation matrix, (k, 7, 3, 3); not read for a point mass.
        yaw: Derivatives 0..2 of the vehicles' heading, (k, n, 3) or (n, 3) [rad, rad/s, ...].
        active: Cables that carry, (n,); default all.

    Returns:
        Everything at these times. One time may come without its axis k and so returns.

    Source:    Sreenath, Kumar, RSS 2013; Lee, IEEE TCST 26 (2018). The paper's eqs. (26)-(29)
        need these feed-forward terms and do not give them (PAPER_NOTES 19, 20).
    Limits:    Every cable force and thrust must be non-zero, else nan. A rigid load needs three
        hooks that are not on one line.
    """
    n = team.count
    p = _series(p_WD, (7, 3))
    R = _series(R_WD if team.payload.kind == "rigid" else _LEVEL, (7, 3, 3))
    heading = np.moveaxis(np.broadcast_to(yaw, (len(p), n, 3)), -1, 1)
    out = _empty_outputs(len(p), n)
    R = np.array(np.broadcast_to(R, (len(p), 7, 3, 3)))
    _flat_kernel(arrays_of(team), formation(team, active), p, R, _series(heading, (3, n)), out)
    for a in (out.force_W, out.cable_dir_W, out.p_WB):
        a *= factorials(a[0])
    return FlatOutputs(*(a[0] for a in out)) if np.ndim(p_WD) == 2 else out


_LEVEL = np.concatenate([np.eye(3)[None], np.zeros((6, 3, 3))])


def _series(derivatives: Array, shape: tuple[int, ...]) -> Array:
    """Jets from derivatives at k times, (k, *shape)."""
    d = np.asarray(derivatives, dtype=np.float64).reshape(-1, *shape)
    return np.ascontiguousarray(d / factorials(d[0]))


def _empty_outputs(k: int, n: int) -> FlatOutputs:
    shapes = [(k, 3), (k, 3), (k, 5, n, 3), (k, 5, n, 3), (k, n, 3), (k, n, 3), (k, 5, n, 3)]
    shapes += [(k, n, 3), (k, n, 4), (k, n, 3), (k, n, 3), (k, n, 4)]
    out = FlatOutputs(*(np.full(s, np.nan) for s in shapes))
    out.force_W[:] = 0.0
    return out


@njit
def _flat_kernel(
    team: TeamArrays, form: Formation, p_WD: Array, R_WD: Array, yaw: Array, out: FlatOutputs
) -> None:
    """`flat_outputs` of jets: p (k, 7, 3), R (k, 7, 3, 3), yaw (k, 3, n); jets into `out`."""
    for t in range(p_WD.shape[0]):
        p, R = p_WD[t], R_WD[t]
        wrench = _wrench_jet(team, p, R, out.w_WL_L[t], out.dw_WL_L[t])
        for i in range(team.m_B.shape[0]):
            if form.active[i]:
                f = _force_jet(form, i, R, wrench)
                x = _cable(team, i, p, R, f, t, out)
                _vehicle(team, i, x, f, yaw[t], t, out)


@njit
def _wrench_jet(team: TeamArrays, p: Array, R: Array, w0: Array, dw0: Array) -> Array:
    """Jet of force and moment that the cables must give, L axes, (5, 6); rates into w0, dw0."""
    out = np.empty((5, 6))
    a = jet_rate(jet_rate(p))
    a[0, 2] += team.g
    F = jet_mat_t_vec(R, a)
    w = jet_body_rate(R)
    M = jet_euler(team.J_L, w)
    for c in range(3):
        for k in range(5):
            out[k, c], out[k, 3 + c] = team.m_L * F[k, c], M[k, c]
        w0[c], dw0[c] = w[0, c], w[1, c]
    return out


@njit
def _force_jet(form: Formation, i: int, R: Array, wrench: Array) -> Array:
    """Jet of the force of cable i on the load, W axes, (5, 3)."""
    f = np.zeros((5, 3))
    for r in range(3):
        f[0, r] = form.internal_L[i, r]
        for k in range(5):
            for c in range(6):
                f[k, r] += form.pinv_L[i, r, c] * wrench[k, c]
    return jet_mat_vec(R, f)


@njit
def _cable(
    team: TeamArrays, i: int, p: Array, R: Array, f: Array, t: int, out: FlatOutputs
) -> Array:
    """Cable i from its force; returns the jet of its vehicle's position, (5, 3)."""
    toward, x, r = jet_unit(f), np.empty((5, 3)), team.p_LA[i]
    for k in range(5):
        for c in range(3):
            hook = R[k, c, 0] * r[0] + R[k, c, 1] * r[1] + R[k, c, 2] * r[2]
            x[k, c] = p[k, c] + hook + team.length[i] * toward[k, c]
            out.force_W[t, k, i, c] = f[k, c]
            out.cable_dir_W[t, k, i, c] = -toward[k, c]
            out.p_WB[t, k, i, c] = x[k, c]
    w = jet_cross(toward, jet_rate(toward))  # the two signs cancel
    for c in range(3):
        out.cable_w_W[t, i, c], out.cable_dw_W[t, i, c] = w[0, c], w[1, c]
    return x


@njit
def _vehicle(
    team: TeamArrays, i: int, x: Array, f: Array, yaw: Array, t: int, out: FlatOutputs
) -> None:
    """Thrust, attitude, rates and moment of vehicle i along the jet x of its position."""
    u, angle = jet_rate(jet_rate(x)), np.empty(3)
    u[0, 2] += team.g
    for k in range(3):
        angle[k] = yaw[k, i]
        for c in range(3):
            u[k, c] = team.m_B[i] * u[k, c] + f[k, c]
    R = attitude_jet(u, angle)
    w, q = jet_body_rate(R), R_to_quat(R[0])
    M = jet_euler(team.J_B[i], w)
    out.wrench[t, i, 0] = norm(u[0])
    out.q_WB[t, i, 0] = q[0]
    for c in range(3):
        out.q_WB[t, i, 1 + c], out.thrust_W[t, i, c] = q[1 + c], u[0, c]
        out.w_WB_B[t, i, c], out.dw_WB_B[t, i, c] = w[0, c], w[1, c]
        out.wrench[t, i, 1 + c] = M[0, c]


@njit
def attitude_jet(u: Array, yaw: Array) -> Array:
    """Jet of the attitude whose z axis is along u and whose y axis is normal to the heading.

    Args:
        u: Jet of the thrust vector, (K, 3), W axes.
        yaw: Jet of the heading, (K,) [rad].

    Returns:
        Jet of R_WB, (K, 3, 3); nan where u is along the heading or zero.
    """
    z = jet_unit(u)
    y = jet_unit(jet_cross(z, jet_heading(yaw)))
    x = jet_cross(y, z)
    out = np.empty((z.shape[0], 3, 3))
    for k in range(z.shape[0]):
        for r in range(3):
            out[k, r, 0], out[k, r, 1], out[k, r, 2] = x[k, r], y[k, r], z[k, r]
    return out
