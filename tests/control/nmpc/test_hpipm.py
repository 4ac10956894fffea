# SPDX-License-Identifier: Apache-2.0
"""The QP solver against optimality conditions and a dense solution."""

import numpy as np
import pytest
from scipy.optimize import minimize

from skyhaul.control.nmpc.hpipm import SUCCESS, OcpQp, QpOptions, QpShape

SHAPE = QpShape(stages=4, nx=3, nu=2, ng=2)
L1, L2 = np.array([5.0, 50.0]), np.array([2.0, 10.0])


def random_qp(seed, tightness=0.0, options=None):
    rng = np.random.default_rng(seed)
    qp = OcpQp(SHAPE, L1, L2, options or QpOptions(tolerance=1e-9))
    n, nx, nu, ng = SHAPE.stages, SHAPE.nx, SHAPE.nu, SHAPE.ng
    qp.At[:] = np.eye(nx) + 0.2 * rng.normal(size=(n, nx, nx))
    qp.Bt[:] = rng.normal(size=(n, nu, nx))
    qp.b[:] = 0.5 * rng.normal(size=(n, nx))
    root = rng.normal(size=(n + 1, nx, nx))
    qp.Q[:] = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(nx)
    qp.q[:] = rng.normal(size=(n + 1, nx))
    qp.R[:] = np.eye(nu) * rng.uniform(0.2, 1.0)
    qp.r[:] = rng.normal(size=(n, nu))
    qp.lower[:], qp.upper[:] = -0.4, 0.4
    qp.Ct[:] = rng.normal(size=(n + 1, nx, ng))
    qp.d[:] = tightness
    qp.active[:] = 1.0
    return qp


def roll(qp, u):
    x = np.zeros((SHAPE.stages + 1, SHAPE.nx))
    for k in range(SHAPE.stages):
        x[k + 1] = qp.At[k].T @ x[k] + qp.Bt[k].T @ u[k] + qp.b[k]
    return x


def cost(qp, u):
    x = roll(qp, u)
    total = sum(0.5 * u[k] @ qp.R[k] @ u[k] + qp.r[k] @ u[k] for k in range(SHAPE.stages))
    for k in range(1, SHAPE.stages + 1):
        lack = np.maximum(0.0, qp.d[k] - qp.Ct[k].T @ x[k]) * qp.active[k]
        total += 0.5 * x[k] @ qp.Q[k] @ x[k] + qp.q[k] @ x[k] + L1 @ lack + 0.5 * L2 @ lack**2
    return total


@pytest.mark.parametrize("seed", range(6))
def test_solution_obeys_the_dynamics_and_the_bounds(seed):
    qp = random_qp(seed)
    outcome = qp.solve()
    assert outcome.status == SUCCESS
    np.testing.assert_allclose(qp.dx[1:], roll(qp, qp.du)[1:], atol=1e-7)
    assert np.abs(qp.du).max() <= 0.4 + 1e-7


@pytest.mark.parametrize("tightness", [-5.0, 0.0, 2.0])
@pytest.mark.parametrize("seed", range(4))
def test_no_other_inputs_cost_less(seed, tightness):
    """With rows that are idle, active and impossible; the slacks are paid for exactly."""
    qp = random_qp(seed, tightness)
    qp.solve()
    best = cost(qp, qp.du)
    bounds = [(-0.4, 0.4)] * qp.du.size
    found = minimize(
        lambda u: cost(qp, u.reshape(qp.du.shape)), qp.du.ravel(), bounds=bounds, tol=1e-12
    )
    assert found.fun >= best - 1e-6
    rng = np.random.default_rng(seed)
    for size in (1e-3, 1e-1):
        for _ in range(50):
            u = np.clip(qp.du + size * rng.normal(size=qp.du.shape), -0.4, 0.4)
            assert cost(qp, u) >= best - 1e-7


def test_a_masked_row_does_not_count():
    qp, free = random_qp(3, tightness=2.0), random_qp(3, tightness=-1e3)
    qp.active[:] = 0.0
    qp.solve()
    free.solve()
    np.testing.assert_allclose(qp.du, free.du, atol=1e-6)


def test_equal_arrays_give_equal_steps_whatever_was_solved_before():
    qp, other = random_qp(1), random_qp(2)
    qp.solve()
    first = qp.du.copy()
    saved = {n: getattr(qp, n).copy() for n in ("At", "Bt", "b", "Q", "q", "R", "r", "Ct", "d")}
    for name in saved:
        getattr(qp, name)[:] = getattr(other, name)
    qp.solve()
    for name, value in saved.items():
        getattr(qp, name)[:] = value
    qp.solve()
    np.testing.assert_array_equal(qp.du, first)


def test_nan_in_the_problem_is_a_status_not_a_crash():
    qp = random_qp(0)
    qp.q[2, 0] = np.nan
    assert qp.solve().status != SUCCESS


def test_too_few_iterations_are_told():
    outcome = random_qp(0, options=QpOptions(tolerance=1e-12, iterations=2)).solve()
    assert outcome.status != SUCCESS
    assert outcome.iterations == 2
    assert outcome.residual > 1e-12
