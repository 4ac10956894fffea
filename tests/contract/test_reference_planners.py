# SPDX-License-Identifier: Apache-2.0
"""What every reference planner must do. A new one adds one entry to PLANNERS."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.shapes import Sphere
from skyhaul.mapping.api import OccupancyGrid, WorldMap
from skyhaul.mapping.mapper import static_map
from skyhaul.model.envelope import TeamShape
from skyhaul.perception.api import Track
from skyhaul.planning.api import ReferencePlanner, ReferenceStatus
from skyhaul.planning.cubic import CubicPlanner
from skyhaul.planning.reference import resting_reference
from skyhaul.planning.replan import SplinePlanner
from skyhaul.world.scenario import Limits

SHAPE = TeamShape(radius_m=0.3, above_m=0.4, below_m=0.1)
LIMITS = Limits()
PLANNERS: list[ReferencePlanner] = [SplinePlanner().build(SHAPE), CubicPlanner().build(SHAPE)]

every_planner = pytest.mark.parametrize("planner", PLANNERS, ids=lambda p: p.params.kind)
P_WS, P_WG = np.array([1.0, 1.0, 1.0]), np.array([4.6, 4.2, 4.4])


def world(occupied_at=()) -> WorldMap:
    occupied = np.zeros((60, 60, 60), np.bool_)
    for cells in occupied_at:
        occupied[cells] = True
    return static_map(OccupancyGrid(occupied, np.full(3, 0.05), 0.1), SHAPE)


def pillar() -> WorldMap:
    return world([(slice(26, 31), slice(26, 31), slice(None))])


@every_planner
def test_the_reference_goes_on_from_the_current_one_and_ends_at_the_goal_at_rest(planner):
    result = planner.plan(pillar(), resting_reference(P_WS, 0.3, 0), 2_000_000, P_WG, LIMITS)
    assert result.status is ReferenceStatus.OK
    assert result.reaches_goal
    r = result.reference
    s = r.sample(np.array([2_000_000, r.end_us, r.end_us + 1]))
    np.testing.assert_allclose(s.p_WD[0, :2], [P_WS, np.zeros(3)], atol=1e-9)
    np.testing.assert_allclose(s.p_WD[1:, 0], [P_WG, P_WG], atol=1e-9)
    np.testing.assert_allclose(s.p_WD[1:, 1], 0.0, atol=1e-6)
    np.testing.assert_allclose(s.R_WD[:, 0, 0, 0], np.cos(0.3), atol=1e-12)


@every_planner
def test_the_reference_is_clear_all_along(planner):
    m = pillar()
    r = planner.plan(m, resting_reference(P_WS, 0.0, 0), 0, P_WG, LIMITS).reference
    t = np.arange(0, r.end_us, 5_000)
    assert np.min(m.clearance(r.sample(t).p_WD[:, 0], t)) > 0.0


@every_planner
def test_a_moving_start_keeps_position_and_velocity(planner):
    m = pillar()
    r = planner.plan(m, resting_reference(P_WS, 0.0, 0), 0, P_WG, LIMITS).reference
    t = 2_345_678
    goal = P_WG + np.array([0.0, -0.5, -1.0])
    new = planner.plan(m, r, t, goal, LIMITS).reference
    a, b = r.sample(np.array([t])).p_WD[0], new.sample(np.array([t])).p_WD[0]
    np.testing.assert_allclose(b[:2], a[:2], atol=1e-9)
    assert np.linalg.norm(a[1]) > 0.3


@every_planner
def test_a_wall_and_a_goal_outside_are_statuses_not_exceptions(planner):
    current = resting_reference(P_WS, 0.0, 0)
    wall = world([(slice(None), slice(25, 27), slice(None))])
    for m, goal in ((wall, P_WG), (world(), np.full(3, 99.0))):
        result = planner.plan(m, current, 0, goal, LIMITS)
        assert not result.reaches_goal
        assert result.status is not ReferenceStatus.BLOCKED


@every_planner
def test_a_mover_on_the_goal_is_not_flown_into(planner):
    mover = Track(
        0, 0, Sphere(radius_m=0.3), P_WG, np.eye(3), np.zeros(3), np.zeros((6, 6)), 0.0, 0.0
    )
    m = replace(world(), tracks=(mover,), tube_horizon_s=30.0)
    result = planner.plan(m, resting_reference(P_WS, 0.0, 0), 0, P_WG, LIMITS)
    assert not result.reaches_goal


@every_planner
def test_same_inputs_give_the_same_reference(planner):
    current = resting_reference(P_WS, 0.0, 0)
    a, b = (planner.plan(pillar(), current, 0, P_WG, LIMITS).reference for _ in range(2))
    t = np.linspace(0, a.end_us, 50).astype(np.int64)
    np.testing.assert_array_equal(a.sample(t).p_WD, b.sample(t).p_WD)
