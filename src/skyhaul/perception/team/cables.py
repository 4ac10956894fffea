# SPDX-License-Identifier: Apache-2.0
"""Cables: what each pulls, which are slack, and what taut cables tell of load and frames.

Newton for vehicle i with specific force s, thrust f along b_3, cable force T xi, drag -c v:

    m R s = f b_3 + T xi - c v   =>   T xi = R (m s - f e_3) + c v

and for the load, forces -T_i xi_i at the hooks r_i:

    m_L R_L s_L = -sum T_i xi_i - c_L v_L,   J dw + w x J w = sum r_i x R_L^T (-T_i xi_i)
"""

import numpy as np

from skyhaul.geometry.kernels import (
    Vec3Out,
    cross,
    dot,
    mat_t_vec,
    mat_vec,
    norm,
    quat_exp,
    quat_inv_rotate,
    quat_rotate,
)
from skyhaul.jit import njit
from skyhaul.perception.team.kalman import update
from skyhaul.perception.team.layout import LOAD_NE, VEHICLE_NE, FilterParams, FilterState
from skyhaul.perception.team.motion import in_team_frame, three
from skyhaul.perception.team.sights import apply
from skyhaul.types import Array, Mask

_FLYING_M = 0.05
"""A body this much above the place where it stood touches the floor no more [m]."""
_CLEARLY_SLACK_M = 0.1
"""A cable is slack whose hook is nearer than it is long by this [m]."""


@njit
def cable_force(m: float, R_s: Vec3Out, thrust: Vec3Out, drag: Vec3Out) -> Vec3Out:
    """T xi = R (m s - f e_3) + c v, W axes [N].

    Args:
        m: Mass of the vehicle [kg].
        R_s: Specific force at its centre of mass, W axes [m/s^2].
        thrust: f b_3, W axes [N].
        drag: c v, W axes [N].
    """
    return (
        m * R_s[0] - thrust[0] + drag[0],
        m * R_s[1] - thrust[1] + drag[1],
        m * R_s[2] - thrust[2] + drag[2],
    )


@njit
def cable_line(
    p: FilterParams, load: Array, vehicle: Array, i: int
) -> tuple[Vec3Out, Vec3Out, Vec3Out]:
    """From vehicle i's centre of mass to its hook, W axes [m].

    Returns:
        The line; the hook from the load's IMU, and the vehicle's centre of mass from its own IMU,
        both W axes.
    """
    r = p.hook_L[i]
    arm = quat_rotate(load[3:7], (r[0] - p.p_LI[0], r[1] - p.p_LI[1], r[2] - p.p_LI[2]))
    back = mat_t_vec(p.R_BI, (-p.p_BI[0], -p.p_BI[1], -p.p_BI[2]))
    own = quat_rotate(vehicle[3:7], back)
    line = (
        load[0] + arm[0] - vehicle[0] - own[0],
        load[1] + arm[1] - vehicle[1] - own[1],
        load[2] + arm[2] - vehicle[2] - own[2],
    )
    return line, arm, own


@njit
def force_at_rest(p: FilterParams, s: FilterState, i: int) -> None:
    """Specific force of a vehicle at rest, before its first sample, into `nav_last[6:9]`."""
    s_B = mat_vec(p.R_BI, quat_inv_rotate(s.nav[i, 3:7], (0.0, 0.0, p.g)))
    for c in range(3):
        s.nav_last[i, 6 + c] = s_B[c]


@njit
def force_now(p: FilterParams, s: FilterState, i: int) -> Vec3Out:
    """Cable force of vehicle i, its bias included, in its odometry's axes [N]."""
    x, last, c = s.nav[i], s.nav_last[i], p.drag[0]
    R_s = quat_rotate(x[3:7], mat_t_vec(p.R_BI, three(last, 6)))
    thrust = quat_rotate(x[3:7], mat_t_vec(p.R_BI, (0.0, 0.0, last[9])))
    return cable_force(p.mass[i], R_s, thrust, (c * x[7], c * x[8], c * x[9]))


@njit
def unbiased(p: FilterParams, s: FilterState, i: int, force: Vec3Out) -> Vec3Out:
    """A force in the axes of vehicle i's odometry to W axes, less its bias [N]."""
    o = s.offset[i]
    b = quat_rotate(s.nav[i, 3:7], mat_t_vec(p.R_BI, three(o, 6)))
    turn = quat_exp((o[3], o[4], o[5]))
    return quat_rotate(turn, (force[0] - b[0], force[1] - b[1], force[2] - b[2]))


