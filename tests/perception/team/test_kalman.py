# SPDX-License-Identifier: Apache-2.0
"""Tests of `perception.team.kalman`: the update is the textbook's, row by row or at once."""

import numpy as np
import pytest

from skyhaul.perception.team.kalman import CHI2_999, mahalanobis2, update


@pytest.fixture
def problem():
    rng = np.random.default_rng(3)
    A = rng.standard_normal((9, 9))
    return A @ A.T + 0.1 * np.eye(9), rng.standard_normal((4, 9)), rng.uniform(0.5, 2.0, 4)


def test_update_is_that_of_all_rows_at_once(problem):
    P, H, variance = problem
    r, dx, after = np.array([0.3, -0.5, 0.2, 0.1]), np.empty(9), P.copy()
    assert update(after, H, r, variance, dx)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(variance))
    np.testing.assert_allclose(dx, K @ r, atol=1e-12)
    np.testing.assert_allclose(after, (np.eye(9) - K @ H) @ P, atol=1e-10)


def test_distance_is_that_of_mahalanobis(problem):
    P, H, variance = problem
    r = np.array([1.0, -2.0, 0.5, 3.0])
    S = H @ P @ H.T + np.diag(variance)
    assert mahalanobis2(P, H, r, variance) == pytest.approx(r @ np.linalg.solve(S, r))


def test_what_is_too_far_off_changes_nothing(problem):
    P, H, variance = problem
    S = H @ P @ H.T + np.diag(variance)
    values, vectors = np.linalg.eigh(S)
    edge = np.sqrt(CHI2_999[4] * values[0]) * vectors[:, 0]
    after, dx = P.copy(), np.empty(9)
    assert not update(after, H, 1.001 * edge, variance, dx)
    np.testing.assert_array_equal(after, P)
    np.testing.assert_array_equal(dx, 0.0)
    assert update(after, H, 0.999 * edge, variance, dx)


def test_covariance_stays_symmetric_and_positive_over_many_sharp_updates():
    rng = np.random.default_rng(4)
    P, dx = np.diag(rng.uniform(1e-6, 1e2, 12)), np.empty(12)
    for _ in range(500):
        H = rng.standard_normal((3, 12)) * (rng.random((3, 12)) < 0.3)
        update(P, H, np.zeros(3), np.full(3, 1e-10), dx)
        P += 1e-9 * np.eye(12)
        np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0.0
