# SPDX-License-Identifier: Apache-2.0
"""The optimal control problem, linearised stage by stage: what `hpipm.OcpQp` takes.

State: load state (13,), the controlled forces z, (nz,), and j, (3,), the rate of the force on the
load over the interval before; input: the rate of z. In the problem the load's part is
its error (12,), right-sided, so the step of the attitude is a rotation vector. The cost of changes
of j bounds the angular acceleration of the cables: without it plans start with rates that no
vehicle can reach at once.
"""

import math
from typing import NamedTuple

import numpy as np

from skyhaul.control.nmpc.forces import (
    InputMap,
    Scratch,
    StageParams,
    cable_forces,
    load_accelerations,
    multiply,
    thrust_vector,
)
from skyhaul.control.nmpc.load_step import LoadStep, load_step, right_jacobian_inverse
from skyhaul.geometry.kernels import mat_vec, quat_conj, quat_log, quat_mul, quat_to_R
from skyhaul.jit import njit
from skyhaul.types import Array

NE = 12
"""Entries of the load error."""
NJ = 3
"""Entries of j."""
ROWS_PER_CABLE = 3
"""Tension, cone, thrust."""
FIXED_ROWS = 2
"""Tilt, speed."""


class StageRefs(NamedTuple):
    """What the stages aim at."""

    x: Array  # (N+1, 13)
    z: Array  # (N+1, nz)
    force_W: Array  # (N+1, n, 3) cable forces on the load [N]
    u: Array  # (N, nz)
    u_now: Array  # (nz,) rate that is commanded now
    dir_W: Array  # (N+1, n, 3) unit, direction of each cable force
    bend_W: Array  # (N+1, n, 3) second derivative of that direction [1/s^2]
    active: Array  # (n,) 1 or 0


class Iterate(NamedTuple):
    """A guess of the whole horizon."""

    x: Array  # (N+1, 13)
    z: Array  # (N+1, nz)
    u: Array  # (N, nz)


class QpArrays(NamedTuple):
    """The arrays of `OcpQp` that the kernels fill."""

    At: Array
    Bt: Array
    b: Array
    Q: Array
    q: Array
    R: Array
    r: Array
    St: Array
    Ct: Array
    d: Array
    active: Array


@njit
def linearise(
    s: StageParams, im: InputMap, ref: StageRefs, it: Iterate, qp: QpArrays, mem: Scratch
) -> None:
    """Fill the problem around an iterate: dynamics, Gauss-Newton cost, rows but for obstacles."""
    stages = s.dt.shape[0]
    for k in range(stages):
        _dynamics(s, im, it, k, qp, mem)
        _input_cost(s, im, ref, it, k, qp)
    for a in range(NJ):  # j has no cost of its own at the end: keep the matrix positive
        j = NE + it.z.shape[1] + a
        qp.Q[stages, j, j] = 1e-3 * s.w_bend
    for k in range(1, stages + 1):
        weight = 0.5 * (s.dt[k - 1] + (s.dt[k] if k < stages else 0.0))
        _state_cost(s, ref, it, k, weight, qp, mem)
        _rows(s, im, ref, it, k, qp, mem)


@njit
def _dynamics(
    s: StageParams, im: InputMap, it: Iterate, k: int, qp: QpArrays, mem: Scratch
) -> None:
    """A, B and the gap b = F(x_k, u_k) - x_{k+1} of interval k."""
    nz, dt = it.z.shape[1], s.dt[k]
    z, u, step = it.z[k], it.u[k], mem.step
    multiply(im.T_y, z, mem.y)
    multiply(im.T_y, u, mem.y1)
    F, dF = np.empty(3), np.empty(3)
    multiply(im.T_F, z, F)
    multiply(im.T_F, u, dF)
    inputs = (F, dF, mem.y, mem.y1)
    load_step(s.load, it.x[k], inputs, s.dt[k], (mem.S, mem.work, mem.R, np.empty(12)), step)
    x1, At, Bt, b = it.x[k + 1], qp.At[k], qp.Bt[k], qp.b[k]
    for a in range(3):
        b[a], b[6 + a] = step.x[a] - x1[a], step.x[7 + a] - x1[7 + a]
        b[9 + a] = step.x[10 + a] - x1[10 + a]
    turn = quat_log(quat_mul(quat_conj(x1[3:7]), step.x[3:7]))
    b[3], b[4], b[5] = turn
    right_jacobian_inverse(b[3:6], mem.Jr)
    _fill_load_columns(step.A, mem.Jr, At)
    for c in range(nz):
        _force_columns(s, im, step, k, c, At[NE + c], Bt[c])
        _turn_rows(mem.Jr, At[NE + c])
        _turn_rows(mem.Jr, Bt[c])
        At[NE + c, NE + c] = 1.0
        Bt[c, NE + c] = dt
        for a in range(NJ):
            Bt[c, NE + nz + a] = im.T_F[a, c]
        b[NE + c] = z[c] + dt * u[c] - it.z[k + 1, c]
        if im.moves[c] == 0.0:
            Bt[c, :] = 0.0
            b[NE + c] = z[c] - it.z[k + 1, c]


