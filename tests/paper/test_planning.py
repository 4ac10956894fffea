# SPDX-License-Identifier: Apache-2.0
"""The paper's claims on planning, and what had to be settled (PAPER_NOTES 24 to 30)."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.mapping.api import WorldMap
from skyhaul.mapping.mapper import Mapping
from skyhaul.model.envelope import team_shape
from skyhaul.model.state import TeamState
from skyhaul.perception.api import ObstacleEstimate, StaticObject, Track
from skyhaul.planning.api import PlanStatus, ReferenceStatus
from skyhaul.planning.astar import AStar
from skyhaul.planning.cubic import CubicPlanner
from skyhaul.planning.motion import Drive, run_along
from skyhaul.planning.reference import resting_reference
from skyhaul.planning.replan import SplinePlanner
from skyhaul.planning.shortcut import subdivide
from skyhaul.world.load import load_config
from skyhaul.world.scenario import Scenario

PAPER = load_config(Scenario, "paper", [])
SHAPE = team_shape(PAPER.team, 0.15)
START, GOAL = np.array([0.5, 0.5, 0.5]), np.array([9.0, 9.0, 9.0])
CUBES = tuple(o for o in PAPER.world.obstacles if o.motion.kind == "static")


def paper_map(tracks=(), objects=CUBES) -> WorldMap:
    z = np.zeros
    team = TeamState(
        START, np.array([1.0, 0, 0, 0]), z(3), z(3), z((4, 3)), z((4, 4)), z((4, 3)), z((4, 3))
    )
    statics = tuple(
        StaticObject(i, o.shape, np.array(o.center_m), np.eye(3)) for i, o in enumerate(objects)
    )
    mapper = Mapping().build(PAPER.world.map, PAPER.world.room, SHAPE)
    return mapper.step(mapper.init(), ObstacleEstimate(0, statics, tuple(tracks)), team)[1]


def line(a, b, n=400) -> np.ndarray:
    return a + np.linspace(0.0, 1.0, n)[:, None] * (b - a)


@pytest.mark.parametrize("cube", range(2))
def test_the_straight_line_passes_within_the_teams_envelope_of_each_cube(cube):
    """PAPER_NOTES 26: the scenario needs A*."""
    c = paper_map(objects=CUBES[cube : cube + 1]).clearance(line(START, GOAL), np.zeros(400))
    assert c.min() < 0.0


def test_astar_finds_a_clear_path_hardly_longer_than_the_line():
    plan = AStar().plan(paper_map(), START, GOAL, 1.0)
    assert plan.status is PlanStatus.FOUND
    assert plan.length_m < 1.1 * np.linalg.norm(GOAL - START)


def test_octile_expands_far_fewer_voxels_than_the_papers_euclidean_distance():
    """PAPER_NOTES 28: for the same cost."""
    bare = AStar(band_weight=0.0, straight=False)
    octile, euclidean = (
        replace(bare, heuristic=h).plan(paper_map(), START, GOAL, 1.0)
        for h in ("octile", "euclidean")
    )
    assert octile.length_m == pytest.approx(euclidean.length_m, rel=1e-7)
    assert 3 * octile.n_expanded < euclidean.n_expanded


def test_the_goal_is_taken_by_obstacle_2_at_first_and_the_team_goes_near_and_waits():
    """PAPER_NOTES 24: it starts at (90, 90, 90), the goal."""
    o = next(o for o in PAPER.world.obstacles if np.allclose(o.center_m, GOAL))
    track = Track(
        1, 0, o.shape, np.array(o.center_m), np.eye(3), np.zeros(3), np.zeros((6, 6)), 0.05, 0.02
    )
    planner = SplinePlanner().build(SHAPE)
    result = planner.plan(
        paper_map([track]), resting_reference(START, 0.0, 0), 0, GOAL, PAPER.limits
    )
    assert result.status is ReferenceStatus.OK
    assert not result.reaches_goal
    end = result.reference.sample(np.array([result.reference.end_us])).p_WD[0, 0]
    assert np.linalg.norm(end - GOAL) < 2.5


def test_without_a_speed_limit_the_metre_scale_diagonal_would_peak_at_12_m_per_s():
    """PAPER_NOTES 27."""
    drive = Drive(99.0, 1.0, 0.0, 0.0, -1.0, 0.0, np.inf)
    ends = np.array([[5.0, 5.0, 5.0], [90.0, 90.0, 90.0]])
    run = run_along(subdivide(ends, 0.1), 0.0, drive)
    assert run.speed.max() == pytest.approx(12.0, abs=0.3)


def test_the_path_holds_the_papers_acceleration_and_our_speed_limit():
    """a_max = 1 m/s^2."""
    planner = SplinePlanner().build(SHAPE)
    r = planner.plan(paper_map(), resting_reference(START, 0.0, 0), 0, GOAL, PAPER.limits).reference
    assert r.max_acceleration_mps2() <= 1.0
    assert r.max_speed_mps() <= 1.5 + 1e-9
    assert r.max_jerk_mps3() <= 3.0


def test_the_cubic_jumps_in_jerk_where_the_default_is_smooth_to_the_6th_derivative():
    """PAPER_NOTES 30: the vehicles' moments need the load's 6th derivative."""
    current, m = resting_reference(START, 0.0, 0), paper_map()
    cubic, septic = (
        p.build(SHAPE).plan(m, current, 0, GOAL, PAPER.limits).reference
        for p in (CubicPlanner(), SplinePlanner())
    )
    knots = cubic.start_us + 1e6 * cubic.spline.x[1:-1]
    before, after = (cubic.sample(knots + e).p_WD[:, 3] for e in (-1.0, 1.0))
    assert np.max(np.linalg.norm(after - before, axis=1)) > 0.3
    knots = septic.start_us + septic.dt_us * np.arange(1, 30)
    before, after = (septic.sample(knots + 1e-3 * e).p_WD for e in (-1.0, 1.0))
    np.testing.assert_allclose(before, after, atol=1e-4 * np.abs(after).max())


def test_one_isotropic_radius_would_block_the_floor_and_the_teams_shape_does_not():
    """PAPER_NOTES 29: the team reaches 0.9 m sideways and 1.1 m up, but 0.2 m down."""
    p = np.array([[6.0, 2.0, 0.5]])
    assert paper_map().clearance(p, [0])[0] > 0.0
    assert SHAPE.radius_m > p[0, 2]
