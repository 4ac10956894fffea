# SPDX-License-Identifier: Apache-2.0
"""The leading role, step by step."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.control.api import SolveStatus
from skyhaul.control.force_plan import load_error, plan_arrays, sample_motion, sample_plan
from skyhaul.geometry.quaternion import quat_exp, quat_mul
from skyhaul.geometry.shapes import Sphere
from skyhaul.mission.api import Phase
from skyhaul.mission.leader import Leader, move_load
from skyhaul.mission.triggers import PeriodicTrigger
from skyhaul.perception.api import ObstacleEstimate, Track
from skyhaul.types import LOAD_Q
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


def ball(t_us, p_WO, v_WO=(0.0, 0.0, 0.0), track_id=7):
    return Track(
        track_id, t_us, Sphere(radius_m=0.2), np.array(p_WO), np.eye(3), np.array(v_WO),
        np.zeros((6, 6)), 0.1, 0.02,
    )  # fmt: skip


def random_load(rng):
    q = rng.normal(size=4)
    return np.concatenate([rng.normal(size=3), q / np.linalg.norm(q), rng.normal(size=6)])


@pytest.mark.parametrize("seed", range(8))
def test_a_moved_load_is_off_by_the_error_it_was_moved_by(seed):
    rng = np.random.default_rng(seed)
    load, wanted, measured = random_load(rng), rng.normal(scale=0.8, size=12), np.empty(12)
    load_error(move_load(load, wanted), load, measured)
    np.testing.assert_allclose(measured, wanted, atol=1e-12)


def test_a_load_moved_by_nothing_stays_and_a_moved_attitude_is_unit():
    load = random_load(np.random.default_rng(3))
    np.testing.assert_allclose(move_load(load, np.zeros(12)), load, atol=1e-15)
    moved = move_load(load, np.full(12, 0.4))
    assert np.linalg.norm(moved[LOAD_Q]) == pytest.approx(1.0)


def test_a_flight_in_the_air_begins_with_a_solve_and_then_waits_for_an_event(ensemble):
    leader = leader_of(ensemble)
    assert leader.phase is Phase.CARRY
    estimate = look(leader, ensemble, 0)
    assert leader.solve_event(0, estimate) == "start"
    leader.solve(0, estimate, "start")
    assert leader.solve_event(2_000, ensemble.estimate(2_000)) is None
    assert [s.cause for s in ensemble.notes.solves] == ["start"]
    assert [m.topic for m in ensemble.notes.messages] == ["order", "plan"]
    assert leader.message.plan.stamp_us == 0


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


@pytest.mark.parametrize("size", [0.3, 1.0, 2.5])
def test_a_solve_starts_on_the_plan_or_where_the_load_left_its_tube(ensemble, size):
    leader, tube = leader_of(ensemble), ensemble.stack.mission.trigger.tube
    estimate = look(leader, ensemble, 0)
    leader.solve(0, estimate, "start")
    plan, t_us = leader.message.plan, 100_000
    planned = sample_plan(plan, t_us)
    error = np.zeros(12)
    error[:3] = size * tube.position_m * np.array([0.6, 0.0, 0.8])
    off = move_load(planned.load, error)
    state = replace(
        estimate.team, p_WL=off[:3], q_WL=off[3:7], v_WL=off[7:10], w_WL_L=off[10:13]
    )
    seen = []

    def solve(memory, request):
        seen.append(request)
        return memory, ensemble.notes.solves[0].solution

    leader._stack = replace(ensemble.stack, controller=Controller(solve))
    leader.solve(t_us, replace(estimate, team=state, stamp_us=t_us), "tube_exit")
    outside = max(0.0, 1.0 - 1.0 / size)
    np.testing.assert_allclose(seen[0].load[:3], planned.load[:3] + outside * error[:3], atol=1e-9)
    pull = planned.force_W + planned.gain @ (outside * error)
    np.testing.assert_allclose(seen[0].force_W, pull, atol=1e-9)
    np.testing.assert_allclose(seen[0].dforce_W, planned.dforce_W)


class Controller:
    """A payload controller made of one function."""

    def __init__(self, solve):
        self.solve = solve

    def init(self):
        return None


def test_a_failed_solve_is_noted_and_tried_again_after_the_dwell(ensemble):
    leader = leader_of(ensemble)
    estimate = look(leader, ensemble, 0)
    leader.solve(0, estimate, "start")
    good = ensemble.notes.solves[0].solution

    def fail(memory, request):
        return memory, replace(good, status=SolveStatus.FAILED)

    leader._stack = replace(ensemble.stack, controller=Controller(fail))
    leader.solve(2_000, estimate, "plan_age")
    assert ensemble.notes.triggers[-1].detail == "failed"
    age_us = round(1e6 * ensemble.stack.mission.trigger.dwell_s)
    assert leader.solve_event(age_us - 2_000, ensemble.estimate(age_us - 2_000)) is None
    assert leader.solve_event(age_us, ensemble.estimate(age_us)) == "solver_failure"


def test_without_feedback_the_plan_is_sent_bare(make_ensemble, stack, with_mission):
    e = make_ensemble(with_mission(stack, trigger=PeriodicTrigger()))
    leader = leader_of(e)
    leader.solve(0, look(leader, e, 0), "start")
    np.testing.assert_array_equal(leader.message.plan.gain, 0.0)
    assert np.abs(e.notes.solves[0].solution.plan.gain).max() > 0.0


def test_a_new_leader_measures_its_error_against_the_plan_that_it_received(ensemble):
    leader = leader_of(ensemble)
    estimate = look(leader, ensemble, 0)
    leader.solve(0, estimate, "start")
    old = leader.message
    moved = move_load(estimate.team.load, np.array([0.5, *np.zeros(11)]))
    state = replace(estimate.team, p_WL=moved[:3])
    leader.solve(200_000, replace(estimate, team=state, stamp_us=200_000), "tube_exit")
    assert leader.message is not old
    leader.take_over(1, old)
    planned, error = np.empty(19), np.empty(12)
    sample_motion(plan_arrays(old.plan), 0.3, planned)
    load_error(estimate.team.load, planned, error)
    np.testing.assert_array_equal(leader._plan_error(300_000, estimate.team.load), error)


def test_a_new_leader_without_a_plan_solves_from_what_is_measured(ensemble):
    leader = leader_of(ensemble)
    estimate = look(leader, ensemble, 0)
    leader.solve(0, estimate, "start")
    leader.take_over(1, None)
    assert leader.solve_event(2_000, estimate) == "start"
    leader.solve(2_000, estimate, "start")
    np.testing.assert_allclose(leader.message.plan.load[0, :3], estimate.team.p_WL, atol=1e-9)


def test_a_lost_vehicle_is_a_fault_that_solves_at_once_and_tilts_the_load(ensemble):
    leader = leader_of(ensemble)
    leader.solve(0, look(leader, ensemble, 0), "start")
    leader.hear(2_000, [], frozenset({1}))
    assert [t.cause for t in ensemble.notes.triggers] == ["start", "fault"]
    assert leader.solve_event(2_000, ensemble.estimate(2_000)) == "fault"
    leader.solve(2_000, ensemble.estimate(2_000), "fault")
    np.testing.assert_array_equal(leader.message.plan.active, [True, False, True, True])
    late = leader.reference.sample(np.array([5_000_000])).R_WD[0, 0]
    assert 10.0 < np.degrees(np.arccos(late[2, 2])) < 25.0


def test_two_of_four_cannot_carry_and_hold_still(ensemble):
    leader = leader_of(ensemble)
    leader.solve(0, look(leader, ensemble, 0), "start")
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
    leader.replan(0, cause)
    (replan,) = e.notes.replans
    assert replan.accepted
    end = leader.reference.sample(np.array([leader.reference.end_us])).p_WD[0]
    np.testing.assert_allclose(end[0], GOAL, atol=1e-9)
    np.testing.assert_allclose(end[1:5], 0.0, atol=1e-9)
    assert leader.solve_event(0, e.estimate(0, p_WL=HOME)) == "start"


def test_a_mover_ahead_replans_and_one_behind_does_not(journey):
    leader, e = journey
    leader.replan(0, "corridor_free")
    t_us = 500_000
    here = leader.reference.sample(np.array([t_us])).p_WD[0, 0]
    ahead = leader.reference.sample(np.array([t_us + 2_500_000])).p_WD[0, 0]
    behind = ball(t_us, here + [-1.2, -1.0, 0.5], (-0.3, 0.0, 0.0))
    look(leader, e, t_us, here, [behind])
    assert leader.detect_event(t_us, e.estimate(t_us, p_WL=here)) is None
    look(leader, e, t_us, here, [behind, ball(t_us, ahead + [0.0, 0.0, 0.3], track_id=8)])
    assert leader.detect_event(t_us, e.estimate(t_us, p_WL=here)) == "new_obstacle"


def test_an_equal_path_is_not_taken_in_place_of_the_one_that_is_flown(journey):
    leader, e = journey
    leader.replan(0, "corridor_free")
    before = leader.reference
    t_us = 1_500_000
    look(leader, e, t_us, before.sample(np.array([t_us])).p_WD[0, 0])
    leader.replan(t_us, "better_path")
    assert [r.accepted for r in e.notes.replans] == [True, False]
    assert leader.reference is before


def test_replanning_continues_the_motion(journey):
    leader, e = journey
    leader.replan(0, "corridor_free")
    before, t_us = leader.reference, 2_000_000
    now = before.sample(np.array([t_us])).p_WD[0]
    ahead = before.sample(np.array([t_us + 3_000_000])).p_WD[0, 0]
    look(leader, e, t_us, now[0], [ball(t_us, ahead + [0.0, 0.0, -0.5])])
    leader.replan(t_us, "new_obstacle")
    assert leader.reference is not before
    after = leader.reference.sample(np.array([t_us])).p_WD[0]
    np.testing.assert_allclose(after[:5], now[:5], atol=1e-6)


def test_a_quaternion_and_its_negative_are_the_same_error(ensemble):
    leader = leader_of(ensemble)
    estimate = look(leader, ensemble, 0)
    leader.solve(0, estimate, "start")
    turned = estimate.team.load.copy()
    turned[LOAD_Q] = quat_mul(turned[LOAD_Q], quat_exp(np.array([0.1, 0.0, 0.0])))
    flipped = turned.copy()
    flipped[LOAD_Q] *= -1.0
    np.testing.assert_allclose(leader._plan_error(0, turned), leader._plan_error(0, flipped))
