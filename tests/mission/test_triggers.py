# SPDX-License-Identifier: Apache-2.0
"""Each cause fires exactly under its condition."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.shapes import Sphere
from skyhaul.mapping.api import MapChange, OccupancyGrid
from skyhaul.mapping.mapper import static_map
from skyhaul.mission.triggers import (
    EventTrigger,
    PeriodicFeedbackTrigger,
    PeriodicTrigger,
    ReplanTriggers,
    ReplanView,
    SolveView,
    Tube,
    predicted_clearance,
    replan_cause,
)
from skyhaul.model.envelope import TeamShape
from skyhaul.perception.api import Track
from skyhaul.planning.reference import resting_reference
from skyhaul.planning.tasks import leg_reference
from skyhaul.types import ERR_P, ERR_R, ERR_V, ERR_W
from skyhaul.world.scenario import Limits

CALM = SolveView(
    since_s=0.3,
    age_s=0.3,
    plan_s=2.4,
    error=np.zeros(12),
    clearance_m=np.inf,
    reference_changed=False,
    fault=False,
    failed=False,
)
EVENT = EventTrigger(dwell_s=0.1, max_age_s=0.75, near_m=0.5, max_age_near_s=0.2)


def off(part, size, direction=(0.6, 0.0, 0.8)):
    error = np.zeros(12)
    error[part] = size * np.array(direction)
    return error


@pytest.mark.parametrize("part", [ERR_P, ERR_V, ERR_R])
def test_the_tube_is_a_ball_in_each_of_place_velocity_and_attitude(part):
    tube = Tube(position_m=0.1, velocity_mps=0.2, angle_deg=np.rad2deg(0.3))
    radius = {ERR_P.start: 0.1, ERR_V.start: 0.2, ERR_R.start: 0.3}[part.start]
    for direction in ((1.0, 0.0, 0.0), (0.6, 0.0, -0.8), (0.0, -0.8, 0.6)):
        assert tube.measure(off(part, 2.5 * radius, direction)) == pytest.approx(2.5)


def test_the_tube_takes_the_worst_of_its_parts_and_no_body_rate():
    tube = Tube(position_m=0.1, velocity_mps=0.2, angle_deg=10.0)
    both = off(ERR_P, 0.05) + off(ERR_V, 0.3)
    assert tube.measure(both) == pytest.approx(1.5)
    assert tube.measure(off(ERR_W, 100.0)) == 0.0
    assert tube.measure(3.0 * both) == pytest.approx(4.5)


def test_nothing_fires_on_a_young_plan_that_holds():
    assert EVENT.cause(CALM) is None


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"fault": True}, "fault"),
        ({"reference_changed": True}, "new_reference"),
        ({"failed": True}, "solver_failure"),
        ({"error": off(ERR_P, 1.01 * EVENT.tube.position_m)}, "tube_exit"),
        ({"error": off(ERR_P, 0.99 * EVENT.tube.position_m)}, None),
        ({"age_s": 0.75}, "plan_age"),
        ({"age_s": 0.749}, None),
        ({"age_s": 0.5, "plan_s": 1.0}, "plan_age"),  # half of a short plan is flown
        ({"age_s": 0.499, "plan_s": 1.0}, None),
        ({"clearance_m": 0.49}, "plan_age"),
        ({"clearance_m": 0.51}, None),
        ({"clearance_m": 0.49, "age_s": 0.199}, None),
    ],
)
def test_each_event_solves_under_its_condition_alone(changes, cause):
    assert EVENT.cause(CALM._replace(**changes)) == cause


@pytest.mark.parametrize(
    ("changes", "waits"),
    [
        ({"failed": True}, True),
        ({"error": off(ERR_V, 9.0)}, True),
        ({"fault": True}, False),
        ({"reference_changed": True}, False),
    ],
)
def test_only_faults_and_new_references_do_not_wait_for_the_dwell(changes, waits):
    young = CALM._replace(since_s=0.09, **changes)
    assert (EVENT.cause(young) is None) == waits
    assert EVENT.cause(young._replace(since_s=0.1)) is not None


@pytest.mark.parametrize(
    "trigger", [EVENT, PeriodicTrigger(rate_hz=10), PeriodicFeedbackTrigger(rate_hz=10)]
)
def test_a_solver_that_fails_is_not_asked_at_every_tick(trigger):
    """The plan in force stays, and with it its stamp: only the time of the attempt rises."""
    asked, since_s = [], 9.0
    for k in range(500):
        view = CALM._replace(age_s=5.0 + 2e-3 * k, since_s=since_s, failed=True)
        fires = trigger.cause(view) is not None
        asked.append(fires)
        since_s = 2e-3 if fires else since_s + 2e-3
    assert sum(asked) == 10


@pytest.mark.parametrize(
    "trigger", [PeriodicTrigger(rate_hz=4), PeriodicFeedbackTrigger(rate_hz=4)]
)
def test_a_periodic_trigger_looks_at_the_clock_and_at_faults_only(trigger):
    everything = {"failed": True, "reference_changed": True, "error": off(ERR_P, 9.0)}
    loud = CALM._replace(**everything, clearance_m=-1.0)
    assert trigger.cause(loud._replace(since_s=0.248)) is None
    assert trigger.cause(CALM._replace(since_s=0.25)) == "period"
    assert trigger.cause(CALM._replace(since_s=0.002, fault=True)) == "fault"


def test_the_rate_is_met_on_a_clock_of_two_milliseconds():
    trigger, age, solves = PeriodicTrigger(rate_hz=20.0), 0, 0
    for _ in range(5_000):  # 10 s
        age += 2
        fires = trigger.cause(CALM._replace(since_s=1e-3 * age)) is not None
        solves, age = solves + fires, age * (not fires)
    assert solves == 200


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Tube(angle_deg=0.0), "angle_deg must be > 0, got 0"),
        (lambda: EventTrigger(max_age_s=0.0), "max_age_s must be > 0, got 0"),
        (lambda: PeriodicTrigger(rate_hz=0.0), "rate_hz must be > 0, got 0"),
        (lambda: PeriodicFeedbackTrigger(rate_hz=-1.0), "rate_hz must be > 0, got -1"),
        (lambda: ReplanTriggers(retry_s=0.0), "retry_s must be > 0, got 0"),
        (lambda: ReplanTriggers(better_share=1.0), r"better_share must lie in \[0, 1\), got 1"),
    ],
)
def test_parameters_out_of_range_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


NOTHING = MapChange(0, np.full(3, np.inf), np.full(3, -np.inf), (), (), ())
SOMETHING = {
    "born": replace(NOTHING, born=(1,)),
    "strayed": replace(NOTHING, strayed=(1,)),
    "voxels": replace(NOTHING, changed_min=np.zeros(3), changed_max=np.ones(3)),
    "died": replace(NOTHING, died=(1,)),
}
RULES = ReplanTriggers(dwell_s=0.3, urgent_s=1.5, retry_s=0.5, better_period_s=1.5, tracking_m=0.3)
QUIET = ReplanView(
    stamp_us=10_000_000,
    last_replan_us=9_000_000,
    change=NOTHING,
    clearance_m=1.0,
    blocked_in_s=np.inf,
    tracking_m=0.05,
    waiting=False,
)


def since(view, seconds):
    return view._replace(last_replan_us=view.stamp_us - round(1e6 * seconds))


def test_a_clear_way_that_is_tracked_is_left_alone():
    assert replan_cause(RULES, QUIET) is None


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ("born", "new_obstacle"),
        ("strayed", "tube_exit"),
        ("voxels", "map_change"),
        ("died", "clearance"),
    ],
)
def test_a_change_counts_only_when_it_comes_into_the_way(change, cause):
    view = QUIET._replace(change=SOMETHING[change])
    assert replan_cause(RULES, view) is None
    assert replan_cause(RULES, view._replace(blocked_in_s=3.0)) == cause


def test_a_known_mover_that_comes_into_the_way_triggers_too():
    assert replan_cause(RULES, QUIET._replace(blocked_in_s=3.0)) == "clearance"


def test_a_loss_of_clearance_near_by_does_not_wait_for_the_dwell_but_is_not_asked_every_tick():
    near, far = QUIET._replace(blocked_in_s=1.4), QUIET._replace(blocked_in_s=1.6)
    assert replan_cause(RULES, since(near, 0.1)) == "clearance"
    assert replan_cause(RULES, since(near, 0.098)) is None
    assert replan_cause(RULES, since(far, 0.298)) is None
    assert replan_cause(RULES, since(far, 0.3)) == "clearance"


@pytest.mark.parametrize(
    ("changes", "seconds", "cause"),
    [
        ({"tracking_m": 0.31}, 0.3, "tracking_error"),
        ({"tracking_m": 0.31}, 0.29, None),
        ({"tracking_m": 0.29}, 0.3, None),
        ({"waiting": True}, 0.5, "corridor_free"),
        ({"waiting": True}, 0.49, None),
        ({"waiting": True, "tracking_m": 0.31}, 0.5, "tracking_error"),
        ({}, 1.5, "better_path"),
        ({}, 1.49, None),
    ],
)
def test_other_causes_and_their_pauses(changes, seconds, cause):
    assert replan_cause(RULES, since(QUIET._replace(**changes), seconds)) == cause


SHAPE = TeamShape(radius_m=0.3, above_m=0.4, below_m=0.1)
EMPTY = static_map(OccupancyGrid(np.zeros((80, 40, 40), bool), np.full(3, 0.05), 0.1), SHAPE)
WALLED = np.zeros((80, 40, 40), bool)
WALLED[50] = True  # x in 5.0 .. 5.1 m


def straight():
    """From x = 1 to 7 m at y = z = 2 m, off at 0."""
    path = np.array([[1.0, 2.0, 2.0], [7.0, 2.0, 2.0]])
    return leg_reference(path, 0.0, 0, Limits())


def test_clearance_ahead_is_the_least_along_the_reference_and_tells_when():
    world = static_map(replace(EMPTY.grid, occupied=WALLED), SHAPE)
    rules = ReplanTriggers(horizon_s=8.0, step_s=0.01, margin_m=0.05)
    clearance, blocked_in_s = predicted_clearance(world, straight(), 0, rules)
    assert clearance < 0.0
    there = straight().sample(np.array([blocked_in_s * 1e6])).p_WD[0, 0, 0]
    gap = 5.0 - there - SHAPE.radius_m - 0.5 * np.sqrt(3.0) * 0.1  # lowered by half a diagonal
    assert gap == pytest.approx(rules.margin_m, abs=0.06)
    late = predicted_clearance(world, straight(), 1_000_000, rules)
    assert late[1] == pytest.approx(blocked_in_s - 1.0, abs=0.02)


@pytest.mark.parametrize("t_us", [0, 20_000, 980_000, 1_000_000, 3_140_000, 3_141_000])
def test_shared_places_are_those_of_the_reference_itself(t_us):
    rules = ReplanTriggers(horizon_s=4.0)
    times = t_us + np.round(np.arange(0.0, 4.0 + 1e-9, rules.step_s) * 1e6)
    for reference in (straight(), resting_reference(np.array([4.9, 2.0, 2.0]), 0.0, 0)):
        world = static_map(replace(EMPTY.grid, occupied=WALLED), SHAPE)
        clear = world.clearance(reference.sample(times).p_WD[:, 0], times)
        assert predicted_clearance(world, reference, t_us, rules)[0] == clear.min()


def test_the_look_ahead_ends_at_its_horizon():
    world = static_map(replace(EMPTY.grid, occupied=WALLED), SHAPE)
    near = ReplanTriggers(horizon_s=1.0)
    ahead = predicted_clearance(world, straight(), 0, near)
    assert ahead == predicted_clearance(EMPTY, straight(), 0, near)
    assert ahead[1] == np.inf


def test_a_mover_blocks_when_it_will_be_there_not_where_it_is():
    rules = ReplanTriggers(horizon_s=5.0)
    here = resting_reference(np.array([4.0, 2.0, 2.0]), 0.0, 0)

    def blocked_in(p_WO, v_WO):
        track = Track(
            0, 0, Sphere(radius_m=0.2), np.array(p_WO), np.eye(3), np.array(v_WO),
            np.zeros((6, 6)), 0.0, 0.0,
        )  # fmt: skip
        world = replace(EMPTY, tracks=(track,), tube_horizon_s=5.0)
        return predicted_clearance(world, here, 0, rules)[1]

    assert blocked_in([7.0, 2.0, 2.0], [1.0, 0.0, 0.0]) == np.inf
    reaches = 3.0 - SHAPE.radius_m - 0.2 - rules.margin_m
    assert blocked_in([7.0, 2.0, 2.0], [-1.0, 0.0, 0.0]) == pytest.approx(reaches, abs=0.11)
