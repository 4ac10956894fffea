# SPDX-License-Identifier: Apache-2.0
"""When a flight is over."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_exp
from skyhaul.mission.api import Phase
from skyhaul.mission.judge import FLYING_ON, Judge
from skyhaul.model import PointPayload, Team
from skyhaul.world.scenario import CircleTask, GoTo, Scenario

GOAL = (1.0, 2.0, 3.0)
STEP_US = 10_000


def judge_of(**entries):
    task = GoTo(goal_m=GOAL, within_m=0.2, below_mps=0.1, hold_s=2.0)
    return Judge(Scenario(**{"task": task, "time_limit_s": 60.0} | entries))


@pytest.fixture
def at(make_estimate):
    """Estimate of a team with its load at a place, with a velocity and a tilt."""

    def make(p_WL=GOAL, v_WL=(0.0, 0.0, 0.0), turn_rad=(0.0, 0.0, 0.0), team=None):
        estimate = make_estimate(team or Team(), p_WL=p_WL)
        turned = quat_exp(np.array(turn_rad, dtype=np.float64))
        state = replace(estimate.team, v_WL=np.array(v_WL), q_WL=turned)
        return replace(estimate, team=state)

    return make


def watch(judge, looks, memory=None):
    """Verdicts of a judge who looks every 10 ms."""
    memory = memory or judge.init()
    verdicts = []
    for k, (phase, estimate) in enumerate(looks):
        memory, verdict = judge.step(memory, k * STEP_US, phase, estimate)
        verdicts.append(verdict)
    return verdicts


def test_a_journey_is_done_once_the_goal_was_held_long_enough(at):
    verdicts = watch(judge_of(), [(Phase.HOVER, at())] * 210)
    assert [v.over for v in verdicts] == [False] * 200 + [True] * 10
    assert verdicts[200].success


@pytest.mark.parametrize(
    ("p_WL", "v_WL"),
    [((1.0, 2.0, 3.21), (0.0, 0.0, 0.0)), (GOAL, (0.06, 0.0, 0.09))],
)
def test_away_from_the_goal_or_moving_nothing_is_held(at, p_WL, v_WL):
    verdicts = watch(judge_of(), [(Phase.HOVER, at(p_WL, v_WL))] * 300)
    assert set(verdicts) == {FLYING_ON}


@pytest.mark.parametrize("phase", [Phase.CARRY, Phase.SAFE, Phase.LIFT])
def test_only_a_hover_is_the_end_of_a_task(at, phase):
    assert set(watch(judge_of(), [(phase, at())] * 300)) == {FLYING_ON}


def test_an_interruption_starts_the_hold_anew(at):
    looks = [(Phase.HOVER, at())] * 150 + [(Phase.HOVER, at((0.0, 2.0, 3.0)))]
    verdicts = watch(judge_of(), looks + [(Phase.HOVER, at())] * 210)
    assert [v.over for v in verdicts].index(True) == 151 + 200


def test_a_task_without_a_goal_is_done_after_a_second_of_hover(at):
    verdicts = watch(judge_of(task=CircleTask()), [(Phase.HOVER, at((9.0, 9.0, 3.0)))] * 120)
    assert [v.success for v in verdicts].index(True) == 100


def test_the_time_limit_ends_the_flight_without_success(at):
    judge = judge_of(time_limit_s=1.0)
    verdicts = watch(judge, [(Phase.CARRY, at())] * 101)
    assert not any(v.over for v in verdicts[:100])
    assert verdicts[100].over
    assert not verdicts[100].success
    assert "time limit reached in phase 'carry'" in verdicts[100].reason
    safe = watch(judge, [(Phase.SAFE, at())] * 101)[100]
    assert "safe hover" in safe.reason


def test_a_load_that_flew_and_lies_on_the_floor_was_dropped(at):
    up, down = at((0.0, 0.0, 1.0)), at((0.0, 0.0, 0.045))
    verdicts = watch(judge_of(), [(Phase.CARRY, up), (Phase.CARRY, down)])
    assert [v.over for v in verdicts] == [False, True]
    assert verdicts[1].reason == "the load was dropped"
    assert not verdicts[1].success


def test_a_load_that_waits_on_the_floor_was_not_dropped(at):
    down = at((0.0, 0.0, 0.04))
    for phase in (Phase.TAUTEN, Phase.LIFT, Phase.CARRY):
        assert set(watch(judge_of(), [(phase, down)] * 5)) == {FLYING_ON}


@pytest.mark.parametrize(("tilt_deg", "over"), [(77.0, False), (80.0, True), (170.0, True)])
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, -0.8, 0.0)])
def test_a_load_that_topples_was_dropped(at, axis, tilt_deg, over):
    turned = at((0, 0, 1), turn_rad=np.deg2rad(tilt_deg) * np.array(axis))
    assert watch(judge_of(), [(Phase.CARRY, turned)] * 2)[-1].over == over


@pytest.mark.parametrize("phase", [Phase.LIFT, Phase.CARRY])
def test_lift_off_is_when_the_load_leaves_the_floor_in_any_phase(at, phase):
    risen, low, down = at((0, 0, 0.08)), at((0, 0, 0.065)), at((0, 0, 0.055))
    verdicts = watch(judge_of(), [(phase, low), (phase, risen), (phase, low), (phase, down)])
    assert [v.over for v in verdicts] == [False, False, False, True]
    assert verdicts[-1].reason == "the load was dropped"
    assert set(watch(judge_of(), [(phase, low), (phase, down)])) == {FLYING_ON}


@pytest.mark.parametrize("phase", [Phase.LIFT, Phase.CARRY, Phase.HOVER, Phase.SAFE])
@pytest.mark.parametrize("attached", [True, False])
def test_a_vehicle_that_comes_down_on_its_cable_ends_the_flight(at, phase, attached):
    """One that was let go may lie on the floor."""
    estimate = at((0.0, 0.0, 0.04))
    p_WB = estimate.team.p_WB.copy()
    p_WB[2, 2] = 0.04
    fallen = replace(
        estimate,
        team=replace(estimate.team, p_WB=p_WB),
        attached=np.array([True, True, attached, True]),
    )
    verdict = watch(judge_of(), [(phase, fallen)])[0]
    assert (verdict.over, verdict.success) == (attached, False)
    assert attached == (verdict.reason == "vehicle 2 came down")
    assert set(watch(judge_of(), [(Phase.TAUTEN, fallen)])) == {FLYING_ON}


def test_a_take_off_that_was_called_off_is_over_when_all_stand_and_says_so(at):
    verdicts = watch(judge_of(), [(Phase.ABORT, at((0, 0, 0.04))), (Phase.DOWN, at((0, 0, 0.04)))])
    assert [v.over for v in verdicts] == [False, True]
    assert not verdicts[1].success
    assert "called off" in verdicts[1].reason


def test_a_load_that_turns_about_the_vertical_is_still_upright(at):
    turned = at((0, 0, 1), turn_rad=(0.0, 0.0, 3.0))
    assert set(watch(judge_of(), [(Phase.CARRY, turned)] * 2)) == {FLYING_ON}


def test_a_point_mass_is_as_high_as_its_radius(at):
    team = Team(payload=PointPayload(radius_m=0.3))
    judge = judge_of(team=team)
    looks = [(Phase.CARRY, at((0, 0, 1), team=team)), (Phase.CARRY, at((0, 0, 0.31), team=team))]
    assert watch(judge, looks)[-1].reason == "the load was dropped"
