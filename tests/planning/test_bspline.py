# SPDX-License-Identifier: Apache-2.0
"""Septic B-splines against scipy, and the properties that the references build on."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from skyhaul.planning.bspline import (
    BASIS,
    FROM_KNOT,
    KNOT_WEIGHTS,
    control_from_derivatives,
    evaluate,
    evaluate_position,
    interpolate,
    largest_derivatives,
)

DT = 0.3


def derivatives(control, time, dt=DT) -> np.ndarray:
    out = np.empty((7, control.shape[1]))
    evaluate(control, dt, time, out, BASIS)
    return out


def wander(seed, m=20, c=4) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(size=(m, c)) * 0.2, axis=0)


@pytest.mark.parametrize("seed", range(3))
def test_value_and_all_derivatives_agree_with_scipy(seed):
    control = wander(seed)
    spline = BSpline(DT * (np.arange(len(control) + 8) - 7.0), control, 7)
    for time in np.random.default_rng(seed).uniform(0.0, 13 * DT, 20):
        expected = np.array([spline(time, nu=k) for k in range(7)])
        np.testing.assert_allclose(derivatives(control, time), expected, rtol=1e-7, atol=1e-7)
        p = np.empty(3)
        evaluate_position(control, DT, time, p, BASIS)
        np.testing.assert_allclose(p, expected[0, :3], rtol=1e-12)


def test_derivatives_0_to_6_are_continuous_at_every_knot():
    control = wander(1)
    for knot in range(1, 13):
        before, after = (derivatives(control, DT * (knot + e)) for e in (-1e-12, 1e-12))
        np.testing.assert_allclose(before, after, rtol=1e-6, atol=1e-6)


def test_a_straight_control_polygon_gives_even_motion():
    control = np.arange(20)[:, None] * np.array([[0.1, -0.2, 0.05, 0.0]])
    d = derivatives(control, 2.2)
    np.testing.assert_allclose(d[0], (2.2 / DT + 3.0) * control[1], rtol=1e-12)
    np.testing.assert_allclose(d[1], control[1] / DT, rtol=1e-12)
    np.testing.assert_allclose(d[2:], 0.0, atol=1e-6)


def test_the_kth_derivative_stays_within_the_kth_differences():
    control = wander(2)
    top = largest_derivatives(control, DT, BASIS, 20)
    for k in range(1, 7):
        differences = np.linalg.norm(np.diff(control[:, :3], k, axis=0), axis=1) / DT**k
        assert 0.2 * differences.max() < top[k] <= differences.max() * (1.0 + 1e-9)


@pytest.mark.parametrize("ratio", [1.0, 0.5, 0.31])
@pytest.mark.parametrize("time", [1.2, 1.37, 2.09])
def test_control_points_from_derivatives_go_on_without_a_jump(time, ratio):
    control, dt = wander(3), ratio * DT
    first = control_from_derivatives(derivatives(control, time), dt)
    after = np.concatenate([first, wander(4, 3) + first[-1]])
    np.testing.assert_allclose(
        derivatives(after, 0.0, dt), derivatives(control, time), rtol=1e-7, atol=1e-6
    )


@pytest.mark.parametrize("ratio", [0.66, 0.5])
def test_closer_knots_hardly_stick_out_of_the_old_control_points(ratio):
    control, rng = wander(5), np.random.default_rng(0)
    for time in rng.uniform(0.0, 12 * DT, 30):
        first = control_from_derivatives(derivatives(control, time), ratio * DT)
        old = control[int(time / DT) : int(time / DT) + 8]
        for direction in rng.normal(size=(20, 4)):
            reach = old @ direction
            assert np.max(first @ direction) <= np.max(reach) + 0.1 * np.ptp(reach)


def test_the_inverse_of_the_knot_weights_is_exact():
    np.testing.assert_allclose(FROM_KNOT @ KNOT_WEIGHTS, np.eye(7), atol=1e-12)


def test_interpolation_passes_through_the_values_and_rests_at_both_ends():
    values = np.cumsum(np.random.default_rng(6).normal(size=(30, 2)), axis=0)
    control = interpolate(values, rest=12)
    found = np.array([derivatives(control, DT * (q + 12))[0] for q in range(30)])
    np.testing.assert_allclose(found, values, atol=1e-9)
    for time in (0.0, DT * (12 + 29 + 12)):
        np.testing.assert_allclose(derivatives(control, time)[1], 0.0, atol=2e-2)
