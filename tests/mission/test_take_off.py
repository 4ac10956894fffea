# SPDX-License-Identifier: Apache-2.0
"""The take-off foreseen: where everything will be, and which movers are in its way."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.shapes import Sphere
from skyhaul.mapping.api import OccupancyGrid
from skyhaul.mapping.mapper import static_map
from skyhaul.mission.station import TakeOffParams, station_point
from skyhaul.mission.take_off import is_clear, predict
from skyhaul.perception.api import Track

LOAD = np.array([0.0, 0.0, 0.04, 1.0, *np.zeros(9)])
PARKED = np.array([[-0.5, -0.5, 0.03], [-0.5, 0.5, 0.03], [0.5, -0.5, 0.03], [0.5, 0.5, 0.03]])
NOT_YET = np.full(4, np.inf)


@pytest.fixture
def from_floor(ground_stack):
    return predict(ground_stack, PARKED, LOAD, NOT_YET)


@pytest.fixture
def clear(ground_stack):
    """Whether the take-off is clear with one mover: `clear(place, velocity)`."""
    room = OccupancyGrid(np.zeros((40, 40, 40), np.bool_), np.full(3, -2.0), 0.1)
    empty = replace(static_map(room, ground_stack.shape), tube_horizon_s=6.0)

    def ask(p_WO, v_WO=(0.0, 0.0, 0.0), left_s=NOT_YET):
        track = Track(
            0, 0, Sphere(radius_m=0.15), np.array(p_WO, np.float64), np.eye(3),
            np.array(v_WO, np.float64), np.zeros((6, 6)), 0.0, 0.0,
        )  # fmt: skip
        world_map = replace(empty, tracks=(track,))
        return is_clear(ground_stack, world_map, 0, predict(ground_stack, PARKED, LOAD, left_s))

    return ask


def station(stack, i):
    return station_point(stack.team, LOAD[:3], np.eye(3), i, 1.0)


def test_vehicles_begin_where_they_are_parked_and_rise_from_their_stations(
    ground_stack, from_floor
):
    np.testing.assert_allclose(from_floor.p_WB[0], PARKED)
    stations = [station(ground_stack, i) for i in range(4)]
    np.testing.assert_allclose(from_floor.p_WB[from_floor.rises], stations, atol=1e-9)
    up = from_floor.p_WB[-1] - stations
    assert (up[:, 2] > 0.2).all()
    np.testing.assert_allclose(up[:, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(from_floor.p_WL[-1, 2] - LOAD[2], up[0, 2], atol=1e-9)


def test_cables_stretch_between_hooks_and_vehicles(ground_stack, from_floor):
    hooks = LOAD[:3] + ground_stack.team.hooks_L()
    low = np.linalg.norm(from_floor.p_WC[from_floor.rises, :4] - hooks, axis=1)
    np.testing.assert_allclose(low, 0.35 * ground_stack.team.cable_lengths_m(), rtol=1e-6)


def test_the_nearer_the_stations_the_sooner_the_team_rises(ground_stack, from_floor):
    halfway = predict(ground_stack, PARKED, LOAD, np.full(4, 0.5))
    there = predict(ground_stack, PARKED, LOAD, np.zeros(4))
    assert there.rises < halfway.rises < from_floor.rises
    np.testing.assert_allclose(there.p_WB[0, 3], station(ground_stack, 3))


def test_an_empty_sky_and_a_mover_far_off_are_clear(clear):
    assert clear((0.0, 0.0, 50.0))
    assert clear((3.0, 3.0, 1.0))


def test_a_mover_at_the_place_of_a_vehicle_is_not(clear, ground_stack):
    assert not clear(station(ground_stack, 3))
    assert not clear(0.5 * (station(ground_stack, 3) + PARKED[3]))


def test_a_mover_between_the_cables_is_not(clear):
    assert not clear((0.0, 0.0, 0.6))


def test_a_mover_beside_a_vehicle_may_pass_inside_the_teams_shape(clear, ground_stack):
    place = np.add(station(ground_stack, 3), [0.35, 0.35, 0.0])
    assert np.hypot(*place[:2]) < ground_stack.shape.radius_m + 0.15
    assert clear(place, (0.3, 0.3, 0.0))


def test_a_mover_counts_when_it_is_there_not_where_it_is(clear, ground_stack):
    place, v = station(ground_stack, 3), np.array([0.5, 0.5, 0.0])
    assert clear(place, v)  # gone before the vehicle comes
    assert clear(place - 9.0 * v, v)  # not there before the team is
    assert not clear(place - 2.0 * v, v)


def test_vehicles_on_their_stations_still_fear_what_comes_soon_and_nothing_that_passed(
    clear, ground_stack
):
    place, v, there = station(ground_stack, 3), np.array([0.5, 0.5, 0.0]), np.zeros(4)
    assert not clear(place - 1.0 * v, v, there)
    assert clear(place + 1.0 * v, v, there)


def test_a_mover_that_closes_in_on_the_rising_team_is_not_clear(clear, ground_stack, from_floor):
    begin_s = from_floor.ahead_s[from_floor.rises]
    v = np.array([0.6, 0.0, 0.0])
    top = np.array([-ground_stack.shape.radius_m - 0.25, 0.0, 1.0])
    assert not clear(top - begin_s * v, v)
    assert clear(np.add(top, [0.0, 0.0, 4.0]) - begin_s * v, v)


@pytest.mark.parametrize("name", ["tauten_s", "rise_s", "dodge_s", "margin_m", "closer_m"])
def test_parameters_below_zero_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be >= 0, got -1"):
        TakeOffParams(**{name: -1.0})
