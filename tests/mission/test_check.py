# SPDX-License-Identifier: Apache-2.0
"""Flights that their stack cannot fly are refused before they begin."""

import numpy as np
import pytest

from skyhaul.errors import ConfigError
from skyhaul.mission.check import check_flight, known_map
from skyhaul.mission.config import RunConfig
from skyhaul.planning.api import PlanStatus
from skyhaul.planning.astar import AStar
from skyhaul.world.load import load_config, scenario_names

ROOM = (
    "world.room={min_m: [-4, -4, 0], max_m: [6, 4, 5]}",
    "world.map={origin_m: [-4, -4, 0], size_m: [10, 8, 5]}",
    "start={kind: ground, payload_m: [0, 0]}",
    "task={kind: goto, goal_m: [2.5, 0, 1.5]}",
    "events=[]",
)
FLY_IN = (
    "start={kind: fly-in, payload_m: [0, 0], "
    "vehicles_m: [[2.5, 2.5], [-2.5, 2.5], [-2.5, -2.5], [2.5, -2.5]]}"
)


def config(*overrides):
    return load_config(RunConfig, "lost-vehicle", (*ROOM, *overrides))


def box(x, y, z, size):
    shape = "{kind: box, size_m: " + str(list(size)) + "}"
    return f"world.obstacles=[{{name: b, center_m: [{x}, {y}, {z}], shape: {shape}}}]"


def refusal(flight):
    with pytest.raises(ConfigError) as caught:
        check_flight(flight)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", scenario_names())
def test_every_shipped_scenario_can_be_flown(name):
    check_flight(load_config(RunConfig, name))


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        (["task.radius_m=9", "task.period_s=100"], "does not fit between the walls"),
        (["task.period_s=1"], "task: the circle needs 6.28 m/s but limits.v_max_mps"),
        ([box(-2.0, 0.0, 1.5, (0.3, 0.3, 0.6))], "would touch obstacle 'b'"),
    ],
)
def test_laps_that_the_team_cannot_fly_are_refused(entries, words):
    said = refusal(load_config(RunConfig, "circle", entries))
    assert said.startswith("task: ")
    assert words in said


@pytest.mark.parametrize(
    "obstacle",
    [
        box(1.6, 1.6, 1.2, (0.3, 0.3, 2.4)),  # in the way across
        box(2.5, -2.5, 1.0, (0.3, 0.3, 0.1)),  # over a parking place
        box(0.2, -2.2, 1.65, (5.0, 0.1, 0.2)),  # a bar just over the cruise height
    ],
)
def test_a_straight_way_in_that_meets_an_obstacle_is_refused(obstacle):
    words = refusal(config(FLY_IN, obstacle, "task.goal_m=[-2.5, 0, 3]"))
    assert words.startswith("start: vehicle ")
    assert "within 0.1 m of obstacle 'b' at (" in words


def test_what_is_beside_the_ways_in_or_under_them_is_no_matter():
    check_flight(config(FLY_IN, box(1.9, 0.0, 0.5, (0.3, 0.3, 1.0)), "task.goal_m=[-2.5, 0, 3]"))
    check_flight(config(FLY_IN, box(1.6, 1.6, 0.5, (0.3, 0.3, 1.0)), "task.goal_m=[-2.5, 0, 3]"))


def test_another_cruise_height_leads_over_a_pillar():
    pillar = box(1.6, 1.6, 0.9, (0.3, 0.3, 1.8))
    assert "mission.station.cruise_height_m" in refusal(config(FLY_IN, pillar))
    check_flight(config(FLY_IN, pillar, "mission.station.cruise_height_m=2.2"))


def path_to_goal(flight):
    """Whether a path of voxels leads to the goal itself on the map of all that stands."""
    goal = np.array(flight.task.goal_m)
    path = AStar().plan(known_map(flight, goal), np.array([0.0, 0.0, 1.0]), goal, 1.0)
    return path.status is PlanStatus.FOUND


def is_accepted(flight):
    try:
        check_flight(flight)
    except ConfigError:
        return False
    return True


@pytest.mark.parametrize("margin_m", [0.15, 0.3])
def test_a_goal_is_accepted_from_where_the_planner_gets_to_it(margin_m):
    """A wall behind the goal, farther and farther away: a path is needed, and not enough."""
    margin = f"planning.margin_m={margin_m}"
    places = np.round(np.arange(3.55, 3.9, 0.05) + margin_m - 0.15, 2)
    flights = [config(box(x, 0.0, 1.5, (0.2, 2.0, 3.0)), margin) for x in places]
    accepted = [is_accepted(f) for f in flights]
    assert all(path_to_goal(f) for f, ok in zip(flights, accepted, strict=True) if ok)
    assert sum(path_to_goal(f) for f in flights) - sum(accepted) <= 2  # a voxel of 0.1 m
    assert accepted == sorted(accepted)
    assert (accepted[0], accepted[-1]) == (False, True)
    assert "too near to obstacle 'b' for the planner" in refusal(flights[0])


def test_a_goal_behind_a_wall_without_a_gap_is_refused():
    assert "there is no path to (2.5, 0, 1.5)" in refusal(config(box(1.4, 0, 2.5, (0.2, 8, 5))))


def test_a_goal_in_a_rolling_map_is_not_judged_beforehand():
    rolling = ("world.map.window_m=[6, 6, 5]", "world.map.coarse_voxel_m=0.5")
    check_flight(config(box(3.55, 0.0, 1.5, (0.2, 2.0, 3.0)), *rolling))
