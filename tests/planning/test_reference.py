# SPDX-License-Identifier: Apache-2.0
"""The spline reference: exact derivatives, rotations, joints without a jump, stops."""

import numpy as np
import pytest

from skyhaul.errors import GeometryError
from skyhaul.geometry.so3 import so3_exp
from skyhaul.planning.cubic import CubicReference, timed_cubic
from skyhaul.planning.motion import Drive
from skyhaul.planning.reference import (
    SplineReference,
    TiltBlend,
    continuation,
    remaining_time,
    restart_reference,
    resting_reference,
    stop_reference,
    with_tilt,
)
from skyhaul.world.scenario import Limits

LIMITS = Limits()


def wander(seed, dt_us=300_000, tilts=()) -> SplineReference:
    rng = np.random.default_rng(seed)
    steps = np.cumsum(rng.normal(size=(16, 4)) * [0.03, 0.03, 0.03, 0.02], axis=0)
    middle = np.cumsum(steps, axis=0)
    control = np.concatenate([np.repeat(middle[:1], 8, 0), middle, np.repeat(middle[-1:], 7, 0)])
    return SplineReference(1_000_000, dt_us, control, tilts=tilts)


TILTS = (
    TiltBlend(2_000_000, 2_000_000, np.array([0.2, 0.3, 0.1])),
    TiltBlend(3_000_000, 2_500_000, np.array([-0.2, 0.1, 0.3])),
)


@pytest.mark.parametrize("t_us", [2_345_678, 3_500_000, 4_100_000])
def test_each_derivative_is_the_slope_of_the_one_before(t_us):
    r, h = wander(0, tilts=TILTS), 500
    before, now, after = (r.sample(np.array([t_us + s * h])) for s in (-1, 0, 1))
    for k in range(6):
        for a, b, c in (
            (before.p_WD, now.p_WD, after.p_WD),
            (before.R_WD, now.R_WD, after.R_WD),
        ):
            slope = (c[0, k] - a[0, k]) / (2e-6 * h)
            scale = np.abs(b[0, k + 1]).max()
            np.testing.assert_allclose(slope, b[0, k + 1], atol=1e-4 * scale + 1e-6)


def test_the_attitude_is_a_rotation_all_along_and_its_rate_is_skew():
    r = wander(1, tilts=TILTS)
    s = r.sample(np.arange(0, 8_000_000, 37_000))
    R, dR = s.R_WD[:, 0], s.R_WD[:, 1]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)),
                               atol=1e-12)  # fmt: skip
    W = R.transpose(0, 2, 1) @ dR
    np.testing.assert_allclose(W, -W.transpose(0, 2, 1), atol=1e-10)


def test_the_blends_end_at_the_attitude_asked_for_and_keep_every_derivative():
    R_tilt = so3_exp(np.array([0.3, -0.2, 0.0]))
    r = resting_reference(np.zeros(3), 0.7, 0)
    once = with_tilt(r, 1_000_000, R_tilt, 1_500_000)
    twice = with_tilt(once, 1_800_000, np.eye(3), 1_000_000)  # while the first is in progress
    end = twice.sample(np.array([5_000_000])).R_WD[0]
    np.testing.assert_allclose(end[0], r.sample(np.array([0])).R_WD[0, 0], atol=1e-12)
    np.testing.assert_allclose(end[1:], 0.0, atol=1e-12)
    first = once.sample(np.array([2_500_000])).R_WD[0, 0]
    np.testing.assert_allclose(first, r.sample(np.array([0])).R_WD[0, 0] @ R_tilt, atol=1e-12)
    for t in (1_000_000, 1_800_000, 2_500_000, 2_800_000):
        a, b = twice.sample(np.array([t - 1, t + 1])).R_WD
        np.testing.assert_allclose(a[:6], b[:6], atol=1e-4 * (1.0 + np.abs(a[6]).max()))


