# SPDX-License-Identifier: Apache-2.0
"""The paper's cubic: clamped, through its waypoints, C2, and what it cannot do."""

import numpy as np
import pytest

from skyhaul.geometry.so3 import rotation_z, so3_exp
from skyhaul.planning.cubic import CubicPlanner, CubicReference, timed_cubic
from skyhaul.planning.motion import Drive
from skyhaul.planning.reference import resting_reference, with_tilt
from skyhaul.planning.shortcut import subdivide

DRIVE = Drive(1.35, 0.68, 0.0, 0.0, -1.0, 0.0, np.inf)
POINTS = subdivide(np.array([[0.0, 0, 1], [3, 0, 1], [3, 2, 1.5], [5, 3, 2]]), 0.05)


def reference(v_WS=(0.0, 0.0, 0.0), spacing_m=0.8) -> CubicReference:
    return CubicReference(1_000_000, timed_cubic(POINTS, np.array(v_WS), DRIVE, spacing_m), 0.2)


def test_it_passes_its_ends_with_the_velocities_it_is_clamped_to():
    r = reference((0.4, 0.1, 0.0))
    s = r.sample(np.array([r.start_us, r.end_us])).p_WD
    np.testing.assert_allclose(s[0, :2], [POINTS[0], [0.4, 0.1, 0.0]], atol=1e-9)
    np.testing.assert_allclose(s[1, :2], [POINTS[-1], np.zeros(3)], atol=1e-5)


def test_position_velocity_and_acceleration_are_continuous_but_jerk_jumps():
    r = reference()
    knots = r.start_us + 1e6 * r.spline.x[1:-1]
    before, after = (r.sample(knots + e).p_WD for e in (-1.0, 1.0))
    for k in range(3):
        np.testing.assert_allclose(before[:, k], after[:, k], atol=1e-4)
    assert np.max(np.linalg.norm(before[:, 3] - after[:, 3], axis=1)) > 0.1
    np.testing.assert_array_equal(after[:, 4:], 0.0)


def test_derivatives_are_slopes():
    r, h = reference(), 100
    t = r.start_us + np.array([1_234_000, 2_345_000])
    for k in range(3):
        slope = (r.sample(t + h).p_WD[:, k] - r.sample(t - h).p_WD[:, k]) / (2e-6 * h)
        np.testing.assert_allclose(slope, r.sample(t).p_WD[:, k + 1], atol=1e-4)


def test_it_turns_the_load_on_its_way_as_the_default_reference_does():
    R_tilt = so3_exp(np.array([0.2, -0.1, 0.0]))
    r = reference()
    turned = with_tilt(r, r.start_us + 1_000_000, R_tilt, 350_000)
    other = with_tilt(resting_reference(POINTS[0], 0.2, 0), r.start_us + 1_000_000, R_tilt, 350_000)
    t = r.start_us + np.array([900_000, 1_100_000, 1_234_000, 2_000_000])
    np.testing.assert_array_equal(turned.sample(t).p_WD, r.sample(t).p_WD)
    np.testing.assert_allclose(turned.sample(t).R_WD, other.sample(t).R_WD, atol=1e-9)
    np.testing.assert_allclose(turned.sample(t[:1]).R_WD, r.sample(t[:1]).R_WD)
    np.testing.assert_allclose(turned.sample(t[3:]).R_WD[0, 0], rotation_z(0.2) @ R_tilt)


def test_more_waypoints_follow_the_path_more_closely():
    def off(r):
        p = r.sample(np.linspace(r.start_us, r.end_us, 400)).p_WD[:, 0]
        return max(np.min(np.linalg.norm(POINTS - q, axis=1)) for q in p)

    coarse, fine = off(reference(spacing_m=2.0)), off(reference(spacing_m=0.25))
    assert fine < 0.5 * coarse


def test_parameters_out_of_range_are_refused():
    with pytest.raises(ValueError, match="spacing_m must be > 0, got 0"):
        CubicPlanner(spacing_m=0.0)
