# SPDX-License-Identifier: Apache-2.0
"""Taut dynamics: n quadrotors on massless inextensible cables with a rigid or point-mass load.

While every cable is taut, vehicle i hangs at p_WB = p_WL + R_WL p_LA - l cable_dir_W. A wrench row
is (total thrust along z_B, body moment) of one vehicle. The constraint gives the tensions; a
negative one is returned as it is: that cable would be slack, and the model no longer holds.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from skyhaul.geometry.kernels import cross, dot, mat_t_vec, mat_vec, quat_derivative, quat_to_R
from skyhaul.geometry.quaternion import quat_rotate
from skyhaul.jit import njit
from skyhaul.model.state import TautState
from skyhaul.model.team import Team, TeamArrays
from skyhaul.types import LOAD_P, LOAD_Q, LOAD_V, LOAD_W, Array, Mask

AnyTeam = Team | TeamArrays


class Accelerations(NamedTuple):
    """What the taut dynamics give."""

    a_WL: Array  # (3,) of the load's centre of mass [m/s^2]
    dw_WL_L: Array  # (3,) [rad/s^2]
    cable_dw_W: Array  # (n, 3) [rad/s^2]
    dw_WB_B: Array  # (n, 3) [rad/s^2]
    tension: Array  # (n,) [N]; negative: the cable would be slack


class TautWork(NamedTuple):
    """Scratch memory of `taut_derivative`, so that it allocates nothing."""

    R: Array  # (3, 3) R_WL
    dir_L: Array  # (n, 3) cable directions, L axes
    lever_L: Array  # (n, 3) p_LA x dir_L, 0 for a point mass
    spin_L: Array  # (n, 3) w x (w x p_LA)
    thrust_W: Array  # (n, 3) [N]
    matrix: Array  # (n, n) of the equations for the tensions
    tension: Array  # (n,) [N]


def accelerations(team: AnyTeam, state: TautState, wrenches: Array) -> Accelerations:
    """Accelerations and tensions of the team.

    With y = (a_WL + g e_3, dw_WL_L), M = diag(m_L, J_L), h_i = (cable_dir_W, p_LA x cable_dir_L):

        M y = - sum_i T_i h_i - (0, w x J_L w)
        l dw_i = dir_i x (a_WA_i + g e_3 - thrust_W_i / m_i)

    Args:
        team: The team.
        state: Its state.
        wrenches: Thrust and body moment of every vehicle, (n, 4) [N, N m].

    Source:    Paper eqs. (1)-(2); Lee, IEEE TCST 26 (2018), eqs. (19)-(23).
    Deviation: The paper's equations are z down, mix axes and leave the tensions open (PAPER_NOTES
        3-5); see `tests/paper/test_dynamics.py`.
    Limits:    No drag, wind or motor lag: those are the plant's.
    """
    arrays, n = arrays_of(team), len(state.cable_dir_W)
    dx, work = np.empty(13 + 13 * n), taut_work(n)
    taut_derivative(arrays, pack(state), _floats(wrenches), work, dx)
    return Accelerations(
        a_WL=dx[LOAD_V],
        dw_WL_L=dx[LOAD_W],
        cable_dw_W=dx[13 + 3 * n : 13 + 6 * n].reshape(n, 3),
        dw_WB_B=dx[13 + 10 * n :].reshape(n, 3),
        tension=work.tension,
    )


def tensions(team: AnyTeam, state: TautState, wrenches: Array) -> Array:
    """Tension of every cable, (n,) [N]; negative where the cable would be slack."""
    return accelerations(team, state, wrenches).tension


def slack_cables(team: AnyTeam, state: TautState, wrenches: Array) -> Mask:
    """Which cables the taut model does not hold for, (n,): their tension is not positive."""
    slack: Mask = ~(tensions(team, state, wrenches) > 0.0)
    return slack


def vehicle_motion(team: AnyTeam, state: TautState) -> tuple[Array, Array]:
    """Positions (n, 3) [m] and velocities (n, 3) [m/s] of the vehicles, from the taut cables."""
    arrays = arrays_of(team)
    length = arrays.length[:, None]
    p_WB = state.p_WL + quat_rotate(state.q_WL, arrays.p_LA) - length * state.cable_dir_W
    hook_v = quat_rotate(state.q_WL, np.cross(state.w_WL_L, arrays.p_LA))
    v_WB = state.v_WL + hook_v - length * np.cross(state.cable_w_W, state.cable_dir_W)
    return p_WB, v_WB


def energy(team: AnyTeam, state: TautState) -> tuple[float, float]:
    """Kinetic energy and potential energy (0 at z = 0) of the team [J]."""
    a = arrays_of(team)
    p_WB, v_WB = vehicle_motion(team, state)
    turning = np.sum(a.J_B * state.w_WB_B**2)
    if a.rigid:
        turning += np.sum(a.J_L * state.w_WL_L**2)
    moving = a.m_L * np.sum(state.v_WL**2) + np.sum(a.m_B[:, None] * v_WB**2)
    height = a.m_L * state.p_WL[2] + np.sum(a.m_B * p_WB[:, 2])
    return float(0.5 * (moving + turning)), float(a.g * height)


def momentum(team: AnyTeam, state: TautState) -> tuple[Array, Array]:
    """Linear momentum (3,) [kg m/s] and angular momentum about W's origin (3,) [N m s], W axes."""
    a = arrays_of(team)
    p_WB, v_WB = vehicle_motion(team, state)
    m_B = a.m_B[:, None]
    linear = a.m_L * state.v_WL + np.sum(m_B * v_WB, axis=0)
    spin = np.sum(quat_rotate(state.q_WB, a.J_B * state.w_WB_B), axis=0)
    if a.rigid:
        spin = spin + quat_rotate(state.q_WL, a.J_L * state.w_WL_L)
    orbit = a.m_L * np.cross(state.p_WL, state.v_WL) + np.sum(m_B * np.cross(p_WB, v_WB), axis=0)
    return linear, orbit + spin


