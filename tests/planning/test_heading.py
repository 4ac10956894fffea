# SPDX-License-Identifier: Apache-2.0
"""Planned headings: fanned out, limited, smooth, continued without a jump."""

import numpy as np
import pytest

from skyhaul.planning.heading import Heading, fan_out
from skyhaul.planning.reference import resting_reference, stop_reference
from skyhaul.planning.tasks import leg_reference, task_reference
from skyhaul.world.scenario import CircleTask, Limits

LIMITS = Limits(v_max_mps=2.0, a_max_mps2=1.7)
CIRCLE = task_reference(CircleTask(), np.array([1.0, 2.0, 3.0]), 0.0, 0, LIMITS)
ROUND = leg_reference(np.array([[0.0, 0, 1], [4, 0, 1], [4, 4, 1], [0, 4, 1]]), 0.0, 0, LIMITS)


@pytest.mark.parametrize("n", [1, 3, 4, 5])
def test_the_team_looks_evenly_all_round(n):
    yaw = fan_out(CIRCLE, n, 0).sample(np.array([20_000_000]))[0, :, 0]
    gaps = np.diff(np.sort(yaw % (2 * np.pi)))
    np.testing.assert_allclose(gaps, 2 * np.pi / n, atol=1e-9)


def test_the_first_vehicle_looks_where_the_load_goes():
    t = np.arange(15_000_000, 35_000_000, 1_000_000)
    v = CIRCLE.sample(t).p_WD[:, 1]
    yaw = fan_out(CIRCLE, 4, 0).sample(t)[:, 0, 0]
    off = np.angle(np.exp(1j * (yaw - np.arctan2(v[:, 1], v[:, 0]))))
    assert np.abs(off).max() < np.deg2rad(12.0)


@pytest.mark.parametrize("reference", [CIRCLE, ROUND], ids=["circle", "corners"])
def test_rate_and_acceleration_are_limited(reference):
    fan = fan_out(reference, 4, 0).fan(np.arange(0, reference.end_us + 2_000_000, 7_000))
    assert np.rad2deg(np.abs(fan[:, 1])).max() <= 45.0 + 1e-6
    assert np.rad2deg(np.abs(fan[:, 2])).max() <= 90.0 + 1e-6


def test_derivatives_are_slopes():
    plan, t, h = fan_out(ROUND, 4, 0), np.arange(1_030_000, 8_000_000, 200_000), 100
    a, b, c = (plan.sample(t + s * h) for s in (-1, 0, 1))
    for k in (0, 1):
        slope = (c[..., k] - a[..., k]) / (2e-6 * h)
        np.testing.assert_allclose(slope, b[..., k + 1], atol=1e-3)


def test_a_load_at_rest_keeps_the_heading():
    plan = fan_out(resting_reference(np.zeros(3), 0.0, 0), 4, 0, before=1.2)
    np.testing.assert_allclose(plan.fan(np.arange(0, 5_000_000, 500_000))[:, 0], 1.2)


@pytest.mark.parametrize("t_us", [6_000_000, 6_050_000, 12_345_678])
def test_replanning_keeps_heading_rate_and_acceleration(t_us):
    before = fan_out(CIRCLE, 4, 0)
    after = fan_out(stop_reference(CIRCLE, t_us, LIMITS), 4, t_us, before)
    now = np.array([t_us])
    np.testing.assert_allclose(after.sample(now), before.sample(now), atol=1e-12)


def test_parameters_out_of_range_are_refused():
    with pytest.raises(ValueError, match="rate_dps must be > 0, got 0"):
        Heading(rate_dps=0.0)
