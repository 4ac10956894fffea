# SPDX-License-Identifier: Apache-2.0
"""Tests of `control.attitude`. Each name states the property it checks."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skyhaul.control.attitude import (
    AttitudeGains,
    AttitudeRef,
    attitude_moment,
    attitude_moment_kernel,
    desired_attitude,
)

GAINS = AttitudeGains(k_R=0.6, k_w=0.06)
J_B = np.diag([2.3e-3, 2.5e-3, 4.0e-3])  # [kg m^2]
AT_REST = AttitudeRef(np.eye(3), np.zeros(3), np.zeros(3))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def random_rotations(rng, n):
    return Rotation.random(n, rng=rng).as_matrix()


@pytest.mark.parametrize("axis", np.eye(3))
def test_moment_opposes_a_small_attitude_error(axis):
    R_WB = Rotation.from_rotvec(1e-4 * axis).as_matrix()
    tau_B = attitude_moment(R_WB, np.zeros(3), AT_REST, J_B, GAINS)
    np.testing.assert_allclose(tau_B, -GAINS.k_R * 1e-4 * axis, atol=1e-9)


def test_moment_on_the_reference_is_inverse_dynamics(rng):
    R, w, dw = random_rotations(rng, 1)[0], rng.normal(size=3), rng.normal(size=3)
    tau_B = attitude_moment(R, w, AttitudeRef(R, w, dw), J_B, GAINS)
    np.testing.assert_allclose(tau_B, J_B @ dw + np.cross(w, J_B @ w), atol=1e-12)


def test_moment_does_not_depend_on_the_choice_of_world_frame(rng):
    R_WB, R_WD, R_VW = random_rotations(rng, 3)
    w, w_D, dw_D = rng.normal(size=(3, 3))
    in_W = attitude_moment(R_WB, w, AttitudeRef(R_WD, w_D, dw_D), J_B, GAINS)
    in_V = attitude_moment(R_VW @ R_WB, w, AttitudeRef(R_VW @ R_WD, w_D, dw_D), J_B, GAINS)
    np.testing.assert_allclose(in_V, in_W, atol=1e-12)


def test_batch_equals_loop(rng):
    n = 5
    R_WB, R_WD = random_rotations(rng, n), random_rotations(rng, n)
    w, w_D, dw_D = rng.normal(size=(3, n, 3))
    batch = attitude_moment(R_WB, w, AttitudeRef(R_WD, w_D, dw_D), J_B, GAINS)
    for i in range(n):
        ref = AttitudeRef(R_WD[i], w_D[i], dw_D[i])
        np.testing.assert_allclose(batch[i], attitude_moment(R_WB[i], w[i], ref, J_B, GAINS))


def test_closed_loop_settles_from_a_large_error():
    dt, R_WB, w = 1e-3, Rotation.from_rotvec([2.0, -1.0, 0.5]), np.zeros(3)
    for _ in range(2000):
        tau_B = attitude_moment(R_WB.as_matrix(), w, AT_REST, J_B, GAINS)
        w = w + dt * np.linalg.solve(J_B, tau_B - np.cross(w, J_B @ w))
        R_WB = R_WB * Rotation.from_rotvec(dt * w)
    assert R_WB.magnitude() < 1e-3  # [rad]


def test_gains_must_be_positive():
    with pytest.raises(ValueError, match="k_R=-1"):
        AttitudeGains(k_R=-1.0)


@pytest.mark.parametrize("seed", range(5))
def test_kernel_equals_the_equation(seed):
    rng = np.random.default_rng(seed)
    R_WB, R_WD = random_rotations(rng, 2)
    w, w_D, dw_D = rng.normal(size=(3, 3))
    kernel = attitude_moment_kernel(
        R_WB, w, (R_WD, tuple(w_D), tuple(dw_D)), np.diag(J_B), (3 * (0.6,), 3 * (0.06,))
    )
    equation = attitude_moment(R_WB, w, AttitudeRef(R_WD, w_D, dw_D), J_B, GAINS)
    np.testing.assert_allclose(kernel, equation, atol=1e-12)


@pytest.mark.parametrize("yaw", [-3.0, 0.0, 0.4, 2.0])
def test_desired_attitude_points_the_thrust_and_looks_along_the_heading(yaw, rng):
    b3 = rng.normal(size=3) + np.array([0.0, 0.0, 3.0])
    b3 /= np.linalg.norm(b3)
    R = np.empty((3, 3))
    desired_attitude(tuple(b3), yaw, R)
    heading = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R[:, 2], b3, atol=1e-12)
    assert R[:, 1] @ heading == pytest.approx(0.0, abs=1e-12)
    assert R[:, 0] @ heading > 0.0