def load_acceleration(team: AnyTeam, load: Array, force_W: Array) -> Array:
    """Acceleration of the load under cable forces: (a_WL, dw_WL_L), (6,) [m/s^2, rad/s^2].

    m_L a = sum_i f_i - m_L g e_3
    J_L dw = sum_i p_LA x R_WL^T f_i - w x J_L w

    Args:
        team: The team.
        load: Load state, (13,).
        force_W: Force of each cable on the load, (n, 3) [N].

    Source:    Paper eqs. (1)-(2), with the cable directions in world axes (PAPER_NOTES 4).
    """
    out = np.empty(6)
    load_acceleration_kernel(arrays_of(team), _floats(load), _floats(force_W), out)
    return out


def load_derivative(team: AnyTeam, load: Array, force_W: Array) -> Array:
    """Time derivative of the load state under cable forces, (13,); see `load_acceleration`."""
    acceleration = load_acceleration(team, load, force_W)
    dx = np.empty(13)
    dx[LOAD_P] = load[LOAD_V]
    dx[LOAD_Q] = quat_derivative(load[LOAD_Q], load[LOAD_W]) if arrays_of(team).rigid else 0.0
    dx[LOAD_V], dx[LOAD_W] = acceleration[:3], acceleration[3:]
    return dx


def pack(state: TautState) -> Array:
    """State as one vector for the kernels, (13 + 13 n,).

    Order: load (13,), cable_dir_W, cable_w_W, q_WB, w_WB_B, each row by row.
    """
    s = state
    load = (s.p_WL, s.q_WL, s.v_WL, s.w_WL_L)
    team = (s.cable_dir_W.ravel(), s.cable_w_W.ravel(), s.q_WB.ravel(), s.w_WB_B.ravel())
    return np.concatenate(load + team, dtype=np.float64)


def unpack(x: Array) -> TautState:
    """Inverse of `pack`."""
    n = (len(x) - 13) // 13
    cable_dir, cable_w, q_WB, w_WB = np.split(x[13:].copy(), (3 * n, 6 * n, 10 * n))
    return TautState(
        p_WL=x[LOAD_P].copy(),
        q_WL=x[LOAD_Q].copy(),
        v_WL=x[LOAD_V].copy(),
        w_WL_L=x[LOAD_W].copy(),
        cable_dir_W=cable_dir.reshape(n, 3),
        cable_w_W=cable_w.reshape(n, 3),
        q_WB=q_WB.reshape(n, 4),
        w_WB_B=w_WB.reshape(n, 3),
    )


