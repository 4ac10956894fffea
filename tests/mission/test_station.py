# SPDX-License-Identifier: Apache-2.0
"""Routes of vehicles without load: smooth, bounded in speed, the same way back."""

from itertools import pairwise

import numpy as np
import pytest

from skyhaul.geometry.so3 import so3_exp
from skyhaul.mission.station import StationParams, route_along, station_point
from skyhaul.model import Team

DT_S = 2e-3
STRAIGHT = np.array([[0.0, 0.0, 0.0], [1.0, -2.0, 2.0]])
BENT = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.5], [4.0, 3.0, 1.5], [4.0, 3.0, 1.0]])


def run(params, route, seconds, *, forwards=True):
    """Route after a time, and the setpoints on the way, one each tick."""
    points = []
    for _ in range(round(seconds / DT_S)):
        route = params.advance(route, DT_S, forwards=forwards)
        points.append(params.setpoint(route))
    return route, points


def stacked(points):
    return tuple(np.array(rows) for rows in zip(*points, strict=True))


def run_out(params, route):
    return run(params, route, params.duration_s(route) + params.turn_s)


@pytest.mark.parametrize("corners", [STRAIGHT, BENT])
@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_the_route_leads_from_end_to_end_at_rest_within_the_speed(corners, speed):
    params = StationParams(speed_mps=speed)
    start = params.setpoint(route_along(corners))
    route, points = run_out(params, route_along(corners))
    p, v, _ = stacked(points)
    assert params.arrived(route)
    np.testing.assert_allclose(start.p_WD, corners[0])
    np.testing.assert_allclose(p[-1], corners[-1], atol=1e-12)
    np.testing.assert_allclose([start.v_WD, v[-1]], 0.0, atol=1e-12)
    top = np.linalg.norm(v, axis=1).max()
    assert 0.99 * speed < top <= speed + 1e-9


def test_every_point_of_the_way_lies_on_the_polyline():
    params = StationParams()
    p, _, _ = stacked(run_out(params, route_along(BENT))[1])
    legs = list(pairwise(BENT))

    def off(q, a, b):
        s = np.clip((q - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        return np.linalg.norm(q - a - s * (b - a))

    assert max(min(off(q, a, b) for a, b in legs) for q in p) < 1e-9


def test_velocity_is_the_derivative_of_the_place_there_and_back():
    params = StationParams()
    route, there = run(params, route_along(STRAIGHT), 3.0)
    _, back = run(params, route, 2.0, forwards=False)
    p, v, _ = stacked(there + back)
    np.testing.assert_allclose(np.diff(p, axis=0) / DT_S, 0.5 * (v[1:] + v[:-1]), atol=4e-3)
    assert (np.diff(p @ (STRAIGHT[1] - STRAIGHT[0])) < 0.0).any()  # it did turn


def test_acceleration_is_the_derivative_of_the_velocity_at_full_rate():
    params = StationParams()
    _, points = run(params, route_along(STRAIGHT), 5.0)
    _, v, a = stacked(points[round(params.turn_s / DT_S) :])
    np.testing.assert_allclose(np.diff(v, axis=0) / DT_S, 0.5 * (a[1:] + a[:-1]), atol=5e-3)


@pytest.mark.parametrize("seconds", [0.3, 1.7, 3.0])
def test_the_way_back_leads_to_where_the_route_began(seconds):
    params = StationParams()
    route, _ = run(params, route_along(BENT), seconds)
    assert 0.0 < route.progress_s < params.duration_s(route)
    route, points = run(params, route, seconds + 2.0 * params.turn_s, forwards=False)
    assert route.progress_s == 0.0
    assert route.rate == 0.0
    np.testing.assert_allclose(points[-1].p_WD, BENT[0])
    route, points = run_out(params, route)
    assert params.arrived(route)
    np.testing.assert_allclose(points[-1].p_WD, BENT[-1])


def test_turning_does_not_jump():
    params = StationParams()
    route, there = run(params, route_along(STRAIGHT), 2.5)
    _, back = run(params, route, 1.0, forwards=False)
    _, v, _ = stacked(there + back)
    top = params.speed_mps * 2.0 / params.turn_s + 1.6 * params.speed_mps
    assert np.linalg.norm(np.diff(v, axis=0), axis=1).max() < top * DT_S


def test_a_route_without_length_is_arrived_at_once_and_stays_there():
    params = StationParams()
    here = np.tile([1.0, 2.0, 3.0], (2, 1))
    route, points = run(params, route_along(here), 0.1)
    assert params.arrived(route)
    p, v, _ = stacked(points)
    np.testing.assert_array_equal(p, np.tile(here[0], (len(p), 1)))
    np.testing.assert_array_equal(v, 0.0)


@pytest.mark.parametrize("share", [0.5, 0.93, 1.0])
def test_a_station_is_a_share_of_the_cable_from_its_hook_and_turns_with_the_load(share):
    team = Team(count=5, cable_length_m=1.3)
    p_WL, R_WL = np.array([1.0, 2.0, 0.04]), so3_exp(np.array([0.0, 0.0, 0.7]))
    places = np.array([station_point(team, p_WL, R_WL, i, share) for i in range(5)])
    hooks = p_WL + team.hooks_L() @ R_WL.T
    np.testing.assert_allclose(np.linalg.norm(places - hooks, axis=1), share * 1.3)
    level = np.array([station_point(team, np.zeros(3), np.eye(3), i, share) for i in range(5)])
    np.testing.assert_allclose(places, p_WL + level @ R_WL.T)
    np.testing.assert_allclose((places - hooks)[:, 2], share * 1.3 * np.cos(team.cable_angle_rad))


@pytest.mark.parametrize("name", ["speed_mps", "creep_mps", "taut_n", "turn_s", "clear_m"])
def test_parameters_that_must_be_positive(name):
    with pytest.raises(ValueError, match=f"{name} must be > 0, got 0"):
        StationParams(**{name: 0.0})


def test_a_station_out_of_reach_of_the_cable_is_refused():
    with pytest.raises(ValueError, match=r"slack_share must lie in \[0.5, 1\), got 1"):
        StationParams(slack_share=1.0)
