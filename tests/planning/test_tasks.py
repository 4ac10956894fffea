# SPDX-License-Identifier: Apache-2.0
"""References of circles, eights, hovers and legs against the analytic curves."""

import numpy as np
import pytest

from skyhaul.errors import ConfigError
from skyhaul.planning.tasks import (
    leg_reference,
    lift_reference,
    phase_at,
    task_curve,
    task_reference,
    task_start_us,
)
from skyhaul.world.scenario import CircleTask, Figure8Task, HoverTask, Limits

P_WL = np.array([1.0, 2.0, 3.0])
FAST = Limits(v_max_mps=2.0, a_max_mps2=1.7)
TASKS = [CircleTask(), CircleTask(period_s=5.0, laps=2), Figure8Task(yaw_amplitude_deg=30.0)]


@pytest.mark.parametrize("task", TASKS, ids=lambda t: f"{t.kind}-{t.period_s}")
def test_the_spline_is_the_analytic_curve_to_a_micrometre(task):
    r = task_reference(task, P_WL, 0.3, 500_000, FAST)
    t = np.random.default_rng(0).uniform(task_start_us(r) - 1e6, r.end_us + 1e6, 2000)
    exact = task_curve(task, phase_at(task, (t - task_start_us(r)) / 1e6))
    s = r.sample(t)
    np.testing.assert_allclose(s.p_WD[:, 0], P_WL + exact[:, :3], atol=1e-6)
    yaw = np.arctan2(s.R_WD[:, 0, 1, 0], s.R_WD[:, 0, 0, 0])
    np.testing.assert_allclose(yaw, 0.3 + exact[:, 3], atol=1e-6)


def test_the_steady_circle_has_the_speed_and_acceleration_of_a_circle():
    r = task_reference(CircleTask(), P_WL, 0.0, 0, FAST)
    t = task_start_us(r) + 1e6 * np.linspace(11.0, 39.0, 50)
    d = r.sample(t).p_WD
    omega = 2.0 * np.pi / 10.0
    for k in range(1, 7):
        np.testing.assert_allclose(np.linalg.norm(d[:, k], axis=1), omega**k, rtol=1e-3)


@pytest.mark.parametrize("task", TASKS, ids=lambda t: f"{t.kind}-{t.period_s}")
def test_a_task_begins_and_ends_at_rest_where_it_began(task):
    r = task_reference(task, P_WL, 0.3, 500_000, FAST)
    s = r.sample(np.array([500_000, r.end_us]))
    np.testing.assert_allclose(s.p_WD[:, 0], [P_WL, P_WL], atol=1e-9)
    np.testing.assert_allclose(s.p_WD[:, 1:5], 0.0, atol=1e-6)


@pytest.mark.parametrize("task", TASKS, ids=lambda t: f"{t.kind}-{t.period_s}")
def test_the_run_up_takes_less_acceleration_than_the_laps(task):
    r = task_reference(task, P_WL, 0.0, 0, FAST)
    t = np.arange(0, r.end_us, 20_000)
    a = np.linalg.norm(r.sample(t).p_WD[:, 2], axis=1)
    steady = (t > task_start_us(r) + 1e6 * task.period_s) & (t < r.end_us - 1e6 * task.period_s)
    assert a.max() <= a[steady].max() * 1.001


def test_hovering_stays_for_the_time_asked():
    r = task_reference(HoverTask(duration_s=7.0), P_WL, 0.1, 1_000_000, FAST)
    assert r.end_us - 1_000_000 >= 7_000_000
    np.testing.assert_allclose(
        r.sample(np.array([4_000_000])).p_WD[0], [P_WL] + [[0.0] * 3] * 6, atol=1e-9
    )


def test_a_task_beyond_the_limits_is_one_clear_sentence():
    with pytest.raises(ConfigError, match=r"circle needs 1\.58 m/s\^2 but limits\.a_max_mps2 = 1"):
        task_reference(CircleTask(period_s=5.0), P_WL, 0.0, 0, Limits())
    with pytest.raises(ConfigError, match=r"figure8 needs .* m/s but limits\.v_max_mps = 1"):
        task_reference(Figure8Task(), P_WL, 0.0, 0, Limits(v_max_mps=1.0))


def test_a_lift_goes_straight_up_within_the_limits():
    r = lift_reference(P_WL, 0.6, 0.2, 0, Limits())
    d = r.sample(np.arange(0, r.end_us, 10_000)).p_WD
    np.testing.assert_allclose(d[:, 0, :2], np.tile(P_WL[:2], (len(d), 1)), atol=1e-12)
    assert np.all(np.diff(d[:, 0, 2]) >= -1e-12)
    np.testing.assert_allclose(d[-1, 0], [1.0, 2.0, 3.6], atol=1e-4)
    assert r.max_acceleration_mps2() <= 1.0
    assert r.max_jerk_mps3() <= 3.0


def test_a_leg_with_a_corner_passes_near_it_slowly():
    path = np.array([[0.0, 0, 1], [2.0, 0, 1], [2.0, 2.0, 1]])
    r = leg_reference(path, 0.0, 0, Limits())
    p = r.sample(np.arange(0, r.end_us, 10_000)).p_WD[:, 0]
    assert np.min(np.linalg.norm(p - path[1], axis=1)) < 0.05
    assert r.max_acceleration_mps2() <= 1.0 + 1e-9
