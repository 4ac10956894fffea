# SPDX-License-Identifier: Apache-2.0
"""What every path planner must do. A new planner adds one entry to PLANNERS."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.mapping.api import OccupancyGrid, WorldMap
from skyhaul.mapping.mapper import static_map
from skyhaul.model.envelope import TeamShape
from skyhaul.planning.api import PathPlanner, PlanStatus
from skyhaul.planning.astar import AStar
from skyhaul.planning.dijkstra import Dijkstra

CLEARANCE_M = 0.1
SHAPE = TeamShape(radius_m=0.3, above_m=0.4, below_m=0.1)
PLANNERS: list[PathPlanner] = [
    AStar(clearance_m=CLEARANCE_M),
    AStar(clearance_m=CLEARANCE_M, straight=False),
    AStar(clearance_m=CLEARANCE_M, heuristic="euclidean", band_m=0.0),
    Dijkstra(clearance_m=CLEARANCE_M),
]

every_planner = pytest.mark.parametrize("planner", PLANNERS, ids=lambda p: p.kind)


def forest(seed: int, n: int = 24, fill: float = 0.002) -> WorldMap:
    occupied = np.random.default_rng(seed).random((n, n, n)) < fill
    occupied[:8, :8, :8] = occupied[-8:, -8:, -8:] = False
    return static_map(OccupancyGrid(occupied, np.array([-1.0, 2.0, 0.5]), 0.2), SHAPE)


def walled(world_map: WorldMap) -> WorldMap:
    occupied = world_map.grid.occupied.copy()
    occupied[:, 12, :] = True
    return static_map(replace(world_map.grid, occupied=occupied), SHAPE)


def corners(world_map: WorldMap) -> np.ndarray:
    n = world_map.grid.occupied.shape[0]
    return world_map.grid.center([(3, 3, 3), (n - 4,) * 3])


@every_planner
@pytest.mark.parametrize("seed", range(5))
def test_path_joins_start_to_goal_and_keeps_clearance(planner, seed):
    world_map = forest(seed)
    p_WS, p_WG = corners(world_map)
    plan = planner.plan(world_map, p_WS, p_WG, 1.0)
    assert plan.status is PlanStatus.FOUND
    np.testing.assert_array_equal(plan.p_WP[[0, -1]], [p_WS, p_WG])
    assert min(world_map.clearance(plan.p_WP, np.zeros(len(plan.p_WP)))) >= CLEARANCE_M - 1e-9


@every_planner
def test_same_inputs_give_the_same_plan(planner):
    a, b = (planner.plan(forest(0), *corners(forest(0)), 1.0) for _ in range(2))
    np.testing.assert_array_equal(a.p_WP, b.p_WP)


@every_planner
def test_a_wall_is_a_status_not_an_exception(planner):
    world_map = walled(forest(0))
    plan = planner.plan(world_map, *corners(world_map), 1.0)
    assert plan.status is PlanStatus.NO_PATH
    assert plan.p_WP.shape == (0, 3)


@every_planner
@pytest.mark.parametrize("far", [1e6, np.nan])
@pytest.mark.parametrize(
    ("end", "status"), [(0, PlanStatus.START_BLOCKED), (1, PlanStatus.GOAL_BLOCKED)]
)
def test_an_end_outside_the_map_is_a_status_not_an_exception(planner, end, status, far):
    ends = corners(forest(0))
    ends[end] = far
    assert planner.plan(forest(0), *ends, 1.0).status is status


@every_planner
def test_a_blocked_goal_is_relaxed_to_a_free_place_near_by(planner):
    world_map = forest(1)
    p_WS, p_WG = corners(world_map)
    occupied = world_map.grid.occupied.copy()
    occupied[world_map.grid.cell(p_WG)] = True
    world_map = static_map(replace(world_map.grid, occupied=occupied), SHAPE)
    plan = planner.plan(world_map, p_WS, p_WG, 1.0)
    assert plan.status is PlanStatus.RELAXED
    assert 0.2 < np.linalg.norm(plan.p_WP[-1] - p_WG) < 1.0
    assert world_map.clearance(plan.p_WP[-1:], [0])[0] >= CLEARANCE_M


@every_planner
def test_a_blocked_start_is_left_by_the_nearest_free_voxel(planner):
    world_map = forest(2)
    p_WS, p_WG = corners(world_map)
    occupied = world_map.grid.occupied.copy()
    occupied[world_map.grid.cell(p_WS)] = True
    world_map = static_map(replace(world_map.grid, occupied=occupied), SHAPE)
    plan = planner.plan(world_map, p_WS, p_WG, 1.0)
    assert plan.status is PlanStatus.FOUND
    np.testing.assert_array_equal(plan.p_WP[0], p_WS)
