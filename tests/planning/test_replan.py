# SPDX-License-Identifier: Apache-2.0
"""The planner in random forests and among movers: clear, within limits, smooth, never stuck."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.shapes import Box, Sphere, pose_shapes
from skyhaul.geometry.team_clearance import team_clearances
from skyhaul.mapping.api import WorldMap
from skyhaul.mapping.mapper import Mapping
from skyhaul.model.envelope import TeamShape
from skyhaul.model.state import TeamState
from skyhaul.perception.api import ObstacleEstimate, StaticObject, Track
from skyhaul.planning.api import PlanStatus, ReferenceStatus
from skyhaul.planning.astar import AStar
from skyhaul.planning.dijkstra import Dijkstra
from skyhaul.planning.reference import remaining_time, resting_reference, stop_reference
from skyhaul.planning.replan import SplinePlanner, capped
from skyhaul.world.scenario import Limits, MapFrame, Room

SHAPE = TeamShape(radius_m=0.5, above_m=0.7, below_m=0.2)
DIMS = (0.5, 0.7, 0.2)
LIMITS = Limits()
PLANNER = SplinePlanner().build(SHAPE)
MAPPER = Mapping(exempt_m=0.0, truncation_m=1.5).build(
    MapFrame(origin_m=(-1.0, -1.0, 0.0), size_m=(8.0, 8.0, 6.0)),
    Room(min_m=(-1.0, -1.0, 0.0), max_m=(7.0, 7.0, 6.0)),
    SHAPE,
)


def team_at(p_WL) -> TeamState:
    z = np.zeros
    return TeamState(
        np.array(p_WL, np.float64), np.array([1.0, 0, 0, 0]), z(3), z(3),
        z((4, 3)), z((4, 4)), z((4, 3)), z((4, 3)),
    )  # fmt: skip


def world(statics=(), tracks=(), stamp_us=0) -> WorldMap:
    estimate = ObstacleEstimate(stamp_us, tuple(statics), tuple(tracks))
    return MAPPER.step(MAPPER.init(), estimate, team_at((0.0, 0.0, 1.0)))[1]


def forest(seed) -> tuple[StaticObject, ...]:
    rng = np.random.default_rng(seed)
    out = []
    for i in range(rng.integers(3, 12)):
        box = Box(size_m=tuple(rng.uniform(0.1, 0.5, 3)), yaw_deg=float(rng.uniform(0, 90)))
        shape = box if rng.random() < 0.5 else Sphere(radius_m=float(rng.uniform(0.05, 0.3)))
        p = rng.uniform([-0.5, -0.5, 0.2], [6.5, 6.5, 5.5])
        out.append(StaticObject(i, shape, p, pose_shapes([shape], p).R_WO[0]))
    return tuple(out)


def mover(i, p, v, stamp_us=0, growth_mps=0.05) -> Track:
    return Track(
        i, stamp_us, Sphere(radius_m=0.2), np.array(p, np.float64), np.eye(3),
        np.array(v, np.float64), np.zeros((6, 6)), growth_mps, 0.02,
    )  # fmt: skip


def ends(seed) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng([seed, 1])
    return rng.uniform([0, 0, 0.5], [2, 2, 2]), rng.uniform([4, 4, 2], [6, 6, 4.5])


def start(p) -> object:
    return resting_reference(np.array(p, np.float64), 0.0, 0)


def clearance_along(m: WorldMap, r, since_us=0) -> np.ndarray:
    last = max(r.end_us, m.stamp_us + round(1e6 * m.tube_horizon_s))
    t = np.arange(since_us, last, 7_000)
    return m.clearance(r.sample(t).p_WD[:, 0], t)


def true_clearance(statics, r) -> float:
    rows = pose_shapes([o.shape for o in statics], np.array([o.p_WO for o in statics]))
    p = r.sample(np.arange(r.start_us, r.end_us, 20_000)).p_WD[:, 0]
    return min(float(team_clearances(DIMS, q, *rows).min()) for q in p)


@pytest.mark.parametrize("block", range(10))
def test_in_200_random_forests_every_accepted_plan_is_clear_and_within_limits(block):
    arrived = 0
    for seed in range(20 * block, 20 * block + 20):
        statics, (p_WS, p_WG) = forest(seed), ends(seed)
        m = world(statics)
        result = PLANNER.plan(m, start(p_WS), 0, p_WG, LIMITS)
        if m.clearance(p_WS[None], [0])[0] < 0.1 or result.status is not ReferenceStatus.OK:
            continue
        r = result.reference
        assert clearance_along(m, r).min() > 0.0
        assert true_clearance(statics, r) > 0.0
        assert r.max_speed_mps() <= 1.02 * LIMITS.v_max_mps
        assert r.max_acceleration_mps2() <= 1.02 * LIMITS.a_max_mps2
        assert r.max_jerk_mps3() <= 1.02 * LIMITS.j_max_mps3
        end = r.sample(np.array([r.end_us])).p_WD[0]
        np.testing.assert_allclose(end[1:5], 0.0, atol=1e-9)
        if result.reaches_goal:
            np.testing.assert_allclose(end[0], p_WG, atol=1e-9)
            arrived += 1
    assert arrived >= 8


@pytest.mark.parametrize("seed", range(12))
def test_replanning_from_a_moving_state_keeps_derivatives_0_to_6_and_stays_clear(seed):
    statics, (p_WS, p_WG) = forest(seed), ends(seed)
    m, rng = world(statics), np.random.default_rng([seed, 2])
    current = PLANNER.plan(world(), start(p_WS), 0, p_WG, LIMITS).reference
    t = int(rng.uniform(0.5e6, 3e6))
    m = replace(m, stamp_us=t)
    result = PLANNER.plan(m, current, t, p_WG + rng.uniform(-0.6, 0.6, 3), LIMITS)
    best = result.reference or result.best_effort
    a, b = current.derivatives(t), best.derivatives(t)
    np.testing.assert_allclose(b, a, atol=1e-7 * (1.0 + np.abs(a).max()))
    if result.reference is not None and clearance_along(m, current, t)[0] > 0.1:
        assert clearance_along(m, best, t).min() > 0.0


@pytest.mark.parametrize("seed", range(12))
def test_among_movers_every_accepted_plan_is_clear_of_their_tubes(seed):
    (p_WS, p_WG), rng = ends(seed), np.random.default_rng([seed, 3])
    tracks = []
    for i in range(4):
        v = rng.normal(size=3) * 0.3
        tracks.append(mover(i, rng.uniform([1, 1, 1], [5, 5, 4]) - 2.0 * v, v))
    m = world(forest(seed)[:3], tracks)
    result = PLANNER.plan(m, start(p_WS), 0, p_WG, LIMITS)
    if m.clearance(p_WS[None], [0])[0] > 0.1 and result.status is ReferenceStatus.OK:
        assert clearance_along(m, result.reference).min() > 0.0


CORRIDOR = (
    StaticObject(0, Box(size_m=(3.0, 3.4, 6.0)), np.array([3.0, 0.3, 3.0]), np.eye(3)),
    StaticObject(1, Box(size_m=(3.0, 3.4, 6.0)), np.array([3.0, 5.7, 3.0]), np.eye(3)),
    StaticObject(2, Box(size_m=(3.0, 3.0, 4.4)), np.array([3.0, 3.0, 4.4]), np.eye(3)),
)
IN, OUT = np.array([0.2, 3.0, 1.0]), np.array([5.8, 3.0, 1.0])


def test_a_mover_that_crosses_the_only_corridor_is_waited_for():
    """It passes the near mouth of the corridor while the team would enter."""
    free = PLANNER.plan(world(CORRIDOR), start(IN), 0, OUT, LIMITS)
    m = world(CORRIDOR, [mover(9, (1.2, 2.2, 1.1), (0.0, 0.35, 0.0))])
    result = PLANNER.plan(m, start(IN), 0, OUT, LIMITS)
    assert result.status is ReferenceStatus.OK
    assert result.reaches_goal
    assert result.reference.end_us > free.reference.end_us + 500_000
    assert clearance_along(m, result.reference).min() > 0.0


def test_a_mover_that_stays_in_the_only_corridor_is_waited_for_near_it():
    m = replace(
        world(CORRIDOR, [mover(9, (3.4, 3.0, 1.1), (0, 0, 0), growth_mps=0.0)]), tube_horizon_s=30.0
    )
    result = PLANNER.plan(m, start(IN), 0, OUT, LIMITS)
    assert result.status is ReferenceStatus.OK
    assert not result.reaches_goal
    end = result.reference.sample(np.array([result.reference.end_us])).p_WD[0, 0]
    assert 0.3 < end[0] < 3.4
    assert clearance_along(m, result.reference).min() > 0.0


def test_in_open_space_a_mover_that_stays_is_flown_round():
    m = replace(
        world((), [mover(9, (3.0, 3.0, 1.4), (0, 0, 0), growth_mps=0.0)]), tube_horizon_s=30.0
    )
    result = PLANNER.plan(m, start(IN), 0, OUT, LIMITS)
    assert result.reaches_goal
    assert clearance_along(m, result.reference).min() > 0.0


def test_a_mover_on_the_goal_is_waited_for_near_it():
    m = replace(
        world((), [mover(9, OUT + np.array([0.0, 0.0, 0.3]), (0, 0, 0), growth_mps=0.0)]),
        tube_horizon_s=30.0,
    )
    result = PLANNER.plan(m, start(IN), 0, OUT, LIMITS)
    assert result.status is ReferenceStatus.OK
    assert not result.reaches_goal
    end = result.reference.sample(np.array([result.reference.end_us])).p_WD[0, 0]
    assert np.linalg.norm(end - OUT) < 2.0


def test_a_mover_that_crosses_open_space_is_passed_without_a_stop():
    """It would meet the team half way; there is room on all sides."""
    free = PLANNER.plan(world(), start(IN), 0, OUT, LIMITS)
    m = world((), [mover(9, (3.0, 5.0, 1.3), (0.0, -0.5, 0.0))])
    result = PLANNER.plan(m, start(IN), 0, OUT, LIMITS)
    assert result.reaches_goal
    assert result.waits_us == 0
    assert (
        clearance_along(m, free.reference).min() < 0.0 < clearance_along(m, result.reference).min()
    )
    assert result.reference.end_us < free.reference.end_us + 1_500_000


def test_near_a_taken_goal_it_waits_close_by_and_clear():
    m = world((), [mover(9, OUT, (0, 0, 0))])
    result = PLANNER.plan(m, start(IN), 0, OUT, LIMITS)
    end = result.reference.sample(np.array([result.reference.end_us])).p_WD[0, 0]
    assert not result.reaches_goal
    assert np.linalg.norm(end - OUT) < 1.45
    assert clearance_along(m, result.reference).min() > 0.0


@pytest.mark.parametrize("kind", [AStar(), Dijkstra()])
def test_the_path_search_can_be_exchanged(kind):
    planner = SplinePlanner(path=kind).build(SHAPE)
    m = world(forest(4)[:5])
    p_WS, p_WG = ends(4)
    result = planner.plan(m, start(p_WS), 0, p_WG, LIMITS)
    assert result.reaches_goal
    assert clearance_along(m, result.reference).min() > 0.0
    assert result.path.n_expanded >= PLANNER.plan(m, start(p_WS), 0, p_WG, LIMITS).path.n_expanded


def test_hovering_in_the_way_of_a_mover_it_steps_aside():
    here = np.array([3.0, 3.0, 2.0])
    m = world((), [mover(9, (5.4, 3.0, 2.2), (-0.5, 0, 0))])
    assert clearance_along(m, start(here)).min() < 0.0
    result = PLANNER.plan(m, start(here), 0, here, LIMITS)
    assert result.status is ReferenceStatus.OK
    assert clearance_along(m, result.reference).min() > 0.0


def test_without_a_way_out_it_says_so_and_offers_the_least_bad_curve():
    here = np.array([3.0, 3.0, 2.0])
    ring = [mover(i, here + 1.1 * np.array([np.cos(a), np.sin(a), 0.1]),
                  (-0.6 * np.cos(a), -0.6 * np.sin(a), 0.0))
            for i, a in enumerate(np.linspace(0, 2 * np.pi, 12, endpoint=False))]  # fmt: skip
    roof = [
        mover(20 + i, here + np.array([0.0, 0.0, z]), (0.0, 0.0, -z / 3))
        for i, z in enumerate((1.5, -1.0))
    ]
    result = PLANNER.plan(world((), ring + roof), start(here), 0, OUT, LIMITS)
    assert result.status is ReferenceStatus.BLOCKED
    assert result.reference is None
    assert result.best_effort is not None
    assert result.min_clearance_m < 0.0


def test_a_clear_reference_is_kept_until_another_is_much_quicker():
    m = world(forest(3)[:4])
    p_WS, p_WG = ends(3)
    first = PLANNER.plan(m, start(p_WS), 0, p_WG, LIMITS).reference
    later = replace(m, stamp_us=2_000_000)
    assert PLANNER.plan(later, first, 2_000_000, p_WG, LIMITS).reference is first
    slow = PLANNER.plan(m, start(p_WS), 0, p_WG, replace(LIMITS, v_max_mps=0.4)).reference
    quick = PLANNER.plan(later, slow, 2_000_000, p_WG, LIMITS).reference
    assert remaining_time(quick, 2_000_000) < 0.85 * remaining_time(slow, 2_000_000)


def test_a_blocked_reference_is_left():
    m = world()
    p_WS, p_WG = np.array([0.0, 0.0, 1.0]), np.array([6.0, 6.0, 4.0])
    first = PLANNER.plan(m, start(p_WS), 0, p_WG, LIMITS).reference
    block = StaticObject(0, Sphere(radius_m=0.3), np.array([3.5, 3.5, 2.7]), np.eye(3))
    blocked = replace(world([block]), stamp_us=1_500_000)
    result = PLANNER.plan(blocked, first, 1_500_000, p_WG, LIMITS)
    assert result.reaches_goal
    assert result.reference is not first
    assert clearance_along(blocked, result.reference, 1_500_000).min() > 0.0


def test_an_obstacle_that_appears_ahead_is_braked_for_or_rounded():
    m = world()
    p_WS, p_WG = np.array([0.0, 3.0, 1.5]), np.array([6.4, 3.0, 1.5])
    first = PLANNER.plan(m, start(p_WS), 0, p_WG, LIMITS).reference
    t = 3_000_000
    ahead = first.derivatives(t)[0, :3] + np.array([2.0, 0.0, 0.3])
    block = StaticObject(0, Sphere(radius_m=0.3), ahead, np.eye(3))
    blocked = replace(world([block]), stamp_us=t)
    assert np.linalg.norm(first.derivatives(t)[1]) > 1.3
    result = PLANNER.plan(blocked, first, t, p_WG, LIMITS)
    assert result.status is ReferenceStatus.OK
    assert clearance_along(blocked, result.reference, t).min() > 0.0


def test_from_an_emergency_it_returns_to_a_smooth_flight():
    m = world()
    first = PLANNER.plan(m, start(IN), 0, OUT, LIMITS).reference
    stop = stop_reference(first, 2_000_000, LIMITS)
    result = PLANNER.plan(replace(m, stamp_us=2_600_000), stop, 2_600_000, OUT, LIMITS)
    assert result.reaches_goal
    calm = PLANNER.plan(replace(m, stamp_us=stop.end_us), stop, stop.end_us, OUT, LIMITS).reference
    assert calm.max_jerk_mps3() <= LIMITS.j_max_mps3


def test_no_path_is_a_status_and_the_team_stays():
    wall = StaticObject(0, Box(size_m=(0.4, 9.0, 9.0)), np.array([3.0, 3.0, 3.0]), np.eye(3))
    result = PLANNER.plan(world([wall]), start(IN), 0, OUT, LIMITS)
    assert result.path.status in (PlanStatus.NO_PATH, PlanStatus.OUT_OF_BUDGET)
    assert not result.reaches_goal


def test_same_inputs_give_the_same_plan():
    m = world(forest(5), [mover(9, (3, 3, 2), (0.2, 0.1, 0))])
    a, b = (PLANNER.plan(m, start(IN), 0, OUT, LIMITS) for _ in range(2))
    np.testing.assert_array_equal(a.reference.control, b.reference.control)


def test_the_speed_cap_lets_the_team_stop_in_known_space():
    m = replace(world(), known_range_m=1.5)
    v = capped(LIMITS, m).v_max_mps
    assert v * 0.6 + v * v / (2.0 * LIMITS.a_brake_mps2) == pytest.approx(1.0)
    result = PLANNER.plan(m, start(IN), 0, OUT, LIMITS)
    assert result.reference.max_speed_mps() <= v * 1.001
    assert capped(LIMITS, world()).v_max_mps == LIMITS.v_max_mps


def test_remaining_time_is_that_until_the_end_and_never_negative():
    reference = resting_reference(IN, 0.0, 0, dt_us=300_000)
    assert remaining_time(reference, 100_000) == pytest.approx(0.2)
    assert remaining_time(reference, 900_000) == 0.0


@pytest.mark.parametrize(("name", "value"), [("dt_s", 0.0), ("keep_ratio", 1.5)])
def test_parameters_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} must .* got"):
        SplinePlanner(**{name: value})
