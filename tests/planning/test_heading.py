# SPDX-License-Identifier: Apache-2.0
"""Planned headings: outward, along the motion, limited, smooth, continued without a jump."""

import numpy as np
import pytest

from skyhaul.planning.heading import Heading, fan_out
from skyhaul.planning.reference import resting_reference, stop_reference
from skyhaul.planning.tasks import leg_reference, task_reference
from skyhaul.world.scenario import CircleTask, Limits

LIMITS = Limits(v_max_mps=2.0, a_max_mps2=1.7)
CIRCLE = task_reference(CircleTask(), np.array([1.0, 2.0, 3.0]), 0.0, 0, LIMITS)
FOUR = np.deg2rad([225.0, 135.0, 315.0, 45.0])
ROUND = leg_reference(np.array([[0.0, 0, 1], [4, 0, 1], [4, 4, 1], [0, 4, 1]]), 0.0, 0, LIMITS)


def ring(n):
    return np.pi / n + 2 * np.pi * np.arange(n) / n


def away(yaw, direction):
    """Angle between headings and a direction [rad]."""
    return np.abs(np.angle(np.exp(1j * (yaw - direction))))


@pytest.mark.parametrize("n", [1, 3, 4, 5])
def test_the_team_looks_evenly_all_round(n):
    yaw = fan_out(CIRCLE, ring(n), 0).sample(np.array([20_000_000]))[0, :, 0]
    gaps = np.diff(np.sort(yaw % (2 * np.pi)))
    np.testing.assert_allclose(gaps, np.full(n - 1, 2 * np.pi / n), atol=1e-9)


@pytest.mark.parametrize("n", [3, 4, 8])
def test_every_vehicle_looks_outward_within_its_sector(n):
    t = np.arange(0, CIRCLE.end_us, 500_000)
    yaw = fan_out(CIRCLE, ring(n), 0).sample(t)[:, :, 0]
    assert away(yaw, ring(n)).max() <= 1.2 * np.pi / n + 1e-9


def test_on_a_circle_some_vehicle_looks_near_the_motion():
    t = np.arange(15_000_000, 35_000_000, 100_000)
    v = CIRCLE.sample(t).p_WD[:, 1]
    yaw = fan_out(CIRCLE, FOUR, 0).sample(t)[:, :, 0]
    off = away(yaw, np.arctan2(v[:, 1], v[:, 0])[:, None]).min(axis=1)
    assert np.median(off) < np.deg2rad(20.0)
    assert off.max() < np.deg2rad(50.0)


def test_a_straight_flight_is_watched_by_one_vehicle_and_its_neighbours_keep_outward():
    leg = leg_reference(np.array([[0.0, 0, 1], [9, 4, 1]]), 0.0, 0, LIMITS)
    yaw = fan_out(leg, FOUR, 0).sample(np.array([leg.end_us // 2]))[0, :, 0]
    assert away(yaw, np.arctan2(4, 9)).min() < np.deg2rad(1.0)
    assert away(yaw, FOUR).max() <= np.pi / 4


def test_the_fan_turns_with_the_load():
    turned = resting_reference(np.zeros(3), 1.5, 0)
    yaw = fan_out(turned, FOUR, 0).sample(np.array([12_000_000]))[0, :, 0]
    assert away(yaw, FOUR + 1.5).max() <= 1.2 * np.pi / 4 + 1e-6


@pytest.mark.parametrize("reference", [CIRCLE, ROUND], ids=["circle", "corners"])
def test_rate_and_acceleration_are_limited(reference):
    fan = fan_out(reference, FOUR, 0).fan(np.arange(0, reference.end_us + 2_000_000, 7_000))
    assert np.rad2deg(np.abs(fan[:, 1])).max() <= 45.0 + 1e-6
    assert np.rad2deg(np.abs(fan[:, 2])).max() <= 90.0 + 1e-6


def test_derivatives_are_slopes():
    plan, t, h = fan_out(ROUND, FOUR, 0), np.arange(1_030_000, 8_000_000, 200_000), 100
    a, b, c = (plan.sample(t + s * h) for s in (-1, 0, 1))
    for k in (0, 1):
        slope = (c[..., k] - a[..., k]) / (2e-6 * h)
        np.testing.assert_allclose(slope, b[..., k + 1], atol=1e-3)


def test_a_load_at_rest_keeps_the_heading():
    plan = fan_out(resting_reference(np.zeros(3), 0.0, 0), FOUR, 0, before=0.6)
    np.testing.assert_allclose(plan.fan(np.arange(0, 5_000_000, 500_000))[:, 0], 0.6)


@pytest.mark.parametrize("t_us", [6_000_000, 6_050_000, 12_345_678])
def test_replanning_keeps_heading_rate_and_acceleration(t_us):
    before = fan_out(CIRCLE, FOUR, 0)
    after = fan_out(stop_reference(CIRCLE, t_us, LIMITS), FOUR, t_us, before)
    now = np.array([t_us])
    np.testing.assert_allclose(after.sample(now), before.sample(now), atol=1e-12)


def test_parameters_out_of_range_are_refused():
    with pytest.raises(ValueError, match="rate_dps must be > 0, got 0"):
        Heading(rate_dps=0.0)
