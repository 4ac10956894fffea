# SPDX-License-Identifier: Apache-2.0
"""Every transition between phases, and no other."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from skyhaul.comms.messages import Status
from skyhaul.mission.api import Phase
from skyhaul.mission.config import RunConfig
from skyhaul.mission.loss import rest_after_loss
from skyhaul.mission.phases import (
    LeaderView,
    lifts_level,
    next_phase,
    spool_plan,
    spool_share,
    without_feedback,
)
from skyhaul.mission.setup import build_stack
from skyhaul.model.formation import hover_forces
from skyhaul.world.load import load_config

READY = Status(
    stamp_us=0,
    vehicle=0,
    p_WB=np.zeros(3),
    v_WB=np.zeros(3),
    tension=0.5,
    taut=True,
    attached=True,
    at_station=True,
    station_in_s=0.0,
    on_way_s=2.5,
    faulty=np.zeros(4, dtype=bool),
    hears=np.ones(4, dtype=bool),
    order_us=0,
    plan_us=0,
)


def view(phase, **changes):
    base = LeaderView(
        phase=phase,
        since_s=9.0,
        statuses=(READY, READY, READY, READY),
        column_blocked=False,
        reference_ended=True,
        reaches_goal=True,
        lifted_m=9.0,
        enough_left=True,
        lifts_level=True,
    )
    return replace(base, **changes)


def one_not(**changes):
    return {"statuses": (READY, replace(READY, **changes), READY, READY)}


ONE_SILENT = {"statuses": (READY, None, READY, READY)}

PARKED = {"statuses": (replace(READY, station_in_s=np.inf),) * 4}

TRANSITIONS = [
    (Phase.FLY_IN, {}, Phase.TAUTEN),
    (Phase.FLY_IN, one_not(at_station=False), Phase.FLY_IN),
    (Phase.FLY_IN, one_not(attached=False), Phase.FLY_IN),
    (Phase.FLY_IN, one_not(taut=False), Phase.TAUTEN),
    (Phase.FLY_IN, ONE_SILENT, Phase.FLY_IN),
    (Phase.TAUTEN, {}, Phase.LIFT),
    (Phase.TAUTEN, one_not(taut=False), Phase.TAUTEN),
    (Phase.TAUTEN, one_not(at_station=False), Phase.TAUTEN),
    (Phase.TAUTEN, ONE_SILENT, Phase.TAUTEN),
    (Phase.TAUTEN, {"column_blocked": True}, Phase.TAUTEN),
    (Phase.LIFT, {}, Phase.CARRY),
    (Phase.LIFT, {"reference_ended": False}, Phase.CARRY),
    (Phase.LIFT, {"lifted_m": 0.001}, Phase.LIFT),
    (Phase.LIFT, {"since_s": 0.1}, Phase.LIFT),
    (Phase.LIFT, {"column_blocked": True}, Phase.CARRY),
    (Phase.CARRY, {}, Phase.HOVER),
    (Phase.CARRY, {"reference_ended": False}, Phase.CARRY),
    (Phase.CARRY, {"reaches_goal": False}, Phase.CARRY),
    (Phase.HOVER, {}, Phase.HOVER),
    (Phase.HOVER, {"reference_ended": False}, Phase.CARRY),
    (Phase.SAFE, {}, Phase.SAFE),
    (Phase.SAFE, {"reference_ended": False}, Phase.SAFE),
    (Phase.FLY_IN, {"lifts_level": False}, Phase.ABORT),
    (Phase.TAUTEN, {"enough_left": False}, Phase.ABORT),
    (Phase.TAUTEN, {"lifts_level": False}, Phase.ABORT),
    (Phase.LIFT, {"lifts_level": False, "lifted_m": 0.01}, Phase.ABORT),
    (Phase.LIFT, {"enough_left": False, "lifted_m": 0.01}, Phase.ABORT),
    (Phase.LIFT, {"lifts_level": False, "lifted_m": 0.05}, Phase.LIFT),
    (Phase.CARRY, {"lifts_level": False, "lifted_m": 0.0}, Phase.HOVER),
    (Phase.ABORT, {}, Phase.ABORT),
    (Phase.ABORT, {"enough_left": False, "lifts_level": False}, Phase.ABORT),
    (Phase.ABORT, PARKED, Phase.DOWN),
    (Phase.ABORT, {"statuses": (None, *PARKED["statuses"][1:])}, Phase.DOWN),
    (Phase.DOWN, {}, Phase.DOWN),
    (Phase.DOWN, {"enough_left": False}, Phase.DOWN),
]


@pytest.mark.parametrize(("phase", "changes", "after"), TRANSITIONS)
def test_transition(stack, phase, changes, after):
    assert next_phase(stack, view(phase, **changes)) is after


@pytest.mark.parametrize("phase", [Phase.LIFT, Phase.CARRY, Phase.HOVER, Phase.SAFE])
@pytest.mark.parametrize("ended", [False, True])
def test_too_few_vehicles_in_the_air_end_in_a_safe_hover(stack, phase, ended):
    lost = view(phase, enough_left=False, reference_ended=ended)
    assert next_phase(stack, lost) is Phase.SAFE


def test_no_view_leads_back_to_the_floor_and_nothing_leaves_the_safe_hover(stack):
    flags = list(product([False, True], repeat=5))
    statuses = [(READY,) * 4, ONE_SILENT["statuses"], ()]
    before = (Phase.LIFT, Phase.CARRY, Phase.HOVER, Phase.SAFE)
    for phase, (a, b, c, d, f), heard in product(before, flags, statuses):
        after = next_phase(
            stack,
            view(
                phase,
                column_blocked=a,
                reference_ended=b,
                reaches_goal=c,
                enough_left=d,
                lifts_level=f,
                statuses=heard,
            ),
        )
        assert after not in (Phase.FLY_IN, Phase.TAUTEN, Phase.ABORT)
        assert (phase, after) == (Phase.SAFE, Phase.SAFE) or phase is not Phase.SAFE


@pytest.mark.parametrize(
    ("count", "lost", "level"),
    [(4, (), True), (4, (1,), False), (6, (1,), True), (6, (1, 2), False)],
)
def test_a_plate_is_lifted_only_where_it_hangs_level(count, lost, level):
    """Four that lose one carry a plate that tilts; six still hang it level."""
    stack = build_stack(load_config(RunConfig, "hover", (f"team={{count: {count}}}",)))
    rest = rest_after_loss(stack.team, tuple(i not in lost for i in range(count)))
    assert lifts_level(stack, rest) == level


def test_the_pull_grows_evenly_from_a_fifth_to_all_of_it(stack):
    spool_s = stack.mission.spool_s
    assert spool_share(stack, 0.0) == pytest.approx(0.2)
    assert spool_share(stack, 0.5 * spool_s) == pytest.approx(0.6)
    assert spool_share(stack, spool_s) == spool_share(stack, 99.0) == pytest.approx(1.0)


@pytest.mark.parametrize("active", [(1, 1, 1, 1), (1, 0, 1, 1)])
def test_the_spool_plan_bears_the_load_where_it_stands(stack, active):
    active = np.array(active, dtype=bool)
    load = np.array([1.0, 2.0, 0.04, 1.0, 0.0, 0.0, 0.0, *np.full(6, 0.1)])
    plan = spool_plan(stack, 5_000, load, active)
    assert plan.stamp_us == 5_000
    assert plan.node_s[-1] > stack.mission.spool_s
    for k in range(2):
        np.testing.assert_array_equal(plan.load[k, :7], load[:7])
        np.testing.assert_array_equal(plan.load[k, 7:], 0.0)
        np.testing.assert_allclose(plan.force_W[k], hover_forces(stack.team, active))
        weight = stack.arrays.m_L * stack.arrays.g
        np.testing.assert_allclose(plan.force_W[k].sum(axis=0), [0.0, 0.0, weight], atol=1e-9)
        lift = plan.force_W[k] + stack.arrays.m_B[:, None] * [0.0, 0.0, stack.arrays.g]
        np.testing.assert_allclose(plan.thrust[k], np.linalg.norm(lift, axis=1))
    np.testing.assert_array_equal(plan.gain, 0.0)


def test_without_feedback_only_the_gains_go(stack):
    load = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, *np.zeros(6)])
    plan = spool_plan(stack, 0, load, np.ones(4, dtype=bool))
    fed_back = replace(plan, gain=np.ones((2, 4, 3, 12)))
    bare = without_feedback(fed_back)
    np.testing.assert_array_equal(bare.gain, 0.0)
    np.testing.assert_array_equal(fed_back.gain, 1.0)
    assert bare.force_W is fed_back.force_W