@njit
def gather(p: FilterParams, s: FilterState, load: Array, i: int) -> None:
    """Add this tick's cable force and direction of vehicle i to its windows."""
    vehicle = in_team_frame(s, i, s.nav[i])
    line, _, own = cable_line(p, load, vehicle, i)
    F, size = force_now(p, s, i), max(norm(line), 1e-9)
    for c in range(3):
        s.window[i, c] += F[c]
        s.window[i, 3 + c] += line[c] / size
        s.balance[i, c] += F[c]
    s.window[i, 6] += 1.0
    s.balance[i, 3] += 1.0
    height = vehicle[2] + own[2]
    if s.taut[i, 2] == -1e9:
        s.taut[i, 2] = height
    s.window[i, 7] = 1.0 if height > s.taut[i, 2] + _FLYING_M else 0.0


@njit
def judge_slack(p: FilterParams, s: FilterState, load: Array, i: int, attached: bool) -> float:
    """Tension of cable i now [N], 0 while it is slack; moves the filtered one and the verdict.

    Slack below `slack_force`, taut above `taut_force`, unchanged between. Where the hook is nearer
    than the cable is long by `slack_length`, it takes three times the force, and where it is nearer
    by 0.1 m no force will do.
    """
    vehicle = in_team_frame(s, i, s.nav[i])
    line, _, _ = cable_line(p, load, vehicle, i)
    size = max(norm(line), 1e-9)
    pull = dot(unbiased(p, s, i, force_now(p, s, i)), line) / size
    state = s.taut[i]
    state[1] += (0.3 if s.head[i] > 0.0 else 1.0) * (pull - state[1])
    near, clear = size < p.length[i] - p.slack_length, size < p.length[i] - _CLEARLY_SLACK_M
    weak = state[1] < (3.0 * p.taut_force if near else p.slack_force)
    if not attached or clear or weak:
        state[0] = 0.0
    elif state[1] > p.taut_force:
        state[0] = 1.0
    return max(0.0, pull) if state[0] > 0.0 else 0.0


@njit
def correct_by_cable(p: FilterParams, s: FilterState, load: Array, i: int, attached: bool) -> None:
    """Close vehicle i's window: length and direction of a taut cable, no force in a slack one."""
    w, N = s.window[i], s.P.shape[0]
    count = w[6]
    if attached and count > 0.0 and s.vio[i, 3] >= 0.0:
        vehicle = in_team_frame(s, i, s.nav[i])
        line, arm, own = cable_line(p, load, vehicle, i)
        F = unbiased(p, s, i, (w[0] / count, w[1] / count, w[2] / count))
        size = norm(line)
        H, r, variance = np.zeros((3, N)), np.zeros(3), np.empty(3)
        if s.taut[i, 0] > 0.0 or size > p.length[i]:
            _length_row(p, load, (line, arm, own), i, H, r, variance)
            _take(s, H[:1], r[:1], variance[:1])
        if s.taut[i, 0] > 0.0 and norm(F) > p.taut_force:
            mean = (w[3] / count, w[4] / count, w[5] / count)
            _direction_rows(p, s, load, (line, arm, own), mean, F, i, H, r, variance)
            _take(s, H[:2], r[:2], variance[:2])
        elif size < p.length[i] - _CLEARLY_SLACK_M and w[7] > 0.0:
            _force_rows(p, s, F, i, H, r, variance)
            _take(s, H, r, variance)
    for c in range(8):
        w[c] = 0.0


@njit
def _take(s: FilterState, H: Array, r: Array, variance: Array) -> None:
    dx = np.empty(s.P.shape[0])
    if update(s.P, H, r, variance, dx):
        apply(s, dx)
    else:
        s.tally[3] += 1.0


@njit
def _line_row(
    load: Array, parts: tuple[Vec3Out, Vec3Out, Vec3Out], g: Vec3Out, i: int, h: Array
) -> None:
    """Derivative of g . line by the error of the state into `h`, (N,)."""
    _, arm, own = parts
    b = LOAD_NE + VEHICLE_NE * i
    in_load = quat_inv_rotate(load[3:7], g)
    by_turn = cross(quat_inv_rotate(load[3:7], arm), in_load)
    by_frame = cross(own, g)  # g . -(dturn x own)
    for a in range(3):
        h[a] = g[a]
        h[3 + a] = by_turn[a]
        h[b + a] = -g[a]
        h[b + 3 + a] = -by_frame[a]


