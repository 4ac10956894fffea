# SPDX-License-Identifier: Apache-2.0
"""The leading role, step by step."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.comms.messages import Status
from skyhaul.control.nmpc.corridor import corridor_rows
from skyhaul.geometry.shapes import Sphere
from skyhaul.mission.api import Phase
from skyhaul.mission.hearing import SILENT_US
from skyhaul.mission.leader import Leader
from skyhaul.mission.station import station_point
from skyhaul.perception.api import ObstacleEstimate, StaticObject, Track
from skyhaul.planning.api import Plan, PlanStatus, ReferencePlan, ReferenceStatus
from skyhaul.planning.cubic import CubicPlanner
from skyhaul.planning.reference import resting_reference
from skyhaul.planning.tasks import LIFT_DT_US
from skyhaul.world.scenario import AirStart

PERIOD_US = 20_000
MIDDLE = np.array([0.0, 0.0, 1.5])
HOME, GOAL = np.array([-2.5, -2.0, 1.5]), np.array([2.5, 2.0, 2.5])


def leader_of(e):
    return Leader(e.stack, 0, e.bus, e.notes, e.watch)


def look(leader, e, t_us, p_WL=MIDDLE, tracks=()):
    """Map and phase brought up to date at a time."""
    estimate = e.estimate(t_us, p_WL=p_WL)
    leader.update_map(estimate, ObstacleEstimate(t_us, (), tuple(tracks)))
    leader.advance(t_us, estimate)
    return estimate


def solve(leader, estimate, cause):
    leader.solve(estimate, cause)
    leader.deliver(estimate.stamp_us)


def replan(leader, t_us, cause):
    leader.replan(t_us, cause)
    leader.deliver(t_us)


def ball(t_us, p_WO, v_WO=(0.0, 0.0, 0.0), track_id=7):
    return Track(
        track_id, t_us, Sphere(radius_m=0.2), np.array(p_WO), np.eye(3), np.array(v_WO),
        np.zeros((6, 6)), 0.1, 0.02,
    )  # fmt: skip


def test_a_flight_in_the_air_begins_with_a_solve_and_then_waits_for_an_event(ensemble):
    leader = leader_of(ensemble)
    assert leader.phase is Phase.CARRY
    estimate = look(leader, ensemble, 0)
    assert leader.solve_event(0, estimate) == "start"
    solve(leader, estimate, "start")
    assert leader.solve_event(2_000, ensemble.estimate(2_000)) is None
    assert [s.cause for s in ensemble.notes.solves] == ["start"]
    assert [m.topic for m in ensemble.notes.messages] == ["order", "plan"]
    assert leader.forces.message.plan.stamp_us == 0


def test_the_order_is_sent_when_it_changes_and_only_then(ensemble):
    leader = leader_of(ensemble)
    for k in range(5):
        look(leader, ensemble, k * PERIOD_US)
    assert [m.topic for m in ensemble.notes.messages] == ["order"]
    leader.hear(5 * PERIOD_US, [], frozenset({2}))
    look(leader, ensemble, 5 * PERIOD_US)
    orders = [m.payload for m in ensemble.notes.messages if m.topic == "order"]
    np.testing.assert_array_equal(orders[-1].active, [True, True, False, True])
    assert [o.since_us for o in orders] == [0, 0]  # the phase goes on


def test_a_new_leader_without_a_plan_solves_from_what_is_measured(ensemble):
    leader = leader_of(ensemble)
    estimate = look(leader, ensemble, 0)
    solve(leader, estimate, "start")
    leader.take_over(2_000, 1, None, None)
    assert leader.solve_event(2_000, estimate) == "start"
    solve(leader, replace(estimate, stamp_us=2_000), "start")
    np.testing.assert_allclose(
        leader.forces.message.plan.load[0, :3], estimate.team.p_WL, atol=1e-9
    )


def test_a_lost_vehicle_is_a_fault_that_solves_at_once_and_tilts_the_load(ensemble):
    leader = leader_of(ensemble)
    solve(leader, look(leader, ensemble, 0), "start")
    leader.hear(2_000, [], frozenset({1}))
    assert [t.cause for t in ensemble.notes.triggers] == ["start", "fault"]
    assert leader.solve_event(2_000, ensemble.estimate(2_000)) == "fault"
    solve(leader, ensemble.estimate(2_000), "fault")
    np.testing.assert_array_equal(leader.forces.message.plan.active, [True, False, True, True])
    late = leader.reference.sample(np.array([5_000_000])).R_WD[0, 0]
    assert 10.0 < np.degrees(np.arccos(late[2, 2])) < 25.0


def test_a_team_that_lost_a_vehicle_stays_tilted_when_it_plans_from_where_it_strayed(journey):
    leader, e = journey
    solve(leader, look(leader, e, 0, HOME), "start")
    leader.hear(2_000, [], frozenset({1}))
    t_us = 5_000_000
    look(leader, e, t_us, HOME + np.array([0.5, 0.0, 0.0]))
    replan(leader, t_us, "tracking_error")
    assert e.notes.replans[-1].accepted
    up = leader.reference.sample(np.array([t_us, t_us + 2_000_000])).R_WD[:, 0, 2, 2]
    assert np.all(np.degrees(np.arccos(up)) > 10.0)


def test_two_of_four_cannot_carry_and_hold_still(ensemble):
    leader = leader_of(ensemble)
    solve(leader, look(leader, ensemble, 0), "start")
    leader.hear(2_000, [], frozenset({1, 2}))
    look(leader, ensemble, PERIOD_US)
    assert leader.phase is Phase.SAFE


@pytest.fixture
def journey(make_ensemble, ground_stack):
    """A leader in CARRY at the start of a journey from HOME to GOAL."""
    e = make_ensemble(replace(ground_stack, start=AirStart(payload_m=tuple(HOME))))
    leader = leader_of(e)
    look(leader, e, 0, HOME)
    return leader, e


def test_a_journey_begins_with_a_plan_to_the_goal(journey):
    leader, e = journey
    cause = leader.detect_event(0, e.estimate(0, p_WL=HOME))
    assert cause == "corridor_free"
    replan(leader, 0, cause)
    assert [r.accepted for r in e.notes.replans] == [True]
    end = leader.reference.sample(np.array([leader.reference.end_us])).p_WD[0]
    np.testing.assert_allclose(end[0], GOAL, atol=1e-9)
    np.testing.assert_allclose(end[1:5], 0.0, atol=1e-9)
    assert leader.solve_event(0, e.estimate(0, p_WL=HOME)) == "start"


def lifting(e, make_ensemble, ground_stack, t_us):
    """A leader whose team has begun to lift at a time, cables taut."""
    leader = leader_of(make_ensemble(ground_stack))
    look(leader, e, t_us - PERIOD_US, FLOOR)
    leader.hear(t_us, [taut(i, t_us) for i in range(4)], frozenset())
    look(leader, e, t_us, FLOOR)
    return leader


FLOOR = np.array([0.0, 0.0, 0.04])


def taut(i, t_us):
    return Status(
        stamp_us=t_us, vehicle=i, p_WB=np.zeros(3), v_WB=np.zeros(3), tension=0.5, taut=True,
        attached=True, at_station=True, station_in_s=0.0, on_way_s=1.0,
        faulty=np.zeros(4, np.bool_), hears=np.ones(4, np.bool_), order_us=-1, plan_us=-1,
    )  # fmt: skip


def test_the_journey_is_planned_while_the_load_rises_and_not_before(
    ensemble, make_ensemble, ground_stack
):
    t_us = 1_000_000
    leader = lifting(ensemble, make_ensemble, ground_stack, t_us)
    assert leader.phase is Phase.LIFT
    rise_us = leader.reference.start_us + LIFT_DT_US
    for now, cause in ((rise_us - PERIOD_US, None), (rise_us, "corridor_free")):
        estimate = look(leader, ensemble, now, FLOOR)
        assert leader.detect_event(now, estimate) == cause
    before = leader.reference
    replan(leader, rise_us, "corridor_free")
    assert leader.phase is Phase.LIFT
    end = leader.reference.sample(np.array([leader.reference.end_us])).p_WD[0, 0]
    np.testing.assert_allclose(end, GOAL, atol=1e-9)
    ahead = rise_us + np.arange(0, 400_000, 50_000)
    a, b = (r.sample(ahead).p_WD[:, 0] for r in (before, leader.reference))
    np.testing.assert_allclose(b[:, :2], a[:, :2], atol=0.01)  # straight up at first


def test_a_vehicle_lost_while_the_load_stands_on_the_floor_calls_the_take_off_off(
    ensemble, make_ensemble, ground_stack
):
    for t_us in (1_000_000, 1_600_000):
        leader = lifting(ensemble, make_ensemble, ground_stack, 1_000_000)
        assert leader.phase is Phase.LIFT
        leader.hear(t_us, [], frozenset({1}))
        look(leader, ensemble, t_us, FLOOR)
        assert leader.order.phase == Phase.ABORT.value
        assert leader.solve_event(t_us, ensemble.estimate(t_us)) is None
    leader = lifting(ensemble, make_ensemble, ground_stack, 1_000_000)
    leader.hear(2_000_000, [], frozenset({1}))
    look(leader, ensemble, 2_000_000, np.add(FLOOR, [0.0, 0.0, 0.05]))
    assert leader.phase is Phase.LIFT  # in the air it is flown on


def test_while_the_floor_holds_the_load_what_stands_beside_it_does_not_push_it(
    ensemble, make_ensemble, ground_stack
):
    leader, t_us = lifting(ensemble, make_ensemble, ground_stack, 1_000_000), 2_000_000
    beside = StaticObject(0, Sphere(radius_m=0.3), np.array([1.2, 0.0, 0.3]), np.eye(3))
    maps, places = [], []
    leader.forces.solve = lambda *request: maps.append(request[3])
    for height_m in (0.0, 0.2):
        estimate = ensemble.estimate(t_us, p_WL=np.add(FLOOR, [0.0, 0.0, height_m]))
        leader.update_map(estimate, ObstacleEstimate(t_us, (beside,), (ball(t_us, [0, 1.2, 1]),)))
        leader.solve(estimate, "plan_age")
        places.append(estimate.team.p_WL[None])
    now = np.array([t_us])
    gaps = [corridor_rows(m, p, now, 1) for m, p in zip(maps, places, strict=True)]
    assert [r.active[0, :2].any() for r in gaps] == [False, True]
    assert [bool(r.active[0, 2]) for r in gaps] == [True, True]  # movers count all the time


def test_a_take_off_that_waits_for_a_silent_vehicle_says_so(ensemble, make_ensemble, ground_stack):
    leader = leader_of(make_ensemble(ground_stack))
    look(leader, ensemble, 0, FLOOR)
    leader.hear(0, [taut(i, 0) for i in range(4)], frozenset())
    t_us = PERIOD_US + SILENT_US
    leader.hear(t_us, [taut(i, t_us) for i in (0, 1, 3)], frozenset())
    look(leader, ensemble, t_us, FLOOR)
    assert leader.phase is Phase.TAUTEN  # though all were at their stations, cables taut
    assert leader.hindrance(t_us).sentence() == "vehicle 2 is not heard since 0.0 s"


def test_a_mover_over_a_station_holds_the_take_off(ensemble, make_ensemble, ground_stack):
    leader = leader_of(make_ensemble(ground_stack))
    station = station_point(ground_stack.team, FLOOR, np.eye(3), 3, 1.0)
    look(leader, ensemble, 0, FLOOR)
    assert not leader.order.retreat
    look(leader, ensemble, PERIOD_US, FLOOR, [ball(PERIOD_US, station)])
    assert leader.order.retreat
    look(leader, ensemble, 2 * PERIOD_US, FLOOR, [ball(2 * PERIOD_US, station + 3.0)])
    assert not leader.order.retreat


def test_a_team_that_rests_for_a_mover_looks_for_a_better_way_often(journey):
    leader, e = journey
    replan(leader, 0, "corridor_free")
    for waits_us, cause in ((1_000_000, "corridor_free"), (0, None)):
        rests = resting_reference(HOME, 0.0, 0, dt_us=4_000_000)
        result = ReferencePlan(
            ReferenceStatus.OK, Plan(PlanStatus.FOUND), rests, waits_us, reaches_goal=True
        )
        leader._stack = replace(e.stack, planner=Planner(result))
        replan(leader, 0, "clearance")
        look(leader, e, 600_000, HOME)
        assert leader.detect_event(600_000, e.estimate(600_000, p_WL=HOME)) == cause


def test_a_mover_ahead_replans_and_one_behind_does_not(journey):
    leader, e = journey
    replan(leader, 0, "corridor_free")
    t_us = 500_000
    here = leader.reference.sample(np.array([t_us])).p_WD[0, 0]
    ahead = leader.reference.sample(np.array([t_us + 2_500_000])).p_WD[0, 0]
    behind = ball(t_us, np.add(here, [-1.2, -1.0, 0.5]), (-0.3, 0.0, 0.0))
    look(leader, e, t_us, here, [behind])
    assert leader.detect_event(t_us, e.estimate(t_us, p_WL=here)) is None
    look(leader, e, t_us, here, [behind, ball(t_us, np.add(ahead, [0.0, 0.0, 0.3]), track_id=8)])
    assert leader.detect_event(t_us, e.estimate(t_us, p_WL=here)) == "new_obstacle"


def test_an_equal_path_is_not_taken_in_place_of_the_one_that_is_flown(journey):
    leader, e = journey
    replan(leader, 0, "corridor_free")
    before = leader.reference
    t_us = 1_500_000
    look(leader, e, t_us, before.sample(np.array([t_us])).p_WD[0, 0])
    replan(leader, t_us, "better_path")
    assert [r.accepted for r in e.notes.replans] == [True, False]
    assert leader.reference is before


@pytest.mark.parametrize(
    ("share", "clearance_m", "taken"), [(1.4, 1.0, False), (0.8, 1.0, True), (1.2, 0.0, False)]
)
@pytest.mark.parametrize("reaches_goal", [True, False])
def test_a_better_path_is_taken_when_it_saves_enough_and_leads_to_the_goal(
    journey, share, clearance_m, taken, reaches_goal
):
    """The other path has no length here: it may take longer, but not if it is tight too."""
    leader, e = journey
    replan(leader, 0, "corridor_free")
    quicker = resting_reference(GOAL, 0.0, round(share * leader.reference.end_us))
    path = Plan(PlanStatus.FOUND)
    result = ReferencePlan(
        ReferenceStatus.OK, path, quicker, reaches_goal=reaches_goal, min_clearance_m=clearance_m
    )
    leader._stack = replace(e.stack, planner=Planner(result))
    replan(leader, 0, "better_path")
    assert (leader.reference is quicker) == (taken and reaches_goal)


class Planner:
    """A reference planner with a set answer."""

    def __init__(self, result):
        self._result = result

    def plan(self, world_map, current, t_us, p_WG, limits):
        return self._result


@pytest.mark.parametrize("status", [ReferenceStatus.NO_PATH, ReferenceStatus.BLOCKED])
def test_without_a_clear_curve_the_reference_in_force_stays(journey, status):
    leader, e = journey
    replan(leader, 0, "corridor_free")
    before = leader.reference
    leader._stack = replace(
        e.stack, planner=Planner(ReferencePlan(status, Plan(PlanStatus.NO_PATH), None))
    )
    replan(leader, 500_000, "clearance")
    assert leader.reference is before
    assert [r.accepted for r in e.notes.replans] == [True, False]


def test_replanning_continues_the_motion(journey):
    leader, e = journey
    replan(leader, 0, "corridor_free")
    before, t_us = leader.reference, 2_000_000
    now = before.sample(np.array([t_us])).p_WD[0]
    ahead = before.sample(np.array([t_us + 3_000_000])).p_WD[0, 0]
    look(leader, e, t_us, now[0], [ball(t_us, np.add(ahead, [0.0, 0.0, -0.5]))])
    replan(leader, t_us, "new_obstacle")
    assert leader.reference is not before
    after = leader.reference.sample(np.array([t_us])).p_WD[0]
    np.testing.assert_allclose(after[:5], now[:5], atol=1e-6)


def test_a_reference_that_is_on_its_way_does_not_undo_a_stop(make_ensemble, ground_stack):
    stack = replace(ground_stack, start=AirStart(payload_m=tuple(HOME)))
    e = make_ensemble(replace(stack, mission=replace(stack.mission, latency="measured")))
    leader = leader_of(e)
    look(leader, e, 0, HOME)
    leader.replan(0, "corridor_free")  # takes effect some milliseconds later
    leader.hear(0, [], frozenset({1, 2}))
    look(leader, e, PERIOD_US, HOME)
    assert leader.phase is Phase.SAFE
    leader.deliver(10_000_000)
    end = leader.reference.sample(np.array([leader.reference.end_us])).p_WD[0, 0]
    np.testing.assert_allclose(end, HOME, atol=1e-9)


def test_a_team_on_the_papers_cubic_survives_a_loss_too(make_ensemble, ground_stack):
    planner = CubicPlanner().build(ground_stack.shape)
    start = AirStart(payload_m=tuple(HOME))
    e = make_ensemble(replace(ground_stack, planner=planner, start=start))
    leader = leader_of(e)
    look(leader, e, 0, HOME)
    replan(leader, 0, "corridor_free")
    t_us = 2_000_000
    before = leader.reference.sample(np.array([t_us])).p_WD[0]
    look(leader, e, t_us, before[0])
    leader.hear(t_us, [], frozenset({1}))
    after = leader.reference.sample(np.array([t_us, t_us + 5_000_000]))
    np.testing.assert_allclose(after.p_WD[0, :2], before[:2], atol=1e-9)
    assert np.linalg.norm(leader.reference.sample(np.array([t_us + 500_000])).p_WD[0, 1]) > 0.1
    replan(leader, t_us + 500_000, "corridor_free")  # and the next plan keeps it tilted
    assert np.degrees(np.arccos(after.R_WD[1, 0, 2, 2])) > 10.0
