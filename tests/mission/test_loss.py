# SPDX-License-Identifier: Apache-2.0
"""What is flown when a cable carries no longer."""

import numpy as np
import pytest

from skyhaul.comms.messages import PlanMessage
from skyhaul.control.force_plan import sample_plan
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.mission.loss import TILT_US, makeshift_plan, reference_after_loss, rest_after_loss
from skyhaul.mission.phases import spool_plan
from skyhaul.model import hover_forces
from skyhaul.planning.heading import fan_out
from skyhaul.planning.reference import resting_reference

T_US = 3_000_000
LEFT = np.array([True, True, False, True])


@pytest.fixture
def message(stack, make_estimate):
    load = make_estimate(stack.team).team.load
    reference = resting_reference(load[:3], 0.0, 0)
    plan = spool_plan(stack, 0, load, np.ones(4, dtype=bool))
    return PlanMessage(7, plan, reference, fan_out(reference, stack.team.azimuths_rad, 0))


def test_the_load_turns_to_the_equilibrium_of_the_cables_that_are_left(stack, message):
    rest = rest_after_loss(stack.team, tuple(LEFT.tolist()))
    turned = reference_after_loss(stack, message.reference, T_US, rest.R_WL)
    times = np.array([T_US, T_US + TILT_US // 2, T_US + TILT_US], dtype=np.float64)
    R_WD = turned.sample(times).R_WD[:, 0]
    tilt_deg = np.degrees(np.arccos(R_WD[:, 2, 2]))
    assert rest.survivable
    np.testing.assert_allclose(tilt_deg, rest.tilt_deg * np.array([0.0, 0.5, 1.0]), atol=0.01)
    np.testing.assert_allclose(turned.sample(times).p_WD, message.reference.sample(times).p_WD)


def test_a_makeshift_plan_ends_in_the_hover_of_the_cables_that_are_left(stack, message):
    plan = makeshift_plan(stack, message, T_US, LEFT).plan
    np.testing.assert_array_equal(plan.active, LEFT)
    np.testing.assert_array_equal(plan.force_W[:, 2], 0.0)
    np.testing.assert_array_equal(plan.gain[:, 2], 0.0)
    end = sample_plan(plan, T_US + 1_000_000)
    force_W, arm_W = end.force_W, stack.arrays.p_LA @ quat_to_R(end.load[3:7]).T
    weight = stack.arrays.m_L * stack.arrays.g
    np.testing.assert_allclose(force_W.sum(axis=0), [0.0, 0.0, weight], atol=1e-6)
    np.testing.assert_allclose(np.cross(arm_W, force_W).sum(axis=0), 0.0, atol=1e-6)
    assert not np.allclose(force_W, hover_forces(stack.team), atol=0.1)


def test_it_counts_as_old_as_the_leader_s_last_plan(stack, message):
    made = makeshift_plan(stack, message, T_US, LEFT)
    assert made.stamp_us == message.stamp_us
    assert made.plan.stamp_us == T_US
    assert made.heading is message.heading
