# SPDX-License-Identifier: Apache-2.0
"""A* against Dijkstra, corner rule, budget, cost band, movers in time, two levels."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from skyhaul.geometry.shapes import Sphere
from skyhaul.mapping.api import OccupancyGrid, StaticLayer, WorldMap
from skyhaul.mapping.mapper import static_map
from skyhaul.model.envelope import TeamShape
from skyhaul.perception.api import Track
from skyhaul.planning.api import Plan, PlanStatus
from skyhaul.planning.astar import AStar

POINT = TeamShape(radius_m=0.0, above_m=0.0, below_m=0.0)
BARE = AStar(clearance_m=0.0, band_m=0.0, straight=False)


def noise_map(seed: int, n: int = 8, fill: float = 0.4) -> WorldMap:
    """A point in a grid of random voxels: a voxel is free or not, and that is all."""
    occupied = np.random.default_rng(seed).random((n, n, n)) < fill
    occupied[0, 0, 0] = occupied[-1, -1, -1] = False
    grid = OccupancyGrid(occupied, np.array([-1.0, 2.0, 0.5]), 0.5)
    return WorldMap(0, grid, np.where(occupied, -1.0, 1.0).astype(np.float32), 1.0, (), POINT, 0)


def across(world_map: WorldMap, planner: AStar = BARE) -> Plan:
    n = world_map.grid.occupied.shape[0]
    return planner.plan(world_map, *world_map.grid.center([(0, 0, 0), (n - 1,) * 3]), 1.0)


def neighbours(occupied):
    """Pairs of free voxels joined by a step that cuts no corner."""
    cells = np.argwhere(~occupied)
    i, j = np.nonzero(np.abs(cells[:, None] - cells[None]).max(axis=-1) == 1)
    low, high = np.minimum(cells[i], cells[j]), np.maximum(cells[i], cells[j]) + 1
    clear = [not occupied[a[0]:b[0], a[1]:b[1], a[2]:b[2]].any()
             for a, b in zip(low, high, strict=True)]  # fmt: skip
    return cells, i[clear], j[clear]


def shortest(world_map: WorldMap) -> float:
    """Brute force: Dijkstra on the whole graph [m]; inf without a path."""
    cells, i, j = neighbours(world_map.grid.occupied)
    steps = world_map.grid.voxel_m * np.linalg.norm(cells[i] - cells[j], axis=1)
    return dijkstra(coo_array((steps, (i, j)), shape=(len(cells),) * 2), indices=0)[-1]


@pytest.mark.parametrize("heuristic", ["octile", "euclidean", "none"])
@pytest.mark.parametrize("fill", [0.02, 0.1, 0.4])
@pytest.mark.parametrize("seed", range(20))
def test_astar_is_as_short_as_dijkstra(seed, heuristic, fill):
    world_map = noise_map(seed, fill=fill)
    best = shortest(world_map)
    plan = across(world_map, replace(BARE, heuristic=heuristic))
    length = plan.length_m if plan.status is PlanStatus.FOUND else np.inf
    assert length == pytest.approx(best, rel=1e-7)


@pytest.mark.parametrize("seed", range(10))
def test_no_step_cuts_a_corner(seed):
    world_map = noise_map(seed, n=14, fill=0.3)
    cells, i, j = neighbours(world_map.grid.occupied)
    allowed = {(tuple(cells[a]), tuple(cells[b])) for a, b in zip(i, j, strict=True)}
    path = across(world_map).p_WP
    way = [world_map.grid.cell(p) for p in path]
    assert all(step in allowed for step in itertools.pairwise(way))


def test_octile_expands_fewer_voxels_than_euclidean_at_the_same_cost():
    world_map = noise_map(1, n=30, fill=0.1)
    octile, euclidean, none = (across(world_map, replace(BARE, heuristic=h))
                               for h in ("octile", "euclidean", "none"))  # fmt: skip
    assert octile.length_m == pytest.approx(euclidean.length_m, rel=1e-7)
    assert octile.length_m == pytest.approx(none.length_m, rel=1e-7)
    assert octile.n_expanded < euclidean.n_expanded < none.n_expanded


def test_astar_stops_at_its_budget():
    plan = across(noise_map(0), replace(BARE, max_expanded=3))
    assert (plan.status, plan.n_expanded) == (PlanStatus.OUT_OF_BUDGET, 3)


SHAPE = TeamShape(radius_m=0.3, above_m=0.4, below_m=0.1)


def hall(p_gap=(1.0, 4.0)) -> WorldMap:
    """Two rooms joined by a narrow gap on the straight line and a wide one aside."""
    occupied = np.zeros((60, 60, 20), np.bool_)
    occupied[28:32] = True
    for centre, half in zip(p_gap, (5, 12), strict=True):
        c = round(centre / 0.1)
        occupied[28:32, max(0, c - half) : c + half] = False
    return static_map(OccupancyGrid(occupied, np.full(3, 0.05), 0.1), SHAPE)


def test_the_band_prefers_room_to_a_shorter_squeeze():
    ends = np.array([1.0, 1.0, 1.0]), np.array([5.0, 1.0, 1.0])
    tight = AStar(clearance_m=0.0, band_weight=0.0).plan(hall(), *ends, 1.0)
    roomy = AStar(clearance_m=0.0, band_m=0.6, band_weight=8.0).plan(hall(), *ends, 1.0)
    through = [p.p_WP[np.argmin(np.abs(p.p_WP[:, 0] - 3.0)), 1] for p in (tight, roomy)]
    assert tight.length_m < roomy.length_m
    assert through[0] < 1.6 < through[1]


@pytest.mark.parametrize("ends", [((1.0, 1.3), (5.0, 4.7)), ((2.2, 2.0), (3.8, 2.0))])
def test_shortcuts_never_cost_clearance_and_never_lengthen_the_path(ends):
    world_map = hall()
    ends = [np.array([*xy, 1.0]) for xy in ends]
    rough = AStar(straight=False).plan(world_map, *ends, 1.0)
    straight = AStar().plan(world_map, *ends, 1.0)
    assert straight.length_m <= rough.length_m + 1e-9
    assert len(straight.p_WP) < min(9, len(rough.p_WP))
    legs = itertools.pairwise(straight.p_WP)
    dense = np.concatenate([a + np.linspace(0, 1, 200)[:, None] * (b - a) for a, b in legs])
    assert world_map.clearance(dense, np.zeros(len(dense))).min() > 0.0


def mover(p, v) -> Track:
    return Track(
        0, 0, Sphere(radius_m=0.2), np.array(p, np.float64), np.eye(3),
        np.array(v, np.float64), np.zeros((6, 6)), 0.0, 0.0,
    )  # fmt: skip


def open_space(tracks=(), horizon_s=20.0) -> WorldMap:
    m = static_map(OccupancyGrid(np.zeros((60, 60, 20), np.bool_), np.full(3, 0.05), 0.1), SHAPE)
    return replace(m, tracks=tuple(tracks), tube_horizon_s=horizon_s)


START, GOAL = np.array([0.8, 3.0, 1.0]), np.array([5.2, 3.0, 1.0])


def clear_in_time(world_map: WorldMap, plan: Plan, speed: float) -> float:
    """Smallest clearance when the path is flown at that speed from time 0."""
    leg = np.linalg.norm(np.diff(plan.p_WP, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(leg)])
    way = np.linspace(0.0, at[-1], 400)
    p = np.column_stack([np.interp(way, at, plan.p_WP[:, c]) for c in range(3)])
    return float(world_map.clearance(p, 1e6 * way / speed).min())


@pytest.mark.parametrize("v_y", [0.0, 0.4, -0.4, 0.8])
def test_movers_block_voxels_when_the_load_passes_there(v_y):
    """At 1 m/s the load is at x = 3 after 2.2 s, and so is the mover then, at y = 3."""
    m = open_space([mover((3.0, 3.0 - 2.2 * v_y, 1.0), (0.0, v_y, 0.0))])
    straight = Plan(PlanStatus.FOUND, np.array([START, GOAL]))
    assert clear_in_time(m, straight, 1.0) < 0.0
    plan = AStar().plan(m, START, GOAL, 1.0)
    assert plan.status is PlanStatus.FOUND
    assert clear_in_time(m, plan, 1.0) > -0.02


def test_a_mover_that_will_be_gone_does_not_block():
    m = open_space([mover((3.0, 3.0, 1.0), (0.0, 1.5, 0.0))])
    np.testing.assert_allclose(AStar().plan(m, START, GOAL, 1.0).p_WP, [START, GOAL])


def test_a_mover_beyond_the_horizon_does_not_block():
    m = open_space([mover((3.0, 3.0, 1.0), (0.0, 0.06, 0.0))], horizon_s=1.0)
    np.testing.assert_allclose(AStar().plan(m, START, GOAL, 1.0).p_WP, [START, GOAL])


def test_the_time_of_the_start_counts():
    m = open_space([mover((3.0, 3.0 + 1.0 * 3.2, 1.0), (0.0, -1.0, 0.0))])
    now = AStar().plan(m, START, GOAL, 1.0)
    later = AStar().plan(m, START, GOAL, 1.0, start_us=1_000_000)
    np.testing.assert_allclose(now.p_WP, [START, GOAL])
    assert later.length_m > now.length_m + 0.01


def test_with_a_window_the_coarse_layer_leads_and_the_fine_one_decides_near_by():
    """A gap of 1.4 m in a wall near the start, which the coarse cells cannot see."""
    occupied = np.zeros((160, 80, 40), np.bool_)
    occupied[40:42] = True
    occupied[40:42, 30:50] = False
    p_WO = np.full(3, 0.05)
    whole = static_map(OccupancyGrid(occupied, p_WO, 0.1), SHAPE)
    cells = occupied.reshape(32, 5, 16, 5, 8, 5).any(axis=(1, 3, 5))
    coarse = static_map(OccupancyGrid(cells, np.full(3, 0.25), 0.5), SHAPE)
    fine = OccupancyGrid(occupied[:90].copy(), p_WO, 0.1)
    m = replace(
        whole,
        grid=fine,
        static_clearance=whole.static_clearance[:90].copy(),
        coarse=StaticLayer(coarse.grid, coarse.static_clearance),
    )
    start, goal = np.array([1.0, 4.0, 1.5]), np.array([14.0, 4.0, 1.5])
    plan = AStar(clearance_m=0.0).plan(m, start, goal, 1.0)
    assert plan.status is PlanStatus.FOUND
    assert plan.length_m == pytest.approx(13.0, abs=0.5)


@pytest.mark.parametrize(("name", "value"), [("clearance_m", -1.0), ("max_expanded", 0)])
def test_parameters_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} must be .* got"):
        AStar(**{name: value})
