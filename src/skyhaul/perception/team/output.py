# SPDX-License-Identifier: Apache-2.0
"""From the filter's state to what the stages after it take: load, vehicles, cables, covariance."""

from typing import NamedTuple

import numpy as np

from skyhaul.geometry.kernels import cross, mat_t_vec, norm, quat_rotate, quat_to_R
from skyhaul.jit import njit
from skyhaul.perception.team.cables import cable_line, judge_slack
from skyhaul.perception.team.layout import FilterParams, FilterState
from skyhaul.perception.team.motion import in_team_frame, load_at, load_rate, three
from skyhaul.types import LOAD_NE, Array, Mask


class Output(NamedTuple):
    """Fields of `TeamState` and `CableState`, same names, and the covariance."""

    load: Array  # (13,) layout of `types.LOAD_P`
    p_WB: Array  # (n, 3)
    q_WB: Array  # (n, 4)
    v_WB: Array  # (n, 3)
    w_WB_B: Array  # (n, 3)
    dir_W: Array  # (n, 3)
    w_W: Array  # (n, 3)
    tension: Array  # (n,)
    length: Array  # (n,)
    covariance: Array  # (12, 12)


@njit
def blank(n: int) -> Output:
    """Arrays for n vehicles."""
    return Output(
        np.empty(13), np.empty((n, 3)), np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3)),
        np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty(n),
        np.empty((LOAD_NE, LOAD_NE)),
    )  # fmt: skip


@njit
def read_out(p: FilterParams, s: FilterState, t_us: float, attached: Mask) -> Output:
    """Everything now; moves the verdict on which cables are slack."""
    n = p.mass.shape[0]
    out = blank(n)
    dt = 1e-6 * (t_us - s.load_us[0])
    x, w = load_at(p, s, t_us), load_rate(p, s, dt)
    back = quat_rotate(x[3:7], (-p.p_LI[0], -p.p_LI[1], -p.p_LI[2]))
    spin = quat_rotate(x[3:7], w)
    swing = cross(spin, back)
    for c in range(3):
        out.load[c], out.load[7 + c], out.load[10 + c] = x[c] + back[c], x[7 + c] + swing[c], w[c]
    for c in range(4):
        out.load[3 + c] = x[3 + c]
    for i in range(n):
        out.tension[i] = judge_slack(p, s, x, i, attached[i])
        _vehicle(p, s, i, out)
        _cable(p, s, x, spin, i, attached[i], out)
    _covariance(p, s, x, w, dt, out.covariance)
    return out


@njit
def _vehicle(p: FilterParams, s: FilterState, i: int, out: Output) -> None:
    """Centre of mass, attitude and motion of vehicle i from those of its IMU."""
    y = in_team_frame(s, i, s.nav[i])
    R_WI = np.empty((3, 3))
    quat_to_R(y[3:7], R_WI)
    w_B = three(s.nav_last[i], 0)
    arm = mat_t_vec(p.R_BI, (-p.p_BI[0], -p.p_BI[1], -p.p_BI[2]))
    own = quat_rotate(y[3:7], arm)
    spin = quat_rotate(y[3:7], mat_t_vec(p.R_BI, w_B))
    swing = cross(spin, own)
    for c in range(3):
        out.p_WB[i, c], out.v_WB[i, c] = y[c] + own[c], y[7 + c] + swing[c]
        out.w_WB_B[i, c] = w_B[c]
    _times_conjugate(y[3:7], p.q_BI, out.q_WB[i])


@njit
def _times_conjugate(a: Array, b: Array, out: Array) -> None:
    """A (x) b^-1 into `out`, (4,)."""
    w, x, y, z = b[0], -b[1], -b[2], -b[3]
    out[0] = a[0] * w - a[1] * x - a[2] * y - a[3] * z
    out[1] = a[0] * x + a[1] * w + a[2] * z - a[3] * y
    out[2] = a[0] * y - a[1] * z + a[2] * w + a[3] * x
    out[3] = a[0] * z + a[1] * y - a[2] * x + a[3] * w


@njit
def _cable(
    p: FilterParams,
    s: FilterState,
    x: Array,
    spin: tuple[float, float, float],
    i: int,
    attached: bool,
    out: Output,
) -> None:
    """Direction, rate and length of cable i: xi = line / l, w = xi x d(line) / l.

    A taut cable is as long as it is, a slack one no longer: the line is known to millimetres, the
    verdict is surer.
    """
    line, arm, _ = cable_line(p, x, in_team_frame(s, i, s.nav[i]), i)
    size = max(norm(line), 1e-9)
    v = cross(spin, arm)
    xi = (line[0] / size, line[1] / size, line[2] / size)
    rate = cross(
        xi,
        (
            (x[7] + v[0] - out.v_WB[i, 0]) / size,
            (x[8] + v[1] - out.v_WB[i, 1]) / size,
            (x[9] + v[2] - out.v_WB[i, 2]) / size,
        ),
    )
    taut, most = s.taut[i, 0] > 0.0, p.length[i] if attached else np.inf
    out.length[i] = p.length[i] if taut else min(size, most)
    for c in range(3):
        out.dir_W[i, c], out.w_W[i, c] = xi[c], rate[c]


@njit
def _covariance(
    p: FilterParams,
    s: FilterState,
    x: Array,
    w: tuple[float, float, float],
    dt: float,
    out: Array,
) -> None:
    """Covariance of the load's error, layout of `types.ERR_P`.

    p_L = p_I - R r, v_L = v_I - R (w x r), w = gyro - bias: the errors of p, turn, v and w are
    those of the state times A, and the gyro's noise.
    """
    A = np.zeros((LOAD_NE, 12))
    r = (p.p_LI[0], p.p_LI[1], p.p_LI[2])
    wr = cross(w, r)
    for j in range(3):
        e = (1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0)
        turn_p = quat_rotate(x[3:7], cross(r, e))  # -R (e x r)
        turn_v = quat_rotate(x[3:7], cross(wr, e))
        A[j, j], A[3 + j, 3 + j], A[6 + j, 6 + j], A[9 + j, 9 + j] = 1.0, 1.0, 1.0, -1.0
        A[j, 6 + j] = dt
        for c in range(3):
            A[c, 3 + j], A[6 + c, 3 + j] = turn_p[c], turn_v[c]
            A[6 + c, 9 + j] = -turn_p[c]  # -R (dw x r) with dw = -dbias
    B = np.zeros((LOAD_NE, 12))
    for i in range(LOAD_NE):
        for k in range(12):
            if A[i, k] != 0.0:
                for j in range(12):
                    B[i, j] += A[i, k] * s.P[k, j]
    for i in range(LOAD_NE):
        for j in range(i + 1):
            total = 0.0
            for k in range(12):
                total += B[i, k] * A[j, k]
            out[i, j] = total
            out[j, i] = total
    lead = (dt + 0.5 * p.dt[1]) / p.dt[1]
    noise = p.load_noise[0] ** 2 / p.dt[1] * ((1.0 + lead) ** 2 + lead**2)
    for c in range(3):
        out[9 + c, 9 + c] += noise
