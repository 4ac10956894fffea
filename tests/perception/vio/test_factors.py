# SPDX-License-Identifier: Apache-2.0
"""The window's algebra in GTSAM."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, L, V, X

from skyhaul.geometry.quaternion import R_to_quat, quat_exp, quat_mul, quat_to_R
from skyhaul.perception.vio.api import NE, NavState
from skyhaul.perception.vio.factors import (
    imu_factor,
    imu_parameters,
    insert_state,
    marginalize,
    optimize,
    point_prior,
    sight_factor,
    sight_noise,
    state_in,
    state_prior,
)
from skyhaul.perception.vio.imu import ImuNoise, advance, segments
from skyhaul.sensors.api import ImuReading

NOISE = ImuNoise()
CAMERA = gtsam.Pose3()


def first_state():
    q = quat_exp(np.array([0.1, -0.2, 0.3]))
    bias = np.array([[0.01, -0.02, 0.03], [0.1, 0.05, -0.1]])
    return NavState(np.array([1.0, 2.0, 3.0]), q, np.array([0.5, 0.2, -0.1]), *bias)


def covariance_of(seed):
    A = np.random.default_rng(seed).normal(size=(NE, NE))
    return 1e-4 * (A @ A.T + np.eye(NE))


def samples(k):
    t = 5_000 * np.arange(21)
    rng = np.random.default_rng(k)
    imu = ImuReading(
        t, 0.3 * rng.normal(size=(21, 3)), rng.normal(size=(21, 3)) + np.array([0, 0, 9.8])
    )
    return segments(imu, 0, 100_000)


@pytest.fixture
def chain():
    """Four keyframes with IMU between them, points seen from each; factors and values."""
    states = [first_state()]
    factors = [state_prior(0, states[0], covariance_of(0))]
    for k in range(3):
        factors.append(imu_factor(imu_parameters(NOISE), k, k + 1, samples(k), states[-1]))
        states.append(advance(states[-1], samples(k), NOISE.densities())[0])
    values = gtsam.Values()
    for k, state in enumerate(states):
        insert_state(values, k, state)
    noise, rng = sight_noise("none", 2e-3), np.random.default_rng(9)
    for i, p_C in enumerate(np.column_stack([rng.uniform(-2, 2, (6, 2)), rng.uniform(4, 7, 6)])):
        point = quat_to_R(states[0].q_WI) @ p_C + states[0].p_WI
        values.insert(L(i), point)
        factors.append(point_prior(L(i), point))
        for k in range(4 if i else 2):  # point 0 is lost early
            c = quat_to_R(states[k].q_WI).T @ (point - states[k].p_WI)
            xy = c[:2] / c[2] + 2e-3 * rng.normal(size=2)
            factors.append(sight_factor(xy, noise, k, L(i), CAMERA))
    return factors, values


def test_a_prior_gives_back_its_state_and_covariance():
    state, P = first_state(), covariance_of(1)
    values = gtsam.Values()
    insert_state(values, 5, state)
    solved, covariance = optimize([state_prior(5, state, P)], values, 5, 2)
    np.testing.assert_allclose(covariance, P, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(state_in(solved, 5).p_WI, state.p_WI, atol=1e-9)


def test_a_wrong_guess_is_pulled_onto_the_prior():
    state, values = first_state(), gtsam.Values()
    q = quat_mul(state.q_WI, quat_exp(np.array([0.02, 0.01, -0.02])))
    insert_state(values, 0, NavState(state.p_WI + 0.1, q, state.v_WI, *np.zeros((2, 3))))
    solved, _ = optimize([state_prior(0, state, covariance_of(2))], values, 0, 10)
    found = state_in(solved, 0)
    np.testing.assert_allclose(found.p_WI, state.p_WI, atol=1e-5)
    np.testing.assert_allclose(found.q_WI, state.q_WI, atol=1e-5)
    np.testing.assert_allclose(found.gyro_bias, state.gyro_bias, atol=1e-5)


def test_an_imu_factor_is_content_with_the_propagated_state_and_as_uncertain():
    state, P = first_state(), 1e-12 * np.eye(NE)
    moved, Phi, Q = advance(state, samples(0), NOISE.densities())
    factor = imu_factor(imu_parameters(NOISE), 0, 1, samples(0), state)
    values = gtsam.Values()
    insert_state(values, 0, state)
    insert_state(values, 1, moved)
    assert factor.error(values) < 1e-2
    _, covariance = optimize([state_prior(0, state, P), factor], values, 1, 1)
    sigma = np.sqrt(np.diag(covariance) / np.diag(Phi @ P @ Phi.T + Q))
    # GTSAM adds 1e-8 m^2/s of its own to the place; the rest agrees.
    np.testing.assert_allclose(sigma[3:], 1.0, atol=0.03)
    assert np.all(sigma[:3] > 0.95)


def test_covariance_of_the_newest_state_is_that_of_gtsams_own_marginals(chain):
    factors, values = chain
    solved, covariance = optimize(factors, values, 3, 10)
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    theirs = gtsam.Marginals(graph, solved)
    pose, R = theirs.marginalCovariance(X(3)), quat_to_R(state_in(solved, 3).q_WI)
    np.testing.assert_allclose(covariance[3:6, 3:6], pose[:3, :3], rtol=2e-2, atol=3e-5)
    np.testing.assert_allclose(covariance[:3, :3], R @ pose[3:, 3:] @ R.T, rtol=2e-2, atol=3e-5)
    np.testing.assert_allclose(
        covariance[6:9, 6:9], theirs.marginalCovariance(V(3)), rtol=2e-2, atol=3e-5
    )
    bias = theirs.marginalCovariance(B(3))
    np.testing.assert_allclose(covariance[12:, 12:], bias[:3, :3], rtol=2e-2, atol=3e-5)


def test_forgetting_the_past_keeps_what_it_said(chain):
    factors, values = chain
    solved, covariance = optimize(factors, values, 3, 10)
    gone = [X(0), V(0), B(0), X(1), V(1), B(1), L(0)]
    kept = marginalize(factors, solved, gone)
    for key in gone:
        solved.erase(key)
    after, short = optimize(kept, solved, 3, 3)
    np.testing.assert_allclose(short, covariance, rtol=2e-2, atol=3e-5)
    np.testing.assert_allclose(state_in(after, 3).p_WI, state_in(solved, 3).p_WI, atol=1e-6)
    assert set(after.keys()) == set(solved.keys())


def test_what_is_not_determined_is_a_runtime_error():
    values = gtsam.Values()
    insert_state(values, 0, first_state())
    values.insert(L(0), np.array([0.0, 0.0, 5.0]))
    loose = sight_factor(np.zeros(2), sight_noise("none", 1e-3), 0, L(0), CAMERA)
    with pytest.raises(RuntimeError):
        optimize([state_prior(0, first_state(), covariance_of(3)), loose], values, 0, 3)


@pytest.mark.parametrize(
    ("robust", "bounded"), [("tukey", True), ("huber", False), ("none", False)]
)
def test_tukey_alone_gives_a_gross_error_no_say(robust, bounded):
    values = gtsam.Values()
    insert_state(values, 0, NavState(np.zeros(3), R_to_quat(np.eye(3)), *np.zeros((3, 3))))
    values.insert(L(0), np.array([0.0, 0.0, 5.0]))
    noise = sight_noise(robust, 1e-3)
    near, far = (
        sight_factor(np.array([x, 0.0]), noise, 0, L(0), CAMERA).error(values) for x in (0.1, 0.2)
    )
    assert (far == pytest.approx(near)) == bounded