def test_it_rests_before_its_start_and_after_its_end():
    r = wander(2)
    s = r.sample(np.array([-5, r.start_us - 1, r.end_us + 1, r.end_us + 10**9]))
    np.testing.assert_allclose(s.p_WD[:, 1:], 0.0, atol=0.0)
    np.testing.assert_allclose(s.p_WD[-1, 0], r.control[-1, :3], atol=1e-12)
    inside = r.sample(np.array([r.end_us - 1])).p_WD[0, 1:5]
    np.testing.assert_allclose(inside, 0.0, atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("dt_us", [300_000, 150_000])
def test_a_continuation_keeps_derivatives_0_to_6_at_any_time(seed, dt_us):
    r = wander(seed)
    t = int(np.random.default_rng(seed).integers(r.start_us, r.end_us))
    start_us, first = continuation(r, t, dt_us)
    new = SplineReference(
        start_us, dt_us, np.concatenate([first, np.repeat(first[-1:], 7, 0)]), tilts=r.tilts
    )
    a, b = r.sample(np.array([t])), new.sample(np.array([t]))
    scale = np.maximum(np.abs(a.p_WD), np.abs(a.p_WD).max(axis=(0, 2))[None, :, None])
    np.testing.assert_allclose(b.p_WD / (scale + 1e-9), a.p_WD / (scale + 1e-9), atol=1e-8)
    np.testing.assert_allclose(b.R_WD, a.R_WD, atol=1e-6)


def test_replanning_again_and_again_along_the_same_way_changes_nothing():
    r = wander(7)
    times = np.arange(r.start_us + 77_000, r.end_us, 113_000)
    new = r
    for t in times:
        start_us, first = continuation(new, int(t), 300_000)
        rest = r.control[(start_us - r.start_us) // 300_000 + len(first) :]
        new = SplineReference(start_us, 300_000, np.concatenate([first, rest]))
    ahead = np.arange(times[-1], r.end_us, 50_000)
    np.testing.assert_allclose(new.sample(ahead).p_WD, r.sample(ahead).p_WD, atol=1e-12)


def test_a_continuation_of_another_kind_keeps_its_position_derivatives_and_yaw():
    drive = Drive(1.0, 0.7, 0.0, 0.0, -1.0, 0.0, np.inf)
    points = np.array([[0.0, 0, 0], [0.7, 0.2, 0], [1.5, 1.0, 0.5]])
    cubic = CubicReference(0, timed_cubic(points, np.zeros(3), drive, 0.5), 0.4)
    t = 1_234_000
    start_us, first = continuation(cubic, t, 300_000)
    new = SplineReference(start_us, 300_000, np.concatenate([first, np.repeat(first[-1:], 7, 0)]))
    a, b = cubic.sample(np.array([t])), new.sample(np.array([t]))
    np.testing.assert_allclose(b.p_WD, a.p_WD, atol=1e-8)
    np.testing.assert_allclose(b.R_WD[0, 0], a.R_WD[0, 0], atol=1e-10)


@pytest.mark.parametrize("seed", range(8))
def test_a_stop_is_smooth_quick_and_within_the_braking_limit(seed):
    r = wander(seed)
    t = int(np.random.default_rng(seed).integers(r.start_us, r.end_us - 1_500_000))
    stop = stop_reference(r, t, LIMITS)
    a, b = r.derivatives(t), stop.derivatives(t)
    np.testing.assert_allclose(b, a, atol=1e-7 * (1.0 + np.abs(a).max()))
    speed, flown = np.linalg.norm(a[1, :3]), r.max_acceleration_mps2()
    assert stop.max_acceleration_mps2() <= max(LIMITS.a_brake_mps2, flown) * 1.001
    assert stop.end_us - t <= 1e6 * (speed + flown) / LIMITS.a_brake_mps2 + 8 * stop.dt_us
    np.testing.assert_array_equal(stop.control[-8:], np.tile(stop.control[-1], (8, 1)))


def test_a_stop_on_a_tilted_cubic_keeps_its_yaw_and_its_tilt():
    drive = Drive(1.0, 0.7, 0.0, 0.0, -1.0, 0.0, np.inf)
    points = np.array([[0.0, 0, 0], [0.7, 0.2, 0], [1.5, 1.0, 0.5]])
    cubic = CubicReference(0, timed_cubic(points, np.zeros(3), drive, 0.5), 0.4)
    turned = with_tilt(cubic, 200_000, so3_exp(np.array([0.3, 0.2, 0.1])), 350_000)
    stop = stop_reference(turned, 1_000_000, LIMITS)
    after = np.array([1_000_000, stop.end_us])
    np.testing.assert_allclose(stop.sample(after).R_WD, turned.sample(after).R_WD, atol=1e-9)


def test_a_stop_from_cruise_takes_the_way_the_design_says():
    """About 3 knots of v, then v^2 / (2 a)."""
    even = np.arange(40)[:, None] * np.array([[0.45, 0.0, 0.0, 0.0]])
    r = SplineReference(0, 300_000, even)
    stop = stop_reference(r, 3_000_000, LIMITS)
    way = stop.control[-1, 0] - r.sample(np.array([3_000_000])).p_WD[0, 0, 0]
    assert way == pytest.approx(1.5 * 3 * 0.15 + 1.5**2 / 6.0, abs=0.02)


def test_a_restart_begins_at_the_measured_state_and_comes_to_rest():
    p, v = np.array([1.0, 2.0, 3.0]), np.array([1.0, -0.5, 0.2])
    r = restart_reference(p, v, 0.4, 5_000_000, LIMITS)
    d = r.derivatives(5_000_000)
    np.testing.assert_allclose(d[0], [1.0, 2.0, 3.0, 0.4], atol=1e-12)
    np.testing.assert_allclose(d[1], [1.0, -0.5, 0.2, 0.0], atol=1e-12)
    np.testing.assert_allclose(d[2:], 0.0, atol=1e-6)
    assert r.max_acceleration_mps2() <= LIMITS.a_brake_mps2
    np.testing.assert_allclose(r.derivatives(r.end_us)[1:5], 0.0, atol=1e-9)


def test_remaining_time_counts_down_to_zero():
    r = wander(3)
    assert remaining_time(r, r.end_us - 250_000) == pytest.approx(0.25)
    assert remaining_time(r, r.end_us + 1) == 0.0


def test_malformed_control_points_are_refused():
    with pytest.raises(GeometryError, match=r"control points must be .* got \(7, 4\)"):
        SplineReference(0, 300_000, np.zeros((7, 4)))
