# SPDX-License-Identifier: Apache-2.0
"""The force plan: from where it is solved anew, and what is sent."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.comms.messages import PlanMessage
from skyhaul.control.api import ControlRequest, SolveStatus
from skyhaul.control.force_plan import load_error, plan_arrays, sample_motion, sample_plan
from skyhaul.geometry.quaternion import quat_exp, quat_mul
from skyhaul.mapping.api import OccupancyGrid
from skyhaul.mapping.mapper import static_map
from skyhaul.mission.forces import ForcePlanning, move_load
from skyhaul.mission.triggers import PeriodicTrigger
from skyhaul.planning.heading import fan_out
from skyhaul.planning.reference import resting_reference
from skyhaul.types import LOAD_Q

ALL = np.ones(4, dtype=bool)
REST = resting_reference(np.array([0.0, 0.0, 1.5]), 0.0, 0)
HEADING = fan_out(REST, np.arange(4) * np.pi / 2, 0)


class Answer:
    """A payload controller that notes what it is asked and gives a set answer."""

    def __init__(self, solution):
        self.requests, self._solution = [], solution

    def init(self):
        return None

    def solve(self, memory, request):
        self.requests.append(request)
        return memory, self._solution


def forces_of(e):
    return ForcePlanning(e.stack, e.notes)


def solve(forces, e, estimate, cause="start", active=ALL):
    """Solve and put the plan in force; returns its message."""
    world = static_map(OccupancyGrid(np.zeros((4, 4, 4), bool), np.zeros(3), 0.1), e.stack.shape)
    forces.solve(cause, estimate, REST, world, active)
    plan = forces.take(estimate.stamp_us)
    message = PlanMessage(estimate.stamp_us, plan, REST, HEADING)
    forces.follow(message)
    return message


def solve_of(e, estimate):
    """A solution of the geometric law at hover."""
    request = ControlRequest(
        stamp_us=0,
        load=estimate.team.load,
        force_W=-estimate.cables.tension[:, None] * estimate.cables.dir_W,
        dforce_W=np.zeros((4, 3)),
        active=ALL,
        reference=REST,
        world_map=None,
    )
    return e.stack.controller.solve(None, request)[1]


def shifted(estimate, t_us, load):
    """The estimate with another load state at another time."""
    p, q, v, w = load[:3], load[3:7], load[7:10], load[10:13]
    state = replace(estimate.team, p_WL=p, q_WL=q, v_WL=v, w_WL_L=w)
    return replace(estimate, team=state, stamp_us=t_us)


def random_load(rng):
    q = rng.normal(size=4)
    return np.concatenate([rng.normal(size=3), q / np.linalg.norm(q), rng.normal(size=6)])


class Failing(Answer):
    """A payload controller whose solves fail: the plan stays the last one."""

    def __init__(self, solution, works_from_us=10**12):
        super().__init__(replace(solution, status=SolveStatus.FAILED))
        self._works_from_us = works_from_us

    def solve(self, memory, request):
        memory, failed = super().solve(memory, request)
        works = request.stamp_us >= self._works_from_us
        plan = replace(failed.plan, stamp_us=request.stamp_us * works)
        return memory, replace(failed, plan=plan, status=SolveStatus.OK if works else failed.status)


def fly_on(forces, e, seconds):
    """Solve whenever it is due; returns when, and by which law [s]."""
    solved = []
    for t_us in range(2_000, round(1e6 * seconds), 2_000):
        estimate = e.estimate(t_us)
        cause = forces.due(t_us, estimate, np.inf)
        if cause is not None:
            before = len(e.stack.controller.requests)
            solve(forces, e, estimate, cause)
            asked = len(e.stack.controller.requests) > before
            solved.append((1e-6 * t_us, "nmpc" if asked else "law"))
    return solved


def test_a_solver_that_keeps_failing_is_relieved_by_the_geometric_law_and_tried_ever_less_often(
    ensemble,
):
    """Three tries 0.1 s apart, then the law for 2, 4, 8 and 16 s."""
    plan = solve_of(ensemble, ensemble.estimate(0))
    e = replace(ensemble, stack=replace(ensemble.stack, controller=Failing(plan)))
    forces = forces_of(e)
    solve(forces, e, e.estimate(0))
    solved = fly_on(forces, e, 34.0)
    tries = np.array([0.0] + [t for t, law in solved if law == "nmpc"])
    np.testing.assert_allclose(np.diff(tries)[:2], 0.1, atol=0.01)
    np.testing.assert_allclose(np.diff(tries)[2:], [2.0, 4.0, 8.0, 16.0], atol=0.8)
    assert np.all(np.diff([t for t, _ in solved]) > 0.09)


def test_a_solver_that_recovers_flies_again_and_is_trusted_as_before(ensemble):
    plan = solve_of(ensemble, ensemble.estimate(0))
    controller = Failing(plan, works_from_us=1_000_000)
    e = replace(ensemble, stack=replace(ensemble.stack, controller=controller))
    forces = forces_of(e)
    solve(forces, e, e.estimate(0))
    late = [law for t, law in fly_on(forces, e, 6.0) if t > 3.1]
    assert set(late) == {"nmpc"}
    assert (forces._failures, forces._rounds) == (0, 0)


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


def test_the_first_solve_starts_from_what_is_measured(ensemble):
    forces, estimate = forces_of(ensemble), ensemble.estimate()
    assert forces.due(0, estimate, np.inf) == "start"
    controller = Answer(solve_of(ensemble, estimate))
    forces._stack = replace(ensemble.stack, controller=controller)
    solve(forces, ensemble, estimate)
    (request,) = controller.requests
    np.testing.assert_array_equal(request.load, estimate.team.load)
    pull = -estimate.cables.tension[:, None] * estimate.cables.dir_W
    np.testing.assert_allclose(request.force_W, pull)
    np.testing.assert_array_equal(request.dforce_W, 0.0)


@pytest.mark.parametrize("size", [0.3, 1.0, 2.5])
def test_later_solves_start_on_the_plan_or_where_the_load_left_its_tube(ensemble, size):
    forces, estimate = forces_of(ensemble), ensemble.estimate()
    plan, t_us = solve(forces, ensemble, estimate).plan, 100_000
    planned, error = sample_plan(plan, t_us), np.zeros(12)
    tube = ensemble.stack.mission.trigger.tube
    error[:3] = size * tube.position_m * np.array([0.6, 0.0, 0.8])
    controller = Answer(ensemble.notes.solves[0].solution)
    forces._stack = replace(ensemble.stack, controller=controller)
    off = shifted(estimate, t_us, move_load(planned.load, error))
    solve(forces, ensemble, off, "tube_exit")
    (request,) = controller.requests
    outside = max(0.0, 1.0 - 1.0 / size)
    np.testing.assert_allclose(request.load[:3], planned.load[:3] + outside * error[:3], atol=1e-9)
    pull = planned.force_W + planned.gain @ (outside * error)
    np.testing.assert_allclose(request.force_W, pull, atol=1e-9)
    np.testing.assert_allclose(request.dforce_W, planned.dforce_W)


def test_the_forces_wanted_do_not_jump_when_the_plan_is_moved_after_the_load(ensemble):
    forces, estimate = forces_of(ensemble), ensemble.estimate()
    old, t_us = solve(forces, ensemble, estimate).plan, 100_000
    planned, error = sample_plan(old, t_us), np.zeros(12)
    error[:3] = [0.1, -0.05, 0.08]
    controller = Answer(ensemble.notes.solves[0].solution)
    forces._stack = replace(ensemble.stack, controller=controller)
    solve(forces, ensemble, shifted(estimate, t_us, move_load(planned.load, error)), "tube_exit")
    (request,) = controller.requests
    left = np.empty(12)
    load_error(move_load(planned.load, error), request.load, left)
    before = planned.force_W + planned.gain @ error
    after = request.force_W + planned.gain @ left
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_without_feedback_solves_start_where_the_load_is_and_plans_go_bare(
    make_ensemble, stack, with_mission
):
    e = make_ensemble(with_mission(stack, trigger=PeriodicTrigger()))
    forces, estimate = forces_of(e), e.estimate()
    lawful = solve(forces, e, estimate)
    assert np.abs(lawful.plan.gain).max() > 0.0  # the geometric law is nothing but feedback
    controller = Answer(e.notes.solves[0].solution)
    forces._stack = replace(e.stack, controller=controller)
    load = move_load(estimate.team.load, 0.01 * np.arange(12.0))
    bare = solve(forces, e, shifted(estimate, 50_000, load), "period")
    np.testing.assert_allclose(controller.requests[0].load, load, atol=1e-12)
    np.testing.assert_array_equal(bare.plan.gain, 0.0)


def test_after_a_fault_the_geometric_law_keeps_its_feedback_under_any_trigger(
    make_ensemble, stack, with_mission
):
    e = make_ensemble(with_mission(stack, trigger=PeriodicTrigger()))
    forces, estimate = forces_of(e), e.estimate()
    solution = solve_of(e, estimate)
    forces._stack = replace(e.stack, controller=Answer(solution))
    assert np.abs(solve(forces, e, estimate).plan.gain).max() == 0.0
    forces.fault(2_000)
    law = solve(forces, e, replace(estimate, stamp_us=2_000), "fault")
    assert np.abs(law.plan.gain).max() > 0.0


def test_a_failed_solve_is_noted_and_tried_again_after_the_dwell(ensemble):
    forces, estimate = forces_of(ensemble), ensemble.estimate()
    solve(forces, ensemble, estimate)
    failed = replace(ensemble.notes.solves[0].solution, status=SolveStatus.FAILED)
    forces._stack = replace(ensemble.stack, controller=Answer(failed))
    solve(forces, ensemble, replace(estimate, stamp_us=2_000), "plan_age")
    assert ensemble.notes.triggers[-1].detail == "failed"
    age_us = 2_000 + round(1e6 * ensemble.stack.mission.trigger.dwell_s)
    assert forces.due(age_us - 2_000, estimate, np.inf) is None
    assert forces.due(age_us, estimate, np.inf) == "solver_failure"


def test_a_new_reference_and_a_fault_are_solved_for_once(ensemble):
    forces, estimate = forces_of(ensemble), ensemble.estimate()
    solve(forces, ensemble, estimate)
    assert forces.due(2_000, estimate, np.inf) is None
    for tell, cause in ((forces.new_reference, "new_reference"), (forces.fault, "fault")):
        tell(*[2_000] * (cause == "fault"))
        assert forces.due(4_000, estimate, np.inf) == cause
        solve(forces, ensemble, replace(estimate, stamp_us=4_000), cause)
        assert forces.due(6_000, estimate, np.inf) is None


def test_after_a_fault_the_geometric_law_flies_for_a_while(ensemble):
    forces, estimate = forces_of(ensemble), ensemble.estimate()
    solve(forces, ensemble, estimate)
    controller = Answer(ensemble.notes.solves[0].solution)
    forces._stack = replace(ensemble.stack, controller=controller)
    forces.fault(0)
    recovery_us = round(1e6 * ensemble.stack.mission.recovery_s)
    for t_us in (0, recovery_us - 2_000):
        solve(forces, ensemble, replace(estimate, stamp_us=t_us), "fault", ALL)
    assert controller.requests == []
    solve(forces, ensemble, replace(estimate, stamp_us=recovery_us), "plan_age")
    assert len(controller.requests) == 1


def test_a_new_leader_measures_its_error_against_the_plan_that_it_received(ensemble):
    forces, estimate = forces_of(ensemble), ensemble.estimate()
    old = solve(forces, ensemble, estimate)
    elsewhere = replace(old.plan, stamp_us=200_000, load=old.plan.load + 0.3 * np.eye(13)[0])
    new = replace(old, stamp_us=200_000, plan=elsewhere)
    for message in (new, old, new):
        forces.follow(message)
        planned, error = np.empty(19), np.empty(12)
        after_s = 1e-6 * (300_000 - message.plan.stamp_us)
        sample_motion(plan_arrays(message.plan), after_s, planned)
        load_error(estimate.team.load, planned, error)
        np.testing.assert_allclose(forces._error(300_000, estimate.team.load), error, atol=1e-12)


def test_a_quaternion_and_its_negative_are_the_same_error(ensemble):
    forces, estimate = forces_of(ensemble), ensemble.estimate()
    solve(forces, ensemble, estimate)
    turned = estimate.team.load.copy()
    turned[LOAD_Q] = quat_mul(turned[LOAD_Q], quat_exp(np.array([0.1, 0.0, 0.0])))
    flipped = turned.copy()
    flipped[LOAD_Q] *= -1.0
    np.testing.assert_allclose(forces._error(0, turned), forces._error(0, flipped))


def test_with_measured_latency_the_plan_takes_the_time_it_took(make_ensemble, stack, with_mission):
    e = make_ensemble(with_mission(stack, latency="measured"))
    forces, estimate = forces_of(e), e.estimate()
    solution = replace(solve_of(e, estimate), wall_ms=7.0)
    forces._stack = replace(e.stack, controller=Answer(solution))
    world = static_map(OccupancyGrid(np.zeros((4, 4, 4), bool), np.zeros(3), 0.1), e.stack.shape)
    forces.solve("start", estimate, REST, world, ALL)
    assert forces.due(2_000, estimate, np.inf) is None  # one solve at a time
    assert forces.take(6_998) is None
    assert forces.take(7_000) is not None
    assert forces.take(7_002) is None
