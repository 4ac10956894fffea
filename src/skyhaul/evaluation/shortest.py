# SPDX-License-Identifier: Apache-2.0
"""The shortest clear path from lift-off to the goal, as a measure for the path that was flown."""

from pathlib import Path

import numpy as np
import yaml

from skyhaul.evaluation.folder import CONFIG
from skyhaul.evaluation.series import Run
from skyhaul.geometry.shapes import shape_size
from skyhaul.mapping.api import WorldMap
from skyhaul.mapping.mapper import Mapping
from skyhaul.model.envelope import team_shape
from skyhaul.model.state import TeamState
from skyhaul.perception.api import ObstacleEstimate, StaticObject
from skyhaul.planning.astar import AStar
from skyhaul.planning.config import PlanningConfig
from skyhaul.types import Array
from skyhaul.world.scenario import GoTo, Scenario
from skyhaul.world.schema import build


def shortest_clear_path_m(run: Run) -> float | None:
    """Length of the shortest path on the map of all that stands [m]; None where there is no goal.

    From where the load was at lift-off; movers do not count. Where nothing stands, a straight
    line; else A* without its cost band, with line-of-sight shortcuts.
    """
    task = run.scenario.task
    if not isinstance(task, GoTo) or not run.airborne.any():
        return None
    p_WS, p_WG = run.series["load"][np.argmax(run.airborne), 0:3], np.array(task.goal_m)
    straight_m = float(np.linalg.norm(p_WG - p_WS))
    statics = _statics(run.scenario)
    if not statics:
        return straight_m
    plan = AStar(band_weight=0.0).plan(_full_map(run, statics), p_WS, p_WG, speed_mps=1.0)
    return max(straight_m, plan.length_m) if len(plan.p_WP) else None


def _statics(scenario: Scenario) -> tuple[StaticObject, ...]:
    """All obstacles that stand from the start on."""
    return tuple(
        StaticObject(j, o.shape, np.array(o.center_m), shape_size(o.shape)[2])
        for j, o in enumerate(scenario.world.obstacles)
        if o.motion.kind == "static" and o.appears is None
    )


def _full_map(run: Run, statics: tuple[StaticObject, ...]) -> WorldMap:
    """The run's map of a team that knows everything that stands, as at lift-off."""
    world, (planning, mapping) = run.scenario.world, _stack(run.folder / CONFIG)
    shape = team_shape(run.scenario.team, planning.margin_m)
    mapper = mapping.build(world.map, world.room, shape)
    row = int(np.argmax(run.airborne))
    estimate = ObstacleEstimate(0, statics, ())
    return mapper.step(mapper.init(), estimate, _team_at(run, row))[1]


def _stack(path: Path) -> tuple[PlanningConfig, Mapping]:
    """How a run planned and mapped, by its configuration; defaults where it does not say."""
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    return build(PlanningConfig, tree.get("planning", {})), build(Mapping, tree.get("mapping", {}))


def _team_at(run: Run, row: int) -> TeamState:
    s = run.series
    load: Array = s["load"][row].copy()
    vehicles = [s[f"vehicle_{k}"][row].copy() for k in ("p", "q", "v", "w")]
    return TeamState(load[0:3], load[3:7], load[7:10], load[10:13], *vehicles)