@njit
def _length_row(
    p: FilterParams,
    load: Array,
    parts: tuple[Vec3Out, Vec3Out, Vec3Out],
    i: int,
    H: Array,
    r: Array,
    variance: Array,
) -> None:
    line = parts[0]
    size = norm(line)
    _line_row(load, parts, (line[0] / size, line[1] / size, line[2] / size), i, H[0])
    r[0], variance[0] = p.length[i] - size, p.sigma_length**2


@njit
def _direction_rows(
    p: FilterParams,
    s: FilterState,
    load: Array,
    parts: tuple[Vec3Out, Vec3Out, Vec3Out],
    mean: Vec3Out,
    F: Vec3Out,
    i: int,
    H: Array,
    r: Array,
    variance: Array,
) -> None:
    """Direction of the mean cable force against the mean line, two rows across it."""
    size, pull = norm(parts[0]), norm(F)
    scale = 1.0 / norm(mean)
    n = (scale * mean[0], scale * mean[1], scale * mean[2])
    e = (0.0, 0.0, 1.0) if abs(n[2]) < 0.7 else (1.0, 0.0, 0.0)
    side = cross(n, e)
    scale = 1.0 / norm(side)
    side = (scale * side[0], scale * side[1], scale * side[2])
    b, H[:] = LOAD_NE + VEHICLE_NE * i, 0.0
    for k in range(2):
        g = side if k == 0 else cross(n, side)
        r[k] = dot(F, g) / pull  # what the line lacks
        _line_row(load, parts, (g[0] / size, g[1] / size, g[2] / size), i, H[k])
        by_frame = cross(F, g)  # g . (dturn x F) = dturn . (F x g)
        by_bias = quat_inv_rotate(in_team_frame(s, i, s.nav[i])[3:7], g)
        for a in range(3):
            H[k, b + 3 + a] -= by_frame[a] / pull
        _bias_part(p, by_bias, 1.0 / pull, H[k], b)
        variance[k] = p.sigma_direction**2 + (0.3 * p.sigma_force / pull) ** 2


@njit
def _bias_part(p: FilterParams, g_I: Vec3Out, factor: float, h: Array, b: int) -> None:
    """Add factor g . R_WB d(bias), g in the axes of the vehicle's IMU, to a row."""
    for a in range(3):
        h[b + 6 + a] += factor * (
            p.R_BI[a, 0] * g_I[0] + p.R_BI[a, 1] * g_I[1] + p.R_BI[a, 2] * g_I[2]
        )


@njit
def _force_rows(
    p: FilterParams, s: FilterState, F: Vec3Out, i: int, H: Array, r: Array, variance: Array
) -> None:
    """A vehicle that flies with a slack cable: the force left over is its bias."""
    b, q, H[:] = LOAD_NE + VEHICLE_NE * i, in_team_frame(s, i, s.nav[i])[3:7], 0.0
    for k in range(3):
        g = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
        r[k], variance[k] = F[k], p.sigma_force**2
        _bias_part(p, quat_inv_rotate(q, g), 1.0, H[k], b)
        by_frame = cross(F, g)
        for a in range(3):
            H[k, b + 3 + a] = -by_frame[a]


@njit
def add_balance(p: FilterParams, s: FilterState, attached: Mask) -> None:
    """Add what the load's last sample leaves over of forces and moments to `sums`; see above."""
    x, last = s.load, s.load_last
    w, dw, f = three(last, 0), three(last, 6), three(last, 3)
    r = (p.p_LI[0], p.p_LI[1], p.p_LI[2])
    lever, swing = cross(dw, r), cross(w, cross(w, r))
    J = p.load_J
    Jw, Jdw = (J[0] * w[0], J[1] * w[1], J[2] * w[2]), (J[0] * dw[0], J[1] * dw[1], J[2] * dw[2])
    gyro = cross(w, Jw)
    at = (f[0] - lever[0] - swing[0], f[1] - lever[1] - swing[1], f[2] - lever[2] - swing[2])
    at_W = quat_rotate(x[3:7], at)
    for c in range(3):
        s.sums[c] += p.load_mass * at_W[c] + p.drag[1] * x[7 + c]
        s.sums[3 + c] += Jdw[c] + gyro[c]
    for i in range(p.mass.shape[0]):
        b = s.balance[i]
        if attached[i] and s.taut[i, 0] > 0.0 and b[3] > 0.0:
            F = unbiased(p, s, i, (b[0] / b[3], b[1] / b[3], b[2] / b[3]))
            M = cross(three(p.hook_L[i], 0), quat_inv_rotate(x[3:7], F))
            for c in range(3):
                s.sums[c] += F[c]
                s.sums[3 + c] += M[c]
        for c in range(4):
            b[c] = 0.0
    s.sums[6] += 1.0