@njit
def _fill_load_columns(A: Array, Jr: Array, At: Array) -> None:
    for c in range(NE):
        for a in range(NE):
            At[c, a] = A[a, c]
        _turn_rows(Jr, At[c])


@njit
def _turn_rows(Jr: Array, column: Array) -> None:
    """Attitude entries of a column, about the new linearisation point."""
    t = (column[3], column[4], column[5])
    column[3], column[4], column[5] = mat_vec(Jr, t)


@njit
def _force_columns(
    s: StageParams, im: InputMap, step: LoadStep, k: int, c: int, by_z: Array, by_u: Array
) -> None:
    """Derivatives of the load after interval k by z_c and by its rate."""
    dt = s.dt[k]
    c2, c3 = dt * dt / 2.0, dt * dt * dt / 6.0
    by_z[:] = 0.0
    by_u[:] = 0.0
    for a in range(3):
        f = im.T_F[a, c] / s.load.m
        by_z[a], by_z[6 + a] = c2 * f, dt * f
        by_u[a], by_u[6 + a] = c3 * f, c2 * f
    for j in range(12):
        t = im.T_y[j, c]
        if t == 0.0:
            continue
        for a in range(3):
            by_z[3 + a] += step.y[a, j] * t
            by_z[9 + a] += step.y[3 + a, j] * t
            by_u[3 + a] += step.y[a, 12 + j] * t
            by_u[9 + a] += step.y[3 + a, 12 + j] * t


@njit
def _input_cost(
    s: StageParams, im: InputMap, ref: StageRefs, it: Iterate, k: int, qp: QpArrays
) -> None:
    """Rates against those of the reference, and the change of j per time squared.

    The change is T_F u_k - j_k; j_0 is commanded now.
    """
    nz, R, r, St = it.u.shape[1], qp.R[k], qp.r[k], qp.St[k]
    before = ref.u_now if k == 0 else it.u[k - 1]
    w = s.w_bend / (0.5 * (s.dt[k] + (s.dt[k - 1] if k > 0 else 0.0)))
    for c in range(nz):
        for d in range(nz):
            R[c, d] = 0.0
            for a in range(NJ):
                R[c, d] += w * im.T_F[a, c] * im.T_F[a, d]
        R[c, c] += s.dt[k] * s.w_u[c]
        r[c] = s.dt[k] * s.w_u[c] * (it.u[k, c] - ref.u[k, c])
        for a in range(NJ):
            St[NE + nz + a, c] = -w * im.T_F[a, c]
    for a in range(NJ):
        change = 0.0
        for c in range(nz):
            change += im.T_F[a, c] * (it.u[k, c] - before[c])
        for c in range(nz):
            r[c] += w * im.T_F[a, c] * change
        qp.Q[k, NE + nz + a, NE + nz + a] = w
        qp.q[k, NE + nz + a] = -w * change


@njit
def load_error_jacobian(x: Array, x_ref: Array, e: Array, mem: Scratch) -> None:
    """Error of a load state against a reference, layout of `types.ERR_P`, and its derivative.

    The error goes into `e`, (12,), the derivative by the right-sided error of x into `mem.J_e`.
    """
    J, Jr, R = mem.J_e, mem.Jr, mem.R
    for a in range(3):
        e[a], e[6 + a] = x[a] - x_ref[a], x[7 + a] - x_ref[7 + a]
    relative = quat_mul(quat_conj(x_ref[3:7]), x[3:7])
    e[3], e[4], e[5] = quat_log(relative)
    quat_to_R(relative, R)
    v0 = R[0, 0] * x_ref[10] + R[1, 0] * x_ref[11] + R[2, 0] * x_ref[12]
    v1 = R[0, 1] * x_ref[10] + R[1, 1] * x_ref[11] + R[2, 1] * x_ref[12]
    v2 = R[0, 2] * x_ref[10] + R[1, 2] * x_ref[11] + R[2, 2] * x_ref[12]
    e[9], e[10], e[11] = x[10] - v0, x[11] - v1, x[12] - v2
    right_jacobian_inverse(e[3:6], Jr)
    J[:] = 0.0
    for a in range(NE):
        J[a, a] = 1.0
    for a in range(3):
        for c in range(3):
            J[3 + a, 3 + c] = Jr[a, c]
    J[9, 4], J[9, 5] = v2, -v1
    J[10, 3], J[10, 5] = -v2, v0
    J[11, 3], J[11, 4] = v1, -v0


