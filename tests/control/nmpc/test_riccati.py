# SPDX-License-Identifier: Apache-2.0
"""Feedback along the plan: optimality, and damping behind the lag of cables and vehicles."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from skyhaul.control.nmpc import Nmpc
from skyhaul.control.nmpc.plan import make_feedback
from skyhaul.control.nmpc.riccati import RICCATI_STEP_S, rotation_gains, translation_gains
from skyhaul.model import Team, hover_forces, load_derivative
from skyhaul.world.scenario import Limits

TEAM = Team()
CONTROLLER = Nmpc().build(TEAM, Limits())
MODEL = CONTROLLER.model((True,) * 4)
FEEDBACK = CONTROLLER.settings.feedback


def gains_at_rest(nodes=6, dt=0.1):
    x = np.zeros((nodes, 13))
    x[:, 3] = 1.0
    z = np.tile(hover_forces(TEAM).ravel(), (nodes, 1))
    out = np.empty((nodes, 3, 6))
    weights = (FEEDBACK.w_R, FEEDBACK.w_w)
    rotation_gains(MODEL.stage, MODEL.im, x, z, dt * np.arange(nodes), weights, out)
    return out


def rotation_at_rest():
    """d(e_R, e_w) = A (e_R, e_w) + B M by differences of the model, forces held in W."""
    x, force = np.zeros(13), hover_forces(TEAM)
    x[3] = 1.0
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    for j in range(3):
        h = 1e-6
        d = np.zeros(3)
        d[j] = 0.5 * h
        turned = x.copy()
        turned[4:7] = d
        A[3:, j] = (load_derivative(TEAM, turned, force)[10:]) / h
    B = np.zeros((6, 3))
    B[3:] = np.diag(1.0 / TEAM.payload.J_L)
    return A, B


def discrete(A, B, h):
    big = np.zeros((9, 9))
    big[:6, :6], big[:6, 6:] = A, B
    total, term = np.eye(9), np.eye(9)
    for k in range(1, 20):
        term = term @ big * h / k
        total = total + term
    return total[:6, :6], total[:6, 6:]


def test_gains_at_rest_solve_the_riccati_equation():
    A, B = rotation_at_rest()
    J = TEAM.payload.J_L
    Ad, Bd = discrete(A, B @ np.diag(J), RICCATI_STEP_S)
    Q = RICCATI_STEP_S * np.diag(np.append(FEEDBACK.w_R, FEEDBACK.w_w))
    R = RICCATI_STEP_S * np.eye(3)
    P = solve_discrete_are(Ad, Bd, Q, R)
    K = -np.diag(J) @ np.linalg.solve(R + Bd.T @ P @ Bd, Bd.T @ P @ Ad)
    out = gains_at_rest()
    np.testing.assert_allclose(out[0], K, atol=5e-3 * np.abs(K).max())
    np.testing.assert_allclose(out[0], out[-1], atol=1e-3 * np.abs(K).max())


def test_translation_gains_solve_the_riccati_equation():
    w, z, m, h = 2.0, 0.9, 0.3, 1e-3
    stiffness, damping = translation_gains(np.array([w]), z, m)
    A, B = np.array([[1.0, h], [0.0, 1.0]]), np.array([[0.5 * h * h], [h]]) / m
    Q = h * np.diag([w**4, (4.0 * z * z - 2.0) * w * w])
    R = h * np.array([[1.0 / m**2]])
    P = solve_discrete_are(A, B, Q, R)
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)[0]
    np.testing.assert_allclose([stiffness[0], damping[0]], K, rtol=1e-2)


@pytest.mark.parametrize("lag", [0.03, 0.06, 0.1])
def test_rotation_is_damped_behind_a_lag_of_the_forces(lag):
    A, B = rotation_at_rest()
    K = gains_at_rest()[0]
    closed = np.zeros((9, 9))
    closed[:6, :6], closed[:6, 6:] = A, B
    closed[6:, :6], closed[6:, 6:] = K / lag, -np.eye(3) / lag
    poles = np.linalg.eigvals(closed)
    assert poles.real.max() < -1.5


@pytest.mark.parametrize("lag", [0.03, 0.06, 0.1])
def test_position_is_well_damped_behind_a_lag_of_the_forces(lag):
    m = TEAM.payload.mass_kg
    for k, d in zip(FEEDBACK.stiffness, FEEDBACK.damping, strict=True):
        poles = np.roots([lag, 1.0, d / m, k / m])
        slow = poles[np.argmax(poles.real)]
        assert -slow.real / abs(slow) > 0.6


def test_feedback_refuses_no_bandwidth_silently():
    feedback = make_feedback(np.full(3, 2.0), np.full(3, 5.0), 1.0, 0.5)
    np.testing.assert_allclose(feedback.stiffness, 2.0)
    np.testing.assert_allclose(feedback.damping, 2.0)
    np.testing.assert_allclose(feedback.w_R, 625.0)
    np.testing.assert_allclose(feedback.w_w, 50.0)
