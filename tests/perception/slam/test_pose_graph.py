# SPDX-License-Identifier: Apache-2.0
"""Loops spread an error over the way, and a wrong one does not bend it."""

import numpy as np
import pytest

from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.slam.pose_graph import Relation, correction, optimize_poses

STEPS = 20


def straight(drift):
    """Odometry along a line of steps of 1 m, each `drift` off sideways; poses and relations."""
    p = np.array([[k, drift * k, 0.0] for k in range(STEPS)])
    R, step = np.tile(np.eye(3), (STEPS, 1, 1)), np.array([1.0, drift, 0.0])
    cov = np.diag([1e-4] * 3 + [1e-10] * 3)
    return (R, p), [Relation(k, k + 1, np.eye(3), step, cov) for k in range(STEPS - 1)]


def test_a_square_loop_shares_its_gap_evenly():
    """Four sides that fail to close by d, all alike: each takes a fifth of d (the loop another)."""
    gap, cov = np.array([0.1, -0.05, 0.02]), np.diag([1e-2] * 3 + [1e-10] * 3)
    sides = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]) + gap / 4
    p = np.vstack([np.zeros(3), np.cumsum(sides, axis=0)])
    R = np.tile(np.eye(3), (5, 1, 1))
    odometry = [Relation(k, k + 1, np.eye(3), sides[k], cov) for k in range(4)]
    loop = Relation(4, 0, np.eye(3), np.zeros(3), cov)
    _, got = optimize_poses((R, p), [*odometry, loop], [])
    expected = p - np.outer(np.arange(5), gap / 5)
    np.testing.assert_allclose(got, expected, atol=1e-6)


def test_a_wrong_loop_among_right_ones_keeps_the_shape():
    start, odometry = straight(0.01)
    tight = np.diag([1e-4] * 3 + [1e-6] * 3)
    good = [Relation(0, k, np.eye(3), np.array([k, 0.0, 0.0]), tight) for k in range(5, STEPS, 3)]
    wrong = Relation(2, 17, np.eye(3), np.zeros(3), tight)
    _, without = optimize_poses(start, odometry, good)
    _, got = optimize_poses(start, odometry, [*good, wrong])
    _, bent = optimize_poses(start, [*odometry, wrong], good)
    assert np.abs(got - without).max() < 0.02
    assert np.abs(bent - without).max() > 1.0


def test_correction_takes_the_old_pose_to_the_new_one():
    rng = np.random.default_rng(0)
    old, new = ((so3_exp(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2))
    R, p = correction(old, new)
    np.testing.assert_allclose(R @ old[0], new[0], atol=1e-12)
    np.testing.assert_allclose(R @ old[1] + p, new[1], atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_uncertain_steps_take_the_error(axis):
    """Two steps of variance 1 : 3 and a sure loop: the gap is shared 1 : 3 along each axis."""

    def cov(s):
        return np.diag([s] * 3 + [1e-10] * 3)

    gap = 0.04 * np.eye(3)[axis]
    p = np.vstack([np.zeros(3), gap / 2, gap])
    odometry = [
        Relation(0, 1, np.eye(3), gap / 2, cov(1e-2)),
        Relation(1, 2, np.eye(3), gap / 2, cov(3e-2)),
        Relation(0, 2, np.eye(3), np.zeros(3), cov(1e-10)),
    ]
    _, got = optimize_poses((np.tile(np.eye(3), (3, 1, 1)), p), odometry, [])
    np.testing.assert_allclose(got[1], gap / 2 - gap / 4, atol=1e-6)
