# SPDX-License-Identifier: Apache-2.0
"""A filter whose state turned out to be another: the clones follow as they depend on it."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_exp, quat_mul, quat_to_R
from skyhaul.geometry.so3 import so3_log
from skyhaul.perception.vio.api import NavState, P
from skyhaul.perception.vio.clones import clone, correct, move, rebased, start_filter

NE = 15


@pytest.fixture
def filter_():
    """A filter that moved on twice since it cloned its pose."""
    rng = np.random.default_rng(0)
    root = 0.05 * rng.normal(size=(NE, NE))
    q = quat_exp(np.array([0.2, -0.1, 0.7]))
    zero = np.zeros(3)
    state = NavState(np.array([1.0, 2.0, 1.5]), q, np.array([0.5, 0.3, 0.0]), zero, zero)
    out = clone(start_filter(state, root @ root.T + 1e-4 * np.eye(NE)), 0)
    for k in (1, 2):
        there = replace(state, p_WI=state.p_WI + 0.1 * k * state.v_WI)
        out = clone(move(out, there, np.eye(NE), 1e-4 * np.eye(NE), 0.1), k)
    return out


def test_after_what_a_measurement_of_the_state_says_clones_are_where_it_puts_them(filter_):
    """A Kalman update by the state alone is the same as its result handed over."""
    H = np.zeros((3, len(filter_.covariance)))
    H[:, P] = np.eye(3)
    whole = correct(filter_, np.array([0.05, -0.03, 0.02]), H, 0.02)
    handed = rebased(filter_, whole.state, whole.covariance[:NE, :NE])
    np.testing.assert_allclose(handed.covariance, whole.covariance, atol=1e-12)
    np.testing.assert_allclose(handed.clone_p, whole.clone_p, atol=1e-12)
    np.testing.assert_allclose(handed.clone_R, whole.clone_R, atol=1e-12)


def test_the_newest_clone_is_the_state(filter_):
    s = filter_.state
    there = replace(
        s, p_WI=s.p_WI + np.array([0.4, -0.2, 0.1]), q_WI=quat_mul(s.q_WI, quat_exp(0.01 * s.v_WI))
    )
    out = rebased(filter_, there, 0.5 * filter_.covariance[:NE, :NE])
    np.testing.assert_allclose(out.clone_p[-1], there.p_WI, atol=1e-9)
    turn = so3_log(out.clone_R[-1].T @ quat_to_R(there.q_WI))
    np.testing.assert_allclose(turn, 0.0, atol=1e-9)
    newest = out.covariance[-6:, -6:]
    np.testing.assert_allclose(newest, out.covariance[:6, :6], atol=1e-12)


def test_the_covariance_stays_one(filter_):
    narrow = 0.1 * filter_.covariance[:NE, :NE]
    out = rebased(filter_, filter_.state, narrow)
    np.testing.assert_allclose(out.covariance, out.covariance.T, atol=1e-15)
    assert np.linalg.eigvalsh(out.covariance).min() > -1e-12
    assert np.trace(out.covariance) < np.trace(filter_.covariance)


def test_derivatives_are_taken_at_the_new_estimates(filter_):
    there = replace(filter_.state, p_WI=filter_.state.p_WI + np.array([1.0, 0.0, 0.0]))
    out = rebased(filter_, there, filter_.covariance[:NE, :NE].copy())
    np.testing.assert_array_equal(out.first_p, out.clone_p)
    np.testing.assert_array_equal(out.first_R, out.clone_R)
    np.testing.assert_array_equal(out.first.p_WI, there.p_WI)
