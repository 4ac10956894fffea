# SPDX-License-Identifier: Apache-2.0
"""What the files that ship promise."""

from itertools import combinations

import numpy as np
import pytest

from skyhaul.geometry.shapes import pose_shapes
from skyhaul.geometry.team_clearance import team_clearances
from skyhaul.model.envelope import TeamShape, team_shape
from skyhaul.model.team import RigidPayload
from skyhaul.types import Array
from skyhaul.world.check import clearances_at, parked_m, standing
from skyhaul.world.load import load_config, scenario_names
from skyhaul.world.motion import obstacle_field
from skyhaul.world.scenario import GoTo, GroundStart, Scenario

PAPER = load_config(Scenario, "paper")
START, GOAL = np.array([0.5, 0.5, 0.5]), np.array([9.0, 9.0, 9.0])
T_US = np.arange(0, 240_000_000, 20_000)
"""Four minutes in steps of 20 ms: every cycle in `paper` is shorter than half of that."""


def tracks(scenario: Scenario, seed: int = 0) -> dict[str, Array]:
    """Where each obstacle is at `T_US`, by name, (k, 3)."""
    field = obstacle_field(scenario.world, seed)
    p_WO = np.array([field.shapes_at(int(t)).p_WO for t in T_US])
    return {name: p_WO[:, j] for j, name in enumerate(field.names)}


TRACKS = tracks(PAPER)
MOVERS = [f"mover {i}" for i in range(1, 7)]


def obstacle_radius(scenario: Scenario, name: str) -> float:
    """Radius of a ball around an obstacle."""
    shape = next(o.shape for o in scenario.world.obstacles if o.name == name)
    match shape.kind:
        case "sphere":
            return shape.radius_m
        case "box":
            return 0.5 * float(np.linalg.norm(shape.size_m))
    return shape.radius_m + 0.5 * shape.length_m


def clearances(shape: TeamShape, p_WL: Array, name: str, p_WO: Array) -> Array:
    """Signed distance of the team at one place to one obstacle at many, (k,)."""
    obstacle = next(o.shape for o in PAPER.world.obstacles if o.name == name)
    posed = pose_shapes([obstacle] * len(p_WO), p_WO)
    size = (shape.radius_m, shape.above_m, shape.below_m)
    return team_clearances(size, p_WL, posed.kind, posed.size, posed.p_WO, posed.R_WO)


def runs_s(free: Array) -> Array:
    """Lengths of the stretches of True that begin and end inside, [s]."""
    edges = np.flatnonzero(np.diff(free.astype(int)))
    first = 0 if not free[0] else 1
    starts, ends = edges[first::2], edges[first + 1 :: 2]
    return (ends - starts[: len(ends)]) * 0.02


def test_the_scenarios_that_the_design_names_ship() -> None:
    names = "circle circle-fast crossing figure8 forest gust hover lost-vehicle lost-vehicle-5"
    assert set(f"{names} paper paper-metres sudden window".split()) <= set(scenario_names())


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_tells_what_it_shows(name: str) -> None:
    scenario = load_config(Scenario, name)
    assert scenario.name == name
    assert scenario.description.endswith(".")


# paper


def test_paper_has_the_numbers_of_the_paper_at_a_tenth() -> None:
    assert isinstance(PAPER.start, GroundStart)
    assert PAPER.start.vehicles_m == ((0, 0), (0, 1), (1, 0), (1, 1))
    assert PAPER.task == GoTo(goal_m=(9, 9, 9), within_m=0.2, below_mps=0.1, hold_s=2.0)
    corners = {
        o.name: (np.array(o.center_m) - 0.5 * np.array(o.shape.size_m)).round(9).tolist()
        for o in standing(PAPER)
        if o.shape.kind == "box"
    }
    assert corners == {"cube 1": [2, 2, 2], "cube 2": [3, 4, 4]}
    assert PAPER.limits.a_max_mps2 == 1.0
    for name, place in (("mover 1", (1, 1, 1)), ("mover 2", (9, 9, 9)), ("mover 3", (5, 3, 3))):
        np.testing.assert_allclose(TRACKS[name][0], place, atol=1e-9)


def test_each_vehicle_of_paper_leans_out_over_its_own_corner() -> None:
    assert isinstance(PAPER.start, GroundStart)
    out = parked_m(PAPER.team, PAPER.start) - PAPER.start.payload_m
    flat = PAPER.team.formation_dirs_L()[:, :2]
    cosines = (
        np.sum(out * flat, axis=1) / np.linalg.norm(out, axis=1) / np.linalg.norm(flat, axis=1)
    )
    np.testing.assert_allclose(cosines, 1.0, atol=1e-9)


