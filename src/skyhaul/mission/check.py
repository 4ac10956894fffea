# SPDX-License-Identifier: Apache-2.0
"""Checks of a flight before it begins: what the stack that flies it must find possible."""

from itertools import pairwise

import numpy as np

from skyhaul.errors import ConfigError
from skyhaul.geometry.shapes import shape_size
from skyhaul.mapping.api import WorldMap
from skyhaul.mission.config import RunConfig
from skyhaul.mission.station import station_point, way_in
from skyhaul.model import hover_state, team_state
from skyhaul.model.envelope import TeamShape, team_shape
from skyhaul.perception.api import ObstacleEstimate, StaticObject
from skyhaul.planning.api import PlanStatus
from skyhaul.planning.reference import resting_reference
from skyhaul.planning.tasks import task_curve, task_reference
from skyhaul.types import Array
from skyhaul.world.check import check_place, clearances_at, parked_m, rest_height_m, standing
from skyhaul.world.scenario import (
    AirStart,
    CircleTask,
    Figure8Task,
    FlyInStart,
    GoTo,
    GroundStart,
    HoverTask,
)

LAP_PLACES = 181
"""Places of a lap that are looked at."""
STEP_M = 0.05
"""Spacing of the places on a way that are looked at [m]."""


def check_flight(config: RunConfig) -> None:
    """Refuse a flight whose stack cannot do what the scenario asks.

    Raises:
        ConfigError: With one sentence that begins with the key at fault.
    """
    stands, task = bool(standing(config)), config.task
    if stands and isinstance(config.start, GroundStart | FlyInStart):
        _check_ways_in(config, config.start)
    if not isinstance(task, GoTo):
        _check_task(config, task)
    elif stands:
        _check_goal(config, np.array(task.goal_m))


def known_map(config: RunConfig, p_WL: Array) -> WorldMap:
    """The map of a team, its load at a place, (3,), that knows everything that stands."""
    shape = team_shape(config.team, config.planning.margin_m)
    mapper = config.mapping.build(config.world.map, config.world.room, shape)
    statics = tuple(
        StaticObject(j, o.shape, np.array(o.center_m), shape_size(o.shape)[2])
        for j, o in enumerate(standing(config))
    )
    team = team_state(config.team, hover_state(config.team, p_WL))
    return mapper.step(mapper.init(), ObstacleEstimate(0, statics, ()), team)[1]


def _check_ways_in(config: RunConfig, start: GroundStart | FlyInStart) -> None:
    """No vehicle's straight way from its parking place to its station meets what stands."""
    team, mission, obstacles = config.team, config.mission, standing(config)
    margin, vehicle = mission.take_off.margin_m, team.vehicle
    high = vehicle.half_height_m + margin
    body = TeamShape(radius_m=vehicle.radius_m + margin, above_m=high, below_m=high)
    load = np.array([*start.payload_m, rest_height_m(team)])
    for i, spot in enumerate(parked_m(team, start)):
        end = station_point(team, load, np.eye(3), i, mission.station.slack_share)
        parked = np.array([*spot, vehicle.half_height_m])
        corners = way_in(start.kind, mission.station.cruise_height_m, parked, end)
        for p in _along(corners):
            gaps = clearances_at(body, p, obstacles)
            if gaps.min() <= 0.0:
                raise ConfigError(
                    f"start: vehicle {i} would come within {margin:g} m of obstacle "
                    f"{obstacles[int(gaps.argmin())].name!r} at {_point(p)} on its straight way to "
                    "the load; move the obstacle, start.vehicles_m or start.payload_m, or change "
                    "mission.station.cruise_height_m"
                )


def _along(corners: Array) -> Array:
    """Places on a polyline, (k, 3) [m]."""
    legs = pairwise(corners)
    counts = [max(2, int(np.linalg.norm(b - a) / STEP_M) + 2) for a, b in legs]
    places = [np.linspace(corners[k], corners[k + 1], n) for k, n in enumerate(counts)]
    return np.concatenate(places)


def _check_task(config: RunConfig, task: HoverTask | CircleTask | Figure8Task) -> None:
    """The team can fly the curve of its task, and fits into the room all along it."""
    begin = _begin(config)
    task_reference(task, begin, 0.0, 0, config.limits)
    check_place(config, "task", begin)
    if isinstance(task, HoverTask):
        return
    for offset in task_curve(task, np.linspace(0.0, 2.0 * np.pi, LAP_PLACES))[:, :3]:
        check_place(config, "task", begin + offset)


def _check_goal(config: RunConfig, p_WG: Array) -> None:
    """The planner gets to the goal among all that stands: its map is coarser than the truth.

    With a rolling window it first sees the goal on its way: then nothing is known beforehand.
    """
    if config.world.map.window_m is not None:
        return
    begin, shape = _begin(config), team_shape(config.team, config.planning.margin_m)
    planner, rest = config.planning.build(shape), resting_reference(begin, 0.0, 0)
    result = planner.plan(known_map(config, begin), rest, 0, p_WG, config.limits)
    if result.reaches_goal or result.path.status is PlanStatus.OUT_OF_BUDGET:
        return
    if result.path.status is PlanStatus.NO_PATH:
        raise ConfigError(
            f"task.goal_m: there is no path to {_point(p_WG)} among obstacles that stand, which "
            f"the team passes at planning.margin_m = {config.planning.margin_m:g} m; move the goal "
            "or the obstacles"
        )
    obstacles = standing(config)
    gaps = clearances_at(shape, p_WG, obstacles)
    raise ConfigError(
        f"task.goal_m: {_point(p_WG)} is too near to obstacle "
        f"{obstacles[int(gaps.argmin())].name!r} for the planner, which keeps the team "
        f"{config.planning.margin_m:g} m (planning.margin_m) and the error of its voxels off; "
        "move one of them, or lower planning.margin_m or world.map.voxel_m"
    )


def _begin(config: RunConfig) -> Array:
    """Where the journey begins, (3,) [m]: at the start, or above it once the load is lifted."""
    start = config.start
    if isinstance(start, AirStart):
        return np.array(start.payload_m)
    return np.array([*start.payload_m, rest_height_m(config.team) + config.mission.lift_m])


def _point(p: Array) -> str:
    return "(" + ", ".join(f"{c:.2f}".rstrip("0").rstrip(".") for c in p) + ")"
