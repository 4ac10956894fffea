# SPDX-License-Identifier: Apache-2.0
"""Tests of `plant.rotors`."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skyhaul.model.team import Team, Vehicle
from skyhaul.plant.rotors import rotor_lag

ALIVE = np.ones(2, dtype=np.bool_)


def advance(team, command, thrust, dt, alive=ALIVE):
    thrust, mean = thrust.copy(), np.empty_like(thrust)
    rotor_lag(team.arrays(), alive, command, dt, thrust, mean)
    return thrust, mean


def two(lag):
    return Team(count=2, vehicle=Vehicle(motor_lag_s=lag, thrust_min_n=0.4, thrust_max_n=4.0))


def test_lag_is_the_exact_solution_and_its_mean():
    rng = np.random.default_rng(0)
    command, start = rng.uniform(0.1, 1.0, (2, 2, 4))
    end, mean = advance(two(0.03), command, start, 0.01)
    ode = solve_ivp(
        lambda _, x: np.concatenate([(command.ravel() - x[:8]) / 0.03, x[:8]]),
        (0.0, 0.01),
        np.concatenate([start.ravel(), np.zeros(8)]),
        rtol=1e-12,
        atol=1e-14,
    ).y[:, -1]
    np.testing.assert_allclose(end.ravel(), ode[:8], rtol=1e-9)
    np.testing.assert_allclose(0.01 * mean.ravel(), ode[8:], rtol=1e-9)


def test_two_half_steps_are_one_step():
    start, command = np.full((2, 4), 0.3), np.full((2, 4), 0.9)
    whole, mean = advance(two(0.03), command, start, 0.004)
    half, first = advance(two(0.03), command, start, 0.002)
    both, second = advance(two(0.03), command, half, 0.002)
    np.testing.assert_allclose(both, whole, rtol=1e-14)
    np.testing.assert_allclose(0.5 * (first + second), mean, rtol=1e-14)


def test_commands_are_clipped_rotor_by_rotor():
    command = np.array([[-5.0, 0.05, 0.5, 9.0]] * 2)
    end, mean = advance(two(0.0), command, np.full((2, 4), 0.7), 0.002)
    np.testing.assert_allclose(end, [[0.1, 0.1, 0.5, 1.0]] * 2)
    np.testing.assert_array_equal(mean, end)


def test_the_rotors_of_a_dead_vehicle_run_down_to_nothing():
    thrust, alive = np.full((2, 4), 0.8), np.array([True, False])
    for _ in range(100):
        thrust, _ = advance(two(0.03), np.full((2, 4), 0.8), thrust, 0.002, alive)
    np.testing.assert_allclose(thrust[0], 0.8)
    np.testing.assert_allclose(thrust[1], 0.8 * np.exp(-0.2 / 0.03))
    assert np.all(thrust[1] < 0.1)  # below the smallest thrust of a live rotor


@pytest.mark.parametrize("dt", [0.002, 0.2])
def test_thrust_never_overshoots(dt):
    thrust, command = np.full((2, 4), 0.2), np.full((2, 4), 0.9)
    for _ in range(20):
        after, mean = advance(two(0.03), command, thrust, dt)
        assert np.all((thrust <= mean) & (mean <= after) & (after <= command))
        thrust = after