def test_one_vehicle_of_paper_cannot_lift_the_load_and_two_can() -> None:
    a = PAPER.team.arrays()
    assert (a.m_L + a.m_B[0]) * a.g > a.thrust_max[0]
    assert (a.m_L / 2 + a.m_B[0]) * a.g < a.thrust_max[0]


def test_the_straight_line_of_paper_passes_within_the_envelope_of_both_cubes() -> None:
    shape = team_shape(PAPER.team, 0.0)
    line = START + np.linspace(0.0, 1.0, 400)[:, None] * (GOAL - START)
    cubes = standing(PAPER)
    gaps = np.min([clearances_at(shape, p, cubes) for p in line], axis=0)
    assert len(cubes) == 2
    assert np.all(gaps < 0.0)


def test_mover_1_never_sweeps_through_a_parked_vehicle() -> None:
    assert isinstance(PAPER.start, GroundStart)
    vehicle, radius = PAPER.team.vehicle, obstacle_radius(PAPER, "mover 1")
    for spot in parked_m(PAPER.team, PAPER.start):
        flat = np.hypot(*(TRACKS["mover 1"][:, :2] - spot).T) - vehicle.radius_m
        up = TRACKS["mover 1"][:, 2] - 2.0 * vehicle.half_height_m
        gap = np.hypot(np.maximum(flat, 0.0), np.maximum(up, 0.0)) - radius
        assert np.min(gap) > 0.5


def test_mover_1_blocks_the_lift_off_column_but_leaves_it_free_long_enough() -> None:
    flat = np.hypot(*(TRACKS["mover 1"][:, :2] - [0.5, 0.5]).T) - obstacle_radius(PAPER, "mover 1")
    assert np.min(flat) < 0.75
    assert np.min(runs_s(flat > 0.75 + 0.3)) >= 12.0


def test_no_other_mover_comes_near_the_lift_off_column() -> None:
    for name in MOVERS[1:]:
        gap = np.hypot(*(TRACKS[name][:, :2] - [0.5, 0.5]).T) - obstacle_radius(PAPER, name)
        assert np.min(gap) > 2.0


def test_mover_2_blocks_the_goal_and_leaves_it_free_for_ten_seconds_in_each_cycle() -> None:
    gap = clearances(team_shape(PAPER.team, 0.3), GOAL, "mover 2", TRACKS["mover 2"])
    assert np.min(gap) < 0.0
    free = runs_s(gap > 0.0)
    assert len(free) >= 5
    assert np.min(free) >= 15.0


def test_no_other_mover_reaches_the_goal() -> None:
    for name in [*MOVERS[:1], *MOVERS[2:]]:
        gap = clearances(team_shape(PAPER.team, 0.3), GOAL, name, TRACKS[name])
        assert np.min(gap) > 0.3


@pytest.mark.parametrize("name", MOVERS[2:])
def test_movers_3_to_6_cross_the_straight_line_and_turn_away_from_it(name: str) -> None:
    k = np.linspace(0.0, 1.0, 300)[:, None]
    line = START + k * (GOAL - START)
    track = TRACKS[name][:6000:5]
    gap = np.min(np.linalg.norm(track[:, None] - line[None], axis=2), axis=1)
    assert np.min(gap) < 0.3
    v = np.linalg.norm(np.gradient(TRACKS[name], 0.02, axis=0), axis=1)[:6000:5]
    slow = v < 0.5 * np.max(v)
    assert np.min(gap[slow]) > 1.5


def test_movers_of_paper_are_slow_stay_in_the_room_and_off_the_cubes_and_each_other() -> None:
    for name in MOVERS:
        track, r = TRACKS[name], obstacle_radius(PAPER, name)
        v = np.linalg.norm(np.diff(track, axis=0), axis=1) / 0.02
        assert 0.3 < np.max(v) < 0.6
        assert np.all(track - r > [-2.0, -2.0, 0.0])
        assert np.all(track + r < [12.0, 12.0, 13.0])
        for cube in ("cube 1", "cube 2"):
            apart = np.min(np.linalg.norm(track - TRACKS[cube], axis=1))
            assert apart - r - obstacle_radius(PAPER, cube) > 0.5
    for a, b in combinations(MOVERS, 2):
        paths = TRACKS[a][:4000:4], TRACKS[b][:4000:4]
        apart = np.min(np.linalg.norm(paths[0][:, None] - paths[1][None], axis=2))
        assert apart - obstacle_radius(PAPER, a) - obstacle_radius(PAPER, b) > 0.25


