# SPDX-License-Identifier: Apache-2.0
"""Why a mission does not get on, in the words of its outcome."""

import pytest

from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.mission.hindrance import hindrance
from skyhaul.planning.api import Plan, PlanStatus, ReferencePlan, ReferenceStatus
from skyhaul.world.load import load_config


def planned(status, *, reaches_goal=False):
    return ReferencePlan(ReferenceStatus.OK, Plan(status), None, reaches_goal=reaches_goal)


@pytest.mark.parametrize(
    ("status", "words", "goal"),
    [
        (PlanStatus.RELAXED, "goal blocked", True),
        (PlanStatus.GOAL_BLOCKED, "goal blocked", True),
        (PlanStatus.NO_PATH, "no path to the goal", False),
        (PlanStatus.OUT_OF_BUDGET, "no path to the goal", False),
        (PlanStatus.FOUND, "no clear way along the path to the goal", False),
    ],
)
def test_each_outcome_of_planning_has_its_words(status, words, goal):
    found = hindrance(None, 5_000_000, planned(status))
    assert found.sentence() == f"{words} since 5.0 s"
    by = " by 'squatter'" if goal else ""
    assert found.sentence("squatter") == f"{words}{by} since 5.0 s"


def test_a_cause_that_lasts_keeps_its_beginning_and_ends_with_a_plan_that_arrives():
    first = hindrance(None, 1_000_000, planned(PlanStatus.RELAXED))
    assert hindrance(first, 2_000_000, planned(PlanStatus.GOAL_BLOCKED)) is first
    other = hindrance(first, 3_000_000, planned(PlanStatus.NO_PATH))
    assert other.since_us == 3_000_000
    assert hindrance(other, 4_000_000, planned(PlanStatus.FOUND, reaches_goal=True)) is None


FAR = "{name: far, center_m: [0, 3.5, 1], shape: {kind: sphere, radius_m: 0.1}}"


@pytest.mark.parametrize(("center", "by"), [("[2, 0, 1.5]", True), ("[0, -3.5, 1.5]", False)])
def test_a_flight_whose_goal_is_taken_names_who_took_it(tmp_path, center, by):
    entries = (
        "start={kind: air, payload_m: [0, 0, 1.5]}",
        "task={kind: goto, goal_m: [2, 0, 1.5]}",
        f"world.obstacles=[{FAR}, {{name: squatter, center_m: {center}, shape: {{kind: sphere, "
        "radius_m: 0.2}, appears: {at_s: 0.2}}]",
        "control.payload.kind=geometric",
        "time_limit_s=1.5",
    )
    config = load_config(RunConfig, "hover", entries)
    outcome = fly(config, 0, RunRecorder(tmp_path / "run", config, 0))
    assert outcome.reason.startswith("time limit reached in phase 'carry'")
    _, _, why = outcome.reason.partition(": ")
    assert why.startswith("goal blocked by 'squatter' since 0." if by else "")
    assert bool(why) == by
