# SPDX-License-Identifier: Apache-2.0
"""Tests of `control.force_plan`. Each name states the property it checks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from skyhaul.control.api import ForcePlan
from skyhaul.control.force_plan import (
    load_error,
    load_error_rates,
    plan_arrays,
    sample_forces,
    sample_plan,
)

STAMP_US = 3_000_000


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def random_load(rng, size=1.0):
    x = size * rng.normal(size=13)
    x[3:7] = Rotation.from_rotvec(0.5 * size * rng.normal(size=3)).as_quat(scalar_first=True)
    return x


@pytest.fixture
def plan(rng):
    """Cubic force and position curves through uneven nodes."""
    node = np.array([0.0, 0.05, 0.12, 0.3])
    n, K = 3, len(node)
    poly = rng.normal(size=(4, n, 3))
    powers = node[:, None, None, None] ** np.arange(4)[:, None, None]
    rates = np.arange(1, 4)[:, None, None] * powers[:, :3]
    return ForcePlan(
        stamp_us=STAMP_US,
        node_s=node,
        load=np.array([random_load(rng) for _ in node]),
        accel_W=rng.normal(size=(K, 3)),
        force_W=np.sum(poly * powers, axis=1),
        dforce_W=np.sum(poly[1:] * rates, axis=1),
        gain=rng.normal(size=(K, n, 3, 12)),
        thrust=rng.uniform(2.0, 4.0, size=(K, n)),
        active=np.ones(n, dtype=bool),
    ), poly


@pytest.mark.parametrize("t", [0.0, 0.02, 0.05, 0.11, 0.29])
def test_cubic_forces_are_reproduced_with_two_derivatives(plan, t):
    plan, poly = plan
    sample = sample_plan(plan, STAMP_US + round(1e6 * t))
    for k, got in enumerate((sample.force_W, sample.dforce_W, sample.ddforce_W)):
        weight = [np.prod(np.arange(j - k + 1, j + 1)) * t ** max(j - k, 0) for j in range(4)]
        weight = [w if j >= k else 0.0 for j, w in enumerate(weight)]
        np.testing.assert_allclose(got, np.einsum("j,jab->ab", weight, poly), atol=1e-9)


def test_nodes_come_back_as_they_are(plan):
    plan, _ = plan
    for k, t in enumerate(plan.node_s[:-1]):
        sample = sample_plan(plan, STAMP_US + round(1e6 * t))
        np.testing.assert_allclose(sample.load, plan.load[k], atol=1e-12)
        np.testing.assert_allclose(sample.accel_W, plan.accel_W[k], atol=1e-12)
        np.testing.assert_allclose(sample.gain, plan.gain[k], atol=1e-12)
        np.testing.assert_allclose(sample.thrust, plan.thrust[k], atol=1e-12)


def test_position_follows_velocity_at_the_nodes_and_attitude_is_slerp(plan):
    plan, _ = plan
    t, h = 0.09, 1e-6
    a, b = (sample_plan(plan, STAMP_US + round(1e6 * s)) for s in (0.05, 0.05 + h))
    np.testing.assert_allclose((b.load[:3] - a.load[:3]) / h, plan.load[1, 7:10], rtol=5e-3)
    q = Rotation.from_quat(plan.load[1:3, 3:7], scalar_first=True)
    expected = Slerp([0.05, 0.12], q)(t)
    got = Rotation.from_quat(sample_plan(plan, STAMP_US + 90_000).load[3:7], scalar_first=True)
    assert (expected.inv() * got).magnitude() < 1e-9


@pytest.mark.parametrize("late_us", [300_000, 5_000_000])
def test_after_its_end_a_plan_rests_at_its_last_node(plan, late_us):
    plan, _ = plan
    sample = sample_plan(plan, STAMP_US + late_us)
    np.testing.assert_array_equal(sample.load[:7], plan.load[-1, :7])
    np.testing.assert_array_equal(sample.load[7:], 0.0)
    np.testing.assert_array_equal(sample.force_W, plan.force_W[-1])
    np.testing.assert_array_equal(sample.dforce_W, 0.0)


def test_before_its_start_a_plan_is_taken_at_its_start(plan):
    plan, _ = plan
    early, start = sample_plan(plan, STAMP_US - 10**6), sample_plan(plan, STAMP_US)
    np.testing.assert_allclose(early.load, start.load, atol=1e-12)
    np.testing.assert_allclose(early.force_W, start.force_W, atol=1e-12)


def test_a_plan_of_one_node_is_constant(plan):
    plan, _ = plan
    fields = ("node_s", "load", "accel_W", "force_W", "dforce_W", "gain", "thrust")
    one = replace(plan, **{name: getattr(plan, name)[:1] for name in fields})
    out = np.empty((3, 3, 3))
    sample_forces(plan_arrays(one), 7.0, out)
    np.testing.assert_array_equal(out[0], plan.force_W[0])
    np.testing.assert_array_equal(out[1:], 0.0)


def error_of(load, planned):
    e = np.empty(12)
    load_error(load, planned, e)
    return e


def test_error_is_actual_minus_planned_and_blind_to_the_sign_of_quaternions(rng):
    planned = np.concatenate([random_load(rng), np.zeros(6)])
    load = random_load(rng)
    e = error_of(load, planned)
    R, R_d = (Rotation.from_quat(x[3:7], scalar_first=True) for x in (load, planned))
    np.testing.assert_allclose(e[:3], load[:3] - planned[:3])
    np.testing.assert_allclose(e[3:6], (R_d.inv() * R).as_rotvec(), atol=1e-12)
    np.testing.assert_allclose(e[6:9], load[7:10] - planned[7:10])
    w_D = (R.inv() * R_d).apply(planned[10:13])
    np.testing.assert_allclose(e[9:], load[10:13] - w_D, atol=1e-12)
    flipped = load.copy()
    flipped[3:7] *= -1.0
    np.testing.assert_allclose(error_of(flipped, planned), e, atol=1e-12)


def test_error_rates_match_finite_differences(rng):
    """Two rigid motions with constant (angular) accelerations, close to each other."""
    h = 1e-4
    a, dw, a_d, dw_d = rng.normal(size=(4, 3))
    planned = np.concatenate([random_load(rng), a_d, dw_d])
    load = planned[:13] + 1e-3 * rng.normal(size=13)
    q = Rotation.from_quat(planned[3:7], scalar_first=True)
    load[3:7] = (q * Rotation.from_rotvec(1e-3 * rng.normal(size=3))).as_quat(scalar_first=True)

    def moved(x, acc, dw_L, dt):
        y = x.copy()
        y[:3] += dt * x[7:10] + 0.5 * dt * dt * acc
        turn = Rotation.from_rotvec(dt * x[10:13] + 0.5 * dt * dt * dw_L)
        y[3:7] = (Rotation.from_quat(x[3:7], scalar_first=True) * turn).as_quat(scalar_first=True)
        y[7:10] += dt * acc
        y[10:13] += dt * dw_L
        return y

    def at(dt):
        reference = np.concatenate([moved(planned[:13], a_d, dw_d, dt), a_d, dw_d])
        return error_of(moved(load, a, dw, dt), reference)

    far = random_load(rng)  # the two velocity rows are exact at any distance

    def far_at(dt):
        reference = np.concatenate([moved(planned[:13], a_d, dw_d, dt), a_d, dw_d])
        return error_of(moved(far, a, dw, dt), reference)

    out = np.empty((2, 12))
    load_error_rates(far, planned, np.concatenate([a, dw]), far_at(0.0), out)
    np.testing.assert_allclose(out[0, 6:], (far_at(h) - far_at(-h))[6:] / (2.0 * h), atol=1e-4)
    load_error_rates(load, planned, np.concatenate([a, dw]), at(0.0), out)
    np.testing.assert_allclose(out[0], (at(h) - at(-h)) / (2.0 * h), atol=5e-3)
    np.testing.assert_allclose(out[1, :6], out[0, 6:], atol=1e-12)
