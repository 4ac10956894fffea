# SPDX-License-Identifier: Apache-2.0
"""What every solve trigger must do. A new one adds one entry to TRIGGERS."""

import re

import numpy as np
import pytest

from skyhaul.mission.triggers import (
    EventTrigger,
    PeriodicFeedbackTrigger,
    PeriodicTrigger,
    SolveView,
)

TRIGGERS = [EventTrigger(), PeriodicTrigger(), PeriodicFeedbackTrigger()]

every_trigger = pytest.mark.parametrize("trigger", TRIGGERS, ids=lambda t: t.kind)


def views(seed, count=400):
    """Views of all sorts."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield SolveView(
            since_s=rng.choice([0.0, 0.01, 0.06, 0.3, 1.0, 5.0]),
            age_s=rng.choice([0.0, 0.01, 0.06, 0.3, 1.0, 5.0]),
            plan_s=rng.choice([0.5, 2.4]),
            error=rng.choice([0.0, 0.02, 1.0]) * rng.normal(size=12),
            clearance_m=rng.choice([-0.1, 0.2, 3.0, np.inf]),
            reference_changed=bool(rng.random() < 0.3),
            fault=bool(rng.random() < 0.2),
            failed=bool(rng.random() < 0.3),
        )


@every_trigger
def test_a_fault_solves_at_once(trigger):
    for view in views(0):
        assert trigger.cause(view._replace(fault=True)) == "fault"


@every_trigger
def test_a_plan_is_replaced_before_it_ends(trigger):
    for view in views(1):
        assert trigger.cause(view._replace(age_s=view.plan_s, since_s=view.plan_s)) is not None


@every_trigger
def test_a_fresh_plan_on_its_way_is_left_alone(trigger):
    calm = SolveView(0.0, 0.0, 2.4, np.zeros(12), np.inf, False, False, False)
    assert trigger.cause(calm) is None


@every_trigger
def test_causes_are_names_of_metrics_and_the_same_view_gives_the_same_cause(trigger):
    for view in views(2):
        cause = trigger.cause(view)
        assert cause is None or re.fullmatch(r"[a-z_]+", cause)
        assert trigger.cause(view) == cause


@every_trigger
def test_an_older_plan_is_never_less_of_a_reason(trigger):
    for view in views(3):
        older = view._replace(age_s=view.age_s + 0.5)
        assert trigger.cause(view) is None or trigger.cause(older) is not None


@every_trigger
def test_it_says_how_to_solve_and_whether_to_feed_back(trigger):
    assert trigger.sqp_iterations >= 1
    assert trigger.feedback in (True, False)


@pytest.mark.parametrize("trigger", [t for t in TRIGGERS if t.feedback], ids=lambda t: t.kind)
def test_with_feedback_there_is_a_tube_that_is_empty_on_the_plan(trigger):
    assert trigger.tube.measure(np.zeros(12)) == 0.0
    assert trigger.tube.measure(np.full(12, 10.0)) > 1.0
