# SPDX-License-Identifier: Apache-2.0
"""Pairs of rays that agree with one motion, and those that do not."""

import numpy as np
import pytest

from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.vio.epipolar import five_point, matches_agree, one_translation

PIXEL = 1.0 / 200.0
R_ba = so3_exp(np.array([0.05, -0.08, 0.03]))
P_AB = np.array([0.3, -0.1, 0.2])


def pairs(wrong, seed=0):
    """Rays of 60 points from two places; the first `wrong` ones of b go astray. a is turned."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-2, 2, (60, 2)), rng.uniform(3, 6, 60)])
    a, b = points, (points - P_AB) @ R_ba.T
    xy = b[:, :2] / b[:, 2:] + 0.2 * PIXEL * rng.normal(size=(60, 2))
    angle = rng.uniform(0, 2 * np.pi, wrong)
    xy[:wrong] += 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
    b = np.column_stack([xy, np.ones(60)])
    unit = [x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a, b)]
    return unit[0], unit[1]


def test_with_the_turn_known_good_pairs_stay_and_bad_ones_go():
    a, b = pairs(wrong=24)
    agree = one_translation(a @ R_ba.T, b, PIXEL)
    assert agree[24:].mean() > 0.97
    # Some of them slide along their own epipolar line, away from the epipole.
    assert agree[:24].mean() < 0.35


def test_a_wrong_turn_is_noticed():
    a, b = pairs(wrong=0)
    assert one_translation(a, b, PIXEL).mean() < 0.6


def test_points_that_shift_towards_the_epipole_lie_behind_the_camera_and_go():
    a, b = pairs(wrong=0)
    turned = a @ R_ba.T
    t = R_ba @ -P_AB / np.linalg.norm(P_AB)  # points shift this way
    for i in range(5):
        b[i] = turned[i] - 0.1 * t
        b[i] /= np.linalg.norm(b[i])
    agree = one_translation(turned, b, PIXEL)
    assert not agree[:5].any()
    assert agree[5:].mean() > 0.97


def test_a_camera_that_only_turns_keeps_all_pairs():
    a, _ = pairs(wrong=0)
    assert one_translation(a @ R_ba.T, a @ R_ba.T, PIXEL).all()


def test_five_points_agree_with_the_translation_alone():
    a, b = pairs(wrong=15)
    both = five_point(a, b, PIXEL) == one_translation(a @ R_ba.T, b, PIXEL)
    assert both.mean() > 0.9


@pytest.mark.parametrize(("shift", "agrees"), [(0.0, True), (0.05, False)])
def test_matches_of_a_rig_lie_on_its_epipolar_lines(shift, agrees):
    p = np.array([-0.1, 0.0, 0.0])  # camera a sits left of camera b
    points = np.array([[0.3, 0.2, 3.0], [-0.4, 0.1, 2.0]])
    a, b = points - p, points + np.array([0.0, shift * 3.0, 0.0])
    unit = [x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a, b)]
    assert (matches_agree(unit[0], unit[1], p, PIXEL) == agrees).all()