def arrays_of(team: AnyTeam) -> TeamArrays:
    """The team as arrays; those of a `Team` are made once and must not be written to."""
    return _cached_arrays(team) if isinstance(team, Team) else team


@lru_cache(maxsize=64)
def _cached_arrays(team: Team) -> TeamArrays:
    return team.arrays()


def _floats(a: Array) -> Array:
    return np.array(a, dtype=np.float64)  # a copy: read-only inputs would compile a second time


@njit
def taut_work(n: int) -> TautWork:
    """Scratch memory for n vehicles."""
    return TautWork(
        np.empty((3, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty((n, n)),
        np.empty(n),
    )


@njit
def taut_derivative(team: TeamArrays, x: Array, wrenches: Array, work: TautWork, dx: Array) -> None:
    """Time derivative of the packed state into `dx`; the tensions stay in `work.tension`."""
    n = team.m_B.shape[0]
    w = (x[10], x[11], x[12])
    gyro = (0.0, 0.0, 0.0)
    if team.rigid:
        gyro = cross(w, (team.J_L[0] * w[0], team.J_L[1] * w[1], team.J_L[2] * w[2]))
    _cable_geometry(team, x, wrenches, work)
    _cable_tensions(team, x, gyro, work)
    _load_rates(team, x, gyro, work, dx)
    for i in range(n):
        _cable_rates(team, x, work, i, dx)
        _attitude_rates(team, x, wrenches, i, dx)


@njit
def _cable_geometry(team: TeamArrays, x: Array, wrenches: Array, work: TautWork) -> None:
    """Cable directions and levers in load axes, thrust vectors in world axes."""
    n = team.m_B.shape[0]
    quat_to_R(x[3:7], work.R)
    w = (x[10], x[11], x[12])
    for i in range(n):
        k, j = 13 + 3 * i, 13 + 6 * n + 4 * i
        c = mat_t_vec(work.R, (x[k], x[k + 1], x[k + 2]))
        work.dir_L[i, 0], work.dir_L[i, 1], work.dir_L[i, 2] = c
        h, s = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if team.rigid:
            h = cross(team.p_LA[i], c)
            s = cross(w, cross(w, team.p_LA[i]))
        work.lever_L[i, 0], work.lever_L[i, 1], work.lever_L[i, 2] = h
        work.spin_L[i, 0], work.spin_L[i, 1], work.spin_L[i, 2] = s
        q0, q1, q2, q3 = x[j], x[j + 1], x[j + 2], x[j + 3]
        work.thrust_W[i, 0] = wrenches[i, 0] * 2.0 * (q1 * q3 + q0 * q2)
        work.thrust_W[i, 1] = wrenches[i, 0] * 2.0 * (q2 * q3 - q0 * q1)
        work.thrust_W[i, 2] = wrenches[i, 0] * (1.0 - 2.0 * (q1 * q1 + q2 * q2))


@njit
def _cable_tensions(
    team: TeamArrays, x: Array, gyro: tuple[float, float, float], work: TautWork
) -> None:
    """Tensions from the constraint: A T = b, A = diag(1 / m_i) + h_i . M^-1 h_j."""
    n = team.m_B.shape[0]
    A, b, J = work.matrix, work.tension, team.J_L
    for i in range(n):
        k, o = 13 + 3 * i, 13 + 3 * n + 3 * i
        u, c, h = work.thrust_W[i], work.dir_L[i], work.lever_L[i]
        along = x[k] * u[0] + x[k + 1] * u[1] + x[k + 2] * u[2]
        w2 = x[o] * x[o] + x[o + 1] * x[o + 1] + x[o + 2] * x[o + 2]
        b[i] = team.length[i] * w2 + dot(c, work.spin_L[i]) - along / team.m_B[i]
        b[i] -= h[0] * gyro[0] / J[0] + h[1] * gyro[1] / J[1] + h[2] * gyro[2] / J[2]
        for j in range(i + 1):
            g = work.lever_L[j]
            A[i, j] = dot(c, work.dir_L[j]) / team.m_L
            A[i, j] += h[0] * g[0] / J[0] + h[1] * g[1] / J[1] + h[2] * g[2] / J[2]
        A[i, i] += 1.0 / team.m_B[i]
    solve_spd(A, b)


@njit
def solve_spd(A: Array, b: Array) -> None:
    """Solve A x = b in place: x replaces b, the Cholesky factor the lower half of A."""
    n = b.shape[0]
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = np.sqrt(s) if i == j else s / A[j, j]
        s = b[i]
        for k in range(i):
            s -= A[i, k] * b[k]
        b[i] = s / A[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= A[k, i] * b[k]
        b[i] = s / A[i, i]


@njit
def _load_rates(
    team: TeamArrays, x: Array, gyro: tuple[float, float, float], work: TautWork, dx: Array
) -> None:
    """Rates of the load state; a point mass does not turn."""
    n = team.m_B.shape[0]
    for c in range(3):
        dx[c] = x[7 + c]
        force, moment = 0.0, -gyro[c]
        for i in range(n):
            force -= work.tension[i] * x[13 + 3 * i + c]
            moment -= work.tension[i] * work.lever_L[i, c]
        dx[7 + c] = force / team.m_L
        dx[10 + c] = moment / team.J_L[c] if team.rigid else 0.0
    dx[9] -= team.g
    dx[3] = dx[4] = dx[5] = dx[6] = 0.0
    if team.rigid:
        dx[3], dx[4], dx[5], dx[6] = quat_derivative(x[3:7], x[10:13])


@njit
def _cable_rates(team: TeamArrays, x: Array, work: TautWork, i: int, dx: Array) -> None:
    """Rates of direction and angular velocity of cable i."""
    n = team.m_B.shape[0]
    k, o = 13 + 3 * i, 13 + 3 * n + 3 * i
    r, s, u = team.p_LA[i], work.spin_L[i], work.thrust_W[i]
    d = (x[k], x[k + 1], x[k + 2])
    t = (0.0, 0.0, 0.0)
    if team.rigid:
        t = cross((dx[10], dx[11], dx[12]), r)
    hook = mat_vec(work.R, (t[0] + s[0], t[1] + s[1], t[2] + s[2]))
    m = team.m_B[i]
    rel = (
        dx[7] + hook[0] - u[0] / m,
        dx[8] + hook[1] - u[1] / m,
        dx[9] + team.g + hook[2] - u[2] / m,
    )
    dd, dw = cross((x[o], x[o + 1], x[o + 2]), d), cross(d, rel)
    for c in range(3):
        dx[k + c] = dd[c]
        dx[o + c] = dw[c] / team.length[i]


@njit
def _attitude_rates(team: TeamArrays, x: Array, wrenches: Array, i: int, dx: Array) -> None:
    """Rates of attitude and angular velocity of vehicle i (Euler's equations)."""
    n = team.m_B.shape[0]
    j, o = 13 + 6 * n + 4 * i, 13 + 10 * n + 3 * i
    J, w = team.J_B[i], (x[o], x[o + 1], x[o + 2])
    gyro = cross(w, (J[0] * w[0], J[1] * w[1], J[2] * w[2]))
    for c in range(3):
        dx[o + c] = (wrenches[i, 1 + c] - gyro[c]) / J[c]
    dx[j], dx[j + 1], dx[j + 2], dx[j + 3] = quat_derivative(x[j : j + 4], w)


@njit
def load_acceleration_kernel(team: TeamArrays, load: Array, force_W: Array, out: Array) -> None:
    """`load_acceleration` for numba, into `out` (6,)."""
    q, w, J = load[3:7], load[10:13], team.J_L
    R = np.empty((3, 3))
    quat_to_R(q, R)
    out[:] = 0.0
    for i in range(force_W.shape[0]):
        moment = cross(team.p_LA[i], mat_t_vec(R, force_W[i]))
        for c in range(3):
            out[c] += force_W[i, c] / team.m_L
            out[3 + c] += moment[c]
    out[2] -= team.g
    gyro = cross(w, (J[0] * w[0], J[1] * w[1], J[2] * w[2]))
    for c in range(3):
        out[3 + c] = (out[3 + c] - gyro[c]) / J[c] if team.rigid else 0.0
