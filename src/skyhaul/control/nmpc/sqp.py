# SPDX-License-Identifier: Apache-2.0
"""Sequential quadratic programming on the horizon: full Gauss-Newton steps, on the manifold."""

import math
from dataclasses import dataclass

import numpy as np

from skyhaul.control.api import SolveStatus
from skyhaul.control.nmpc.corridor import corridor_rows
from skyhaul.control.nmpc.forces import InputMap, Scratch, StageParams
from skyhaul.control.nmpc.hpipm import MIN_STEP, SUCCESS, OcpQp
from skyhaul.control.nmpc.stage import (
    FIXED_ROWS,
    NE,
    ROWS_PER_CABLE,
    Iterate,
    QpArrays,
    StageRefs,
    linearise,
)
from skyhaul.geometry.kernels import quat_exp, quat_mul
from skyhaul.jit import njit
from skyhaul.mapping.api import WorldMap
from skyhaul.types import Array

TURN_MAX_RAD = 0.4
"""Longest step of an attitude in one iteration; a longer one shortens the whole step."""
REACH_MAX_M = 50.0
"""An iterate that goes farther than this from its start is not usable."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Memory of one controller's problem; nothing in it outlives a solve."""

    qp: OcpQp
    scratch: Scratch


@dataclass(frozen=True, eq=False)
class Problem:
    """One optimal control problem."""

    stage: StageParams
    im: InputMap
    rate_max: Array  # (nz,) bound of the rate of z [N/s, N m/s]
    hover: Array  # (nz,) size of z in hover [N, N m]
    small: float  # a step below it ends the iterations: m, rad, m/s, rad/s, shares of hover
    refs: StageRefs
    node: Array  # (N+1,) times of the nodes after the first [s]
    t_us: Array  # (N+1,) the same since the start of the run [us]
    world_map: WorldMap
    movers: int  # rows for tracks


@dataclass(frozen=True, eq=False)
class SqpResult:
    """Where the iterations ended."""

    status: SolveStatus
    iterate: Iterate  # the last one; of a failed solve the one before the failure
    residual: float  # of the last QP
    iterations: int  # of the interior-point method, all QPs together
    slack_m: float


def solve_sqp(problem: Problem, start: Iterate, count: int, ws: Workspace) -> SqpResult:
    """Up to `count` Gauss-Newton steps from a guess; the first state and forces stay.

    Steps shrink about as the square of the one before, so that after a small one the next would
    change nothing; obstacles whose rows come and go keep them large. A QP without a solution, or a
    step that leads too far, fails the whole solve, earlier steps included: an iterate from which
    there is no next step is not flown.
    """
    qp = ws.qp
    arrays = QpArrays(qp.At, qp.Bt, qp.b, qp.Q, qp.q, qp.R, qp.r, qp.St, qp.Ct, qp.d, qp.active)
    it, status, residual, inner, slack = start, SolveStatus.FAILED, math.inf, 0, 0.0
    for _ in range(count):
        linearise(problem.stage, problem.im, problem.refs, it, arrays, ws.scratch)
        _obstacle_rows(problem, it, qp)
        np.subtract(-problem.rate_max, it.u, out=qp.lower)
        np.subtract(problem.rate_max, it.u, out=qp.upper)
        outcome = qp.solve()
        inner, residual = inner + outcome.iterations, outcome.residual
        if outcome.status > MIN_STEP or not _finite(qp):
            return SqpResult(SolveStatus.FAILED, it, residual, inner, slack)
        new = Iterate(it.x.copy(), it.z.copy(), it.u.copy())
        apply_step(new, qp.dx, qp.du)
        if not _usable(new):
            return SqpResult(SolveStatus.FAILED, it, residual, inner, slack)
        it, slack = new, _slack_m(problem, qp)
        status = SolveStatus.OK if outcome.status == SUCCESS else SolveStatus.NOT_CONVERGED
        if status is SolveStatus.OK and step_size(qp.dx, problem.hover) < problem.small:
            break
    return SqpResult(status, it, residual, inner, slack)


@njit
def step_size(dx: Array, hover: Array) -> float:
    """Largest entry of a step: of the load's error, (12,), and of z in shares of hover, (nz,)."""
    size = 0.0
    for d in dx:
        for a in range(NE):
            size = max(size, abs(d[a]))
        for c in range(hover.shape[0]):
            size = max(size, abs(d[NE + c]) / hover[c])
    return size


@njit
def apply_step(it: Iterate, dx: Array, du: Array) -> None:
    """Adds a step to an iterate in place; attitudes turn by q Exp(dphi)."""
    largest = 0.0
    for k in range(1, dx.shape[0]):
        angle = math.sqrt(dx[k, 3] ** 2 + dx[k, 4] ** 2 + dx[k, 5] ** 2)
        largest = max(largest, angle)
    alpha = min(1.0, TURN_MAX_RAD / max(largest, 1e-12))
    for k in range(du.shape[0]):
        for c in range(du.shape[1]):
            it.u[k, c] += alpha * du[k, c]
    for k in range(1, dx.shape[0]):
        x, d = it.x[k], dx[k]
        for a in range(3):
            x[a] += alpha * d[a]
            x[7 + a] += alpha * d[6 + a]
            x[10 + a] += alpha * d[9 + a]
        q = quat_mul(x[3:7], quat_exp((alpha * d[3], alpha * d[4], alpha * d[5])))
        scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        for a in range(4):
            x[3 + a] = scale * q[a]
        for c in range(it.z.shape[1]):
            it.z[k, c] += alpha * d[NE + c]


def _obstacle_rows(problem: Problem, it: Iterate, qp: OcpQp) -> None:
    """Rows of obstacles around the predicted places."""
    rows = corridor_rows(problem.world_map, it.x[1:, :3], problem.t_us[1:], problem.movers)
    first = _first_obstacle_row(problem)
    qp.Ct[1:, :3, first:] = rows.normal_W.transpose(0, 2, 1)
    qp.d[1:, first:] = -rows.clearance
    qp.active[1:, first:] = rows.active


def _first_obstacle_row(problem: Problem) -> int:
    return ROWS_PER_CABLE * len(problem.stage.m_B) + FIXED_ROWS


def _slack_m(problem: Problem, qp: OcpQp) -> float:
    """How far the step's end still cuts into the obstacles' half-spaces, at most [m]."""
    first = _first_obstacle_row(problem)
    value = np.einsum("kar,ka->kr", qp.Ct[1:, :3, first:], qp.dx[1:, :3])
    lack = (qp.d[1:, first:] - value) * qp.active[1:, first:]
    return max(0.0, float(lack.max(initial=0.0)))


def _finite(qp: OcpQp) -> bool:
    return bool(np.isfinite(qp.dx).all() and np.isfinite(qp.du).all())


def _usable(it: Iterate) -> bool:
    """Whether an iterate is near enough to its start to be flown."""
    far = np.abs(it.x[:, :3] - it.x[0, :3]).max()
    return bool(far < REACH_MAX_M and np.abs(it.x[:, 7:]).max() < REACH_MAX_M)
