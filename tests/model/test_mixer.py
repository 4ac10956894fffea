# SPDX-License-Identifier: Apache-2.0
"""Tests of `model.mixer`: rotor thrusts of an X quadrotor and their limits."""

import numpy as np
import pytest

from skyhaul.model import Team, rotors_to_wrench, saturate_rotors, wrench_to_rotors
from skyhaul.model.mixer import ROTOR_DIR_B, ROTOR_SPIN
from skyhaul.model.team import VehicleOverride

TEAM = Team(count=3, overrides=(VehicleOverride(index=1, thrust_max_n=6.0),))
LOW = 0.25 * TEAM.arrays().thrust_min[:, None]
HIGH = 0.25 * TEAM.arrays().thrust_max[:, None]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.mark.parametrize("k", range(4))
def test_wrench_of_one_rotor_is_its_force_and_moment(k):
    f, arm, ratio = 1.7, TEAM.vehicle.arm_m, TEAM.vehicle.torque_per_thrust_m
    lever = np.cross(np.append(arm * ROTOR_DIR_B[k], 0.0), [0.0, 0.0, f])
    moment = lever + np.array([0.0, 0.0, ROTOR_SPIN[k] * ratio * f])
    got = rotors_to_wrench(TEAM, f * np.eye(4)[k])
    np.testing.assert_allclose(got, np.append(f, moment), atol=1e-15)


def test_rotors_stand_as_documented():
    front, left = ROTOR_DIR_B[:, 0] > 0.0, ROTOR_DIR_B[:, 1] > 0.0
    np.testing.assert_array_equal(front, [True, False, False, True])
    np.testing.assert_array_equal(left, [True, True, False, False])
    np.testing.assert_allclose(np.linalg.norm(ROTOR_DIR_B, axis=1), 1.0)
    assert np.all(ROTOR_SPIN + np.roll(ROTOR_SPIN, 1) == 0.0)  # neighbours turn against each other


def test_wrench_round_trip_without_limits(rng):
    wrench = rng.normal(size=(5, 3, 4))
    back = rotors_to_wrench(TEAM, wrench_to_rotors(TEAM.arrays(), wrench))
    np.testing.assert_allclose(back, wrench, atol=1e-13)


def test_wrench_within_the_limits_is_given_exactly(rng):
    rotors = rng.uniform(LOW, HIGH, size=(200, 3, 4))
    for row in rotors:
        got = saturate_rotors(TEAM, rotors_to_wrench(TEAM, row))
        np.testing.assert_allclose(got, row, atol=1e-13)


def random_wrenches(rng, count):
    return rng.normal(size=(count, 3, 4)) * [1.0, 0.05, 0.05, 0.02] + [2.5, 0, 0, 0]


def test_no_rotor_leaves_its_limits(rng):
    for wrench in random_wrenches(rng, 500):
        rotors = saturate_rotors(TEAM, wrench)
        assert np.all((rotors >= LOW) & (rotors <= HIGH))


def test_yaw_is_given_up_before_thrust_roll_and_pitch(rng):
    tilting = 0
    for wrench in random_wrenches(rng, 500):
        without_yaw = wrench * [1, 1, 1, 0]
        rotors = wrench_to_rotors(TEAM, without_yaw)
        fits = np.all((rotors >= LOW) & (rotors <= HIGH), axis=1)
        got = rotors_to_wrench(TEAM, saturate_rotors(TEAM, wrench))
        np.testing.assert_allclose(got[fits, :3], wrench[fits, :3], atol=1e-12)
        assert np.all(got[:, 3] * wrench[:, 3] >= -1e-12)
        assert np.all(np.abs(got[:, 3]) <= np.abs(wrench[:, 3]) + 1e-12)
        tilting += fits.sum()
    assert tilting > 300


def test_roll_and_pitch_survive_a_thrust_beyond_the_limits():
    wrench = np.array([[9.0, 0.05, -0.03, 0.0], [-4.0, 0.05, -0.03, 0.0], [3.0, 0.05, 0.0, 0.0]])
    rotors = saturate_rotors(TEAM, wrench)
    got = rotors_to_wrench(TEAM, rotors)
    np.testing.assert_allclose(got[:, 1:3], wrench[:, 1:3], atol=1e-14)
    assert rotors[0].max() == pytest.approx(HIGH[0, 0])
    assert rotors[1].min() == pytest.approx(LOW[1, 0])


def test_roll_and_pitch_shrink_together_where_they_do_not_fit():
    wrench = np.tile([2.0, 0.4, 0.2, 0.01], (3, 1))
    got = rotors_to_wrench(TEAM, saturate_rotors(TEAM, wrench))
    np.testing.assert_allclose(got[:, 1] / got[:, 2], 2.0, rtol=1e-12)
    assert np.all((got[:, 1] > 0.0) & (got[:, 1] < 0.4))


def test_as_much_yaw_as_fits_is_given():
    wrench = np.tile([3.0, 0.01, 0.02, 1.0], (3, 1))
    rotors = saturate_rotors(TEAM, wrench)
    at_limit = np.isclose(rotors, LOW) | np.isclose(rotors, HIGH)
    assert at_limit.any(axis=1).all()