@njit
def correct_by_balance(p: FilterParams, s: FilterState, attached: Mask) -> None:
    """The load's acceleration is that of the cables' forces: six rows, while it hangs."""
    count = s.sums[6]
    hangs = s.load[2] > s.load_us[1] + _FLYING_M
    if count > 0.0 and hangs:
        H, r, variance = np.zeros((6, s.P.shape[0])), np.empty(6), np.empty(6)
        for k in range(6):
            r[k] = -s.sums[k] / count
            variance[k] = p.sigma_force**2 if k < 3 else p.sigma_moment**2
        for i in range(p.mass.shape[0]):
            if attached[i] and s.taut[i, 0] > 0.0:
                _balance_part(p, s, i, H)
        for k in range(3):
            g = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
            by_bias = quat_inv_rotate(s.load[3:7], g)
            by_turn = cross(three(s.load_last, 3), by_bias)
            for a in range(3):
                H[k, 12 + a] = -p.load_mass * by_bias[a]
                H[k, 3 + a] += p.load_mass * by_turn[a]
        _take(s, H, r, variance)
    for c in range(7):
        s.sums[c] = 0.0


@njit
def _balance_part(p: FilterParams, s: FilterState, i: int, H: Array) -> None:
    """Derivatives of the sums by what cable i's force depends on."""
    b, q_L = LOAD_NE + VEHICLE_NE * i, s.load[3:7]
    q = in_team_frame(s, i, s.nav[i])[3:7]
    F, hook = unbiased(p, s, i, force_now(p, s, i)), three(p.hook_L[i], 0)
    F_L = quat_inv_rotate(q_L, F)
    for k in range(3):
        e = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
        # moment k: e . (hook x R_L^T F) = (e x hook) . R_L^T F
        g_L = cross(e, hook)
        g = quat_rotate(q_L, g_L)
        by_turn = cross(g_L, F_L)  # g_L . (F_L x dtheta) = (g_L x F_L) . dtheta
        force_turn, moment_turn = cross(F, e), cross(F, g)
        _bias_part(p, quat_inv_rotate(q, e), -1.0, H[k], b)
        _bias_part(p, quat_inv_rotate(q, g), -1.0, H[3 + k], b)
        for a in range(3):
            H[k, b + 3 + a] += force_turn[a]
            H[3 + k, b + 3 + a] += moment_turn[a]
            H[3 + k, 3 + a] += by_turn[a]


@njit
def rest(p: FilterParams, s: FilterState, dt: float) -> bool:
    """Whether the load stands: for 0.2 s no pull, no rate, no force but the floor's."""
    pull = 0.0
    for i in range(p.mass.shape[0]):
        pull += max(0.0, s.taut[i, 1]) if s.taut[i, 0] > 0.0 else 0.0
    force, rate = norm(three(s.load_last, 3)), norm(three(s.load_last, 0))
    still = pull < 0.3 * p.load_mass * p.g and rate < 0.05 and abs(force - p.g) < 0.4
    s.load_us[2] = s.load_us[2] + dt if still else 0.0
    stands: bool = s.load_us[2] > 0.2
    return stands


@njit
def correct_at_rest(s: FilterState) -> None:
    """A load at rest has no velocity and no rate: six rows."""
    H, r = np.zeros((6, s.P.shape[0])), np.empty(6)
    for c in range(3):
        H[c, 6 + c], H[3 + c, 9 + c] = 1.0, 1.0
        r[c], r[3 + c] = -s.load[7 + c], s.load_last[c]
    _take(s, H, r, np.array([1e-4, 1e-4, 1e-4, 2.5e-5, 2.5e-5, 2.5e-5]))
    s.load_us[1] = s.load[2]
