# SPDX-License-Identifier: Apache-2.0
"""One update takes the drift since a place out of a state, and knows what is left."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_exp, quat_mul, quat_to_R
from skyhaul.geometry.so3 import rotation_z, so3_exp, so3_log
from skyhaul.perception.slam.closure import Closure
from skyhaul.perception.slam.found_pose import found_pose, off_by, shared, without_drift
from skyhaul.perception.slam.places import NO_CORNERS, Place
from skyhaul.perception.vio.api import BA, BG, NavState, P, R, V

R_A, P_A = rotation_z(0.4) @ so3_exp(np.array([0.05, -0.1, 0.0])), np.array([1.0, 2.0, 1.5])
R_B, P_B = rotation_z(-0.3) @ so3_exp(np.array([-0.08, 0.02, 0.0])), np.array([2.0, 1.2, 1.8])
TRUE = NavState(
    P_B,
    quat_mul(quat_exp(np.array([0.0, 0.0, -0.3])), quat_exp(np.array([-0.08, 0.02, 0.0]))),
    np.array([0.8, -0.5, 0.1]),
    np.array([0.01, 0.0, -0.01]),
    np.array([0.05, 0.02, 0.0]),
)
AT_PLACE = np.diag(np.repeat([0.03**2, 0.006**2], 3))
EXACT = np.zeros(6)
FOUND = np.diag(np.repeat([0.02**2, 0.005**2], 3))


def drift_of(seconds=5.0):
    """Covariance of dead reckoning: speed, tilt and bias are wrong and integrate, (15, 15)."""
    root = np.zeros((15, 15))
    root[V, V] = 0.05 * np.eye(3)
    root[P, V] = seconds * root[V, V]
    root[BA, BA] = 0.02 * np.eye(3)
    root[V, BA] = -seconds * root[BA, BA]
    root[P, BA] = -0.5 * seconds**2 * root[BA, BA]
    root[BG, BG] = 2e-4 * np.eye(3)
    root[R, R] = 3e-3 * np.eye(3)
    root[P, P] = 0.02 * np.eye(3)
    return root @ root.T


def plus(x, e):
    return NavState(
        x.p_WI + e[P], quat_mul(x.q_WI, quat_exp(e[R])), x.v_WI + e[V],
        x.gyro_bias + e[BG], x.accel_bias + e[BA],
    )  # fmt: skip


def minus(a, b):
    turn = so3_log(quat_to_R(b.q_WI).T @ quat_to_R(a.q_WI))
    parts = (a.p_WI - b.p_WI, turn, a.v_WI - b.v_WI)
    return np.concatenate([*parts, a.gyro_bias - b.gyro_bias, a.accel_bias - b.accel_bias])


def place_at(R_WI, p_WI):
    return Place(
        0, R_WI, p_WI, AT_PLACE.copy(), NO_CORNERS, np.zeros((0, 3)), NO_CORNERS.descriptor
    )


def closure_of(error=EXACT):
    """What a closure finds whose error (p, R) in the body's axes is given."""
    R_ab, p_ab = R_A.T @ R_B, R_A.T @ (P_B - P_A)
    found = R_ab @ so3_exp(-error[3:])
    return Closure(found, p_ab - found @ error[:3], FOUND.copy(), 30, 32)


def drawn(rng):
    """State, its covariance, place and closure whose errors are as large as they say.

    The place is off by e_a; position and heading of now are off by the same and the drift.
    """
    e_a = np.linalg.cholesky(AT_PLACE) @ rng.normal(size=6)
    place = place_at(R_A @ so3_exp(-e_a[3:]), P_A - e_a[:3])
    held = shared(place, TRUE, closure_of()).held
    values, vectors = np.linalg.eigh(drift_of())
    d = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=15))
    phi = np.array([0.0, 0.0, (R_A @ e_a[3:])[2]])
    d[P] += e_a[:3] + np.cross(phi, P_B - P_A)
    d[R] += R_B.T @ phi
    d[V] += np.cross(phi, TRUE.v_WI)
    closure = closure_of(np.linalg.cholesky(FOUND) @ rng.normal(size=6))
    return plus(TRUE, -d), drift_of() + held, place, closure