def test_other_seeds_draw_other_phases_on_the_same_paths() -> None:
    other = tracks(PAPER, seed=7)
    for name in MOVERS:
        assert np.linalg.norm(other[name][0] - TRACKS[name][0]) > 0.05
        gap = np.linalg.norm(TRACKS[name][:4000, None] - other[name][None, :4000:400], axis=2)
        assert np.max(np.min(gap, axis=0)) < 0.02


# The others


def test_paper_metres_is_paper_times_ten() -> None:
    metres = load_config(Scenario, "paper-metres")
    assert metres.team == PAPER.team
    for small, large in zip(PAPER.world.obstacles, metres.world.obstacles, strict=True):
        np.testing.assert_allclose(large.center_m, 10.0 * np.array(small.center_m))
        assert obstacle_radius(metres, small.name) >= 9.9 * obstacle_radius(PAPER, small.name)
    assert metres.start.kind == "fly-in"
    assert metres.start.vehicles_m == ((0, 0), (0, 10), (10, 0), (10, 10))


def test_circle_carries_a_uniform_triangular_plate_by_its_corners() -> None:
    team = load_config(Scenario, "circle").team
    hooks, payload = team.hooks_L(), team.payload
    np.testing.assert_allclose(hooks[:, :2].sum(axis=0), 0.0, atol=1e-6)
    np.testing.assert_allclose(np.hypot(hooks[:, 0], hooks[:, 1]), 0.25, atol=1e-6)
    assert isinstance(payload, RigidPayload)
    # moments of a triangle are those of three thirds of the mass at the middles of its sides
    middles = 0.5 * (hooks + np.roll(hooks, 1, axis=0))[:, :2]
    xx, yy = payload.mass_kg / 3.0 * np.square(middles).sum(axis=0)
    thick = payload.mass_kg * 0.02**2 / 12.0
    np.testing.assert_allclose(payload.J_L, [yy + thick, xx + thick, xx + yy], rtol=2e-3)


def test_the_team_fits_through_the_window_and_the_straight_line_does_not() -> None:
    scenario = load_config(Scenario, "window")
    shape, walls = team_shape(scenario.team, 0.3), standing(scenario)
    height = 0.9 + 0.5 * (2.4 + shape.below_m - shape.above_m)
    middle = clearances_at(shape, np.array([5.0, 1.0, height]), walls)
    assert np.min(middle) > 0.15
    assert np.min(clearances_at(shape, np.array([5.0, 0.0, height]), walls)) < 0.0


def test_trunks_of_the_forest_leave_room_between_any_two() -> None:
    scenario = load_config(Scenario, "forest")
    trunks = [(np.array(o.center_m)[:2], o.shape) for o in standing(scenario)]
    width = 2.0 * team_shape(scenario.team, 0.3).radius_m
    for (a, one), (b, two) in combinations(trunks, 2):
        assert np.linalg.norm(a - b) - one.radius_m - two.radius_m > width + 0.3
    line = np.linspace(0.0, 18.0, 200)
    gaps = [np.linalg.norm(c - [x, 0.0]) - s.radius_m for c, s in trunks for x in line]
    assert min(gaps) < 0.5 * width


def test_obstacles_of_sudden_appear_two_metres_ahead_on_the_way() -> None:
    scenario = load_config(Scenario, "sudden")
    shape = team_shape(scenario.team, 0.0)
    for obstacle in scenario.world.obstacles:
        assert obstacle.appears is not None
        assert obstacle.appears.distance_m is not None
        assert obstacle.appears.distance_m >= 2.0
        share = obstacle.center_m[0] / 14.5
        on_line = np.array([obstacle.center_m[0], 0.0, 0.4 + share * 1.6])
        assert clearances_at(shape, on_line, (obstacle,))[0] < 0.0


def test_movers_of_crossing_are_fast_and_cross_at_flight_height() -> None:
    scenario = load_config(Scenario, "crossing")
    speeds = [float(np.linalg.norm(o.motion.velocity_mps)) for o in scenario.world.obstacles]
    assert min(speeds) >= 1.0
    assert max(speeds) == 2.0
    for name, track in tracks(scenario).items():
        assert np.min(track[:, 1]) < -5.0, name
        assert np.max(track[:, 1]) > 5.0, name


@pytest.mark.parametrize(("name", "n"), [("lost-vehicle", 4), ("lost-vehicle-5", 5)])
def test_a_vehicle_dies_half_way(name: str, n: int) -> None:
    scenario = load_config(Scenario, name)
    (event,) = scenario.events
    assert scenario.team.count == n
    assert event.kind == "vehicle-dies"
    assert event.at_progress == 0.5