@njit
def _state_cost(
    s: StageParams, ref: StageRefs, it: Iterate, k: int, weight: float, qp: QpArrays, mem: Scratch
) -> None:
    """Gauss-Newton blocks of the load error and of z - z_ref."""
    e, Q, q, J = mem.y, qp.Q[k], qp.q[k], mem.J_e
    load_error_jacobian(it.x[k], ref.x[k], e, mem)
    last = k == s.dt.shape[0]
    for a in range(NE):
        q[a] = 0.0
        for c in range(NE):
            Q[a, c] = 0.0
    for i in range(NE):
        w = weight * s.w_x[i] + (s.w_end[i] if last else 0.0)
        if i < 3 or 6 <= i < 9:
            Q[i, i] += w
            q[i] += w * e[i]
            continue
        for a in range(3, NE):
            if J[i, a] == 0.0:
                continue
            q[a] += w * J[i, a] * e[i]
            for c in range(3, NE):
                Q[a, c] += w * J[i, a] * J[i, c]
    for c in range(it.z.shape[1]):
        w = weight * s.w_z[c]
        Q[NE + c, NE + c] = w
        q[NE + c] = w * (it.z[k, c] - ref.z[k, c])


@njit
def _rows(
    s: StageParams, im: InputMap, ref: StageRefs, it: Iterate, k: int, qp: QpArrays, mem: Scratch
) -> None:
    """Tension, cone and thrust of every cable, tilt and speed: values >= 0, linearised."""
    n, nz = mem.f.shape[0], it.z.shape[1]
    x, z, Ct, d, active = it.x[k], it.z[k], qp.Ct[k], qp.d[k], qp.active[k]
    R, accel, thrust = mem.R, np.empty(6), np.empty(3)
    quat_to_R(x[3:7], R)
    cable_forces(im, R, z, mem)
    load_accelerations(s, im, x, z, R, accel)
    rows = ROWS_PER_CABLE * n + FIXED_ROWS
    for c in range(NE + nz + NJ):
        for j in range(rows):
            Ct[c, j] = 0.0
    weights = np.empty((3, 3))
    for i in range(n):
        f, along = mem.f[i], ref.dir_W[k, i]
        size = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) + 1e-9
        thrust_vector(s, x, R, accel, ref.bend_W[k, i], f, i, thrust)
        pull = math.sqrt(thrust[0] ** 2 + thrust[1] ** 2 + thrust[2] ** 2) + 1e-9
        component = f[0] * along[0] + f[1] * along[1] + f[2] * along[2]
        for a in range(3):
            weights[0, a] = along[a]
            weights[1, a] = along[a] - s.cos_cone * f[a] / size
            weights[2, a] = -thrust[a] / pull
        d[i] = s.tension_min - component
        d[n + i] = s.cos_cone * size - component
        d[2 * n + i] = pull - s.thrust_max[i]
        for kind in range(3):
            row = kind * n + i
            active[row] = ref.active[i]
            for a in range(3):
                g = weights[kind, a]
                for c in range(3):
                    Ct[3 + c, row] += g * mem.by_phi[3 * i + a, c]
                for c in range(nz):
                    Ct[NE + c, row] += g * mem.by_z[3 * i + a, c]
                    if kind == 2:
                        Ct[NE + c, row] += g * s.m_B[i] / s.load.m * im.T_F[a, c]
    _tilt_and_speed(s, x, R, ROWS_PER_CABLE * n, Ct, d, active)


@njit
def _tilt_and_speed(
    s: StageParams, x: Array, R: Array, row: int, Ct: Array, d: Array, active: Array
) -> None:
    Ct[3, row], Ct[4, row] = -R[2, 1], R[2, 0]
    d[row] = s.cos_tilt - R[2, 2]
    active[row] = 1.0 if s.load.rigid else 0.0
    speed = math.sqrt(x[7] * x[7] + x[8] * x[8] + x[9] * x[9])
    active[row + 1] = 1.0 if speed > 0.5 * s.speed_max else 0.0
    d[row + 1] = speed - s.speed_max
    for a in range(3):
        Ct[6 + a, row + 1] = -x[7 + a] / (speed + 1e-9)