@pytest.fixture(scope="module")
def trials():
    """Errors before and after, and covariances after, of many draws."""
    rng, out = np.random.default_rng(0), []
    for _ in range(400):
        state, covariance, place, closure = drawn(rng)
        after, known = without_drift(state, covariance, place, closure)
        out.append((minus(TRUE, state), minus(TRUE, after), known))
    before, error, known = zip(*out, strict=True)
    return np.array(before), np.array(error), np.array(known)


def rms(errors, part):
    return np.sqrt(np.mean(np.sum(errors[:, part] ** 2, axis=1)))


def test_the_drift_goes_and_what_the_place_was_off_stays(trials):
    before, after, _ = trials
    assert rms(before, P) > 0.4
    assert rms(after, P) < 0.08  # the place's and the closure's, over the way between them
    assert rms(after, R) < rms(before, R)


def test_velocity_and_bias_are_mended_by_their_correlation_with_the_position(trials):
    before, after, _ = trials
    assert rms(after, V) < 0.5 * rms(before, V)
    assert rms(after, BA) < rms(before, BA)


def test_the_covariance_knows_the_error_that_is_left(trials):
    _, after, known = trials
    for part, freedom in ((slice(0, 9), 9), (slice(0, 6), 6), (P, 3)):
        S, e = known[:, part, part], after[:, part]
        nees = np.einsum("ni,ni->n", e, np.linalg.solve(S, e[:, :, None])[:, :, 0])
        assert 0.7 * freedom < np.mean(nees) < 1.15 * freedom  # cautious: see `without_drift`


def test_the_covariance_stays_one(trials):
    for S in trials[2][::40]:
        np.testing.assert_allclose(S, S.T, atol=1e-15)
        assert np.linalg.eigvalsh(S).min() > -1e-12


def test_a_place_never_makes_now_better_known_than_itself(trials):
    for S in trials[2][::40]:
        assert np.all(np.diag(S)[P] > 0.03**2)


def test_a_state_that_is_right_stays():
    place = place_at(R_A.copy(), P_A.copy())
    covariance = drift_of() + shared(place, TRUE, closure_of()).held
    after, _ = without_drift(TRUE, covariance, place, closure_of())
    np.testing.assert_allclose(minus(after, TRUE), 0.0, atol=1e-12)
    np.testing.assert_allclose(off_by(TRUE, found_pose(place, closure_of())), 0.0, atol=1e-12)


def test_a_drift_beyond_its_covariance_is_taken_out_all_the_same():
    place = place_at(R_A.copy(), P_A.copy())
    covariance = drift_of() + shared(place, TRUE, closure_of()).held
    off = plus(TRUE, np.concatenate([[2.5, -2.0, 0.5], np.zeros(12)]))
    after, known = without_drift(off, covariance, place, closure_of())
    assert np.linalg.norm(after.p_WI - P_B) < 0.02
    assert np.trace(known[V, V]) > np.trace(
        without_drift(TRUE, covariance, place, closure_of())[1][V, V]
    )


def test_the_covariance_of_the_pose_found_is_that_of_place_and_closure():
    rng, nees = np.random.default_rng(1), []
    for _ in range(400):
        _, _, place, closure = drawn(rng)
        e = -off_by(TRUE, found_pose(place, closure))
        nees.append(e @ np.linalg.solve(shared(place, TRUE, closure).covariance, e))
    assert np.mean(nees) == pytest.approx(6.0, abs=0.5)


def test_what_now_shares_with_the_place_turns_about_it():
    """A heading that was off at the place puts now beside its place, its velocity aside."""
    yaw, place = 0.01, place_at(R_A.copy(), P_A.copy())
    heading = np.zeros((6, 6))
    heading[3:, 3:] = yaw**2 * np.outer(R_A.T[:, 2], R_A.T[:, 2])
    held = shared(replace(place, covariance=heading), TRUE, closure_of()).held
    z = np.array([0.0, 0.0, yaw])
    e = np.concatenate([np.cross(z, P_B - P_A), R_B.T @ z, np.cross(z, TRUE.v_WI), np.zeros(6)])
    np.testing.assert_allclose(held, np.outer(e, e), atol=1e-12)
