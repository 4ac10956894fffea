# SPDX-License-Identifier: Apache-2.0
"""Ticks computed for all at once are those that each agent would compute alone."""

import numpy as np
import pytest

from skyhaul.comms.messages import PlanMessage
from skyhaul.control.api import ControlRequest
from skyhaul.mission.tracking import YAW_PERIOD_US, SharedTracking
from skyhaul.planning.heading import fan_out
from skyhaul.planning.reference import resting_reference

N, STEP_US = 4, 2_000


def moving(make_estimate, stack, k):
    """Estimate at tick k of a load that drifts a little."""
    p_WL = (1e-3 * k, 2e-3 * np.sin(0.3 * k), 1.5)
    return make_estimate(stack.team, STEP_US * k, p_WL=p_WL)


@pytest.fixture
def message_to(stack, make_estimate):
    """A plan message towards a place: `message_to(p_WG)`."""

    def make(p_WG):
        reference = resting_reference(np.array(p_WG), 0.0, 0)
        estimate = make_estimate(stack.team)
        pull = -estimate.cables.tension[:, None] * estimate.cables.dir_W
        request = ControlRequest(
            stamp_us=0,
            load=estimate.team.load,
            force_W=pull,
            dforce_W=np.zeros((N, 3)),
            active=np.ones(N, dtype=bool),
            reference=reference,
            world_map=None,
        )
        _, solution = stack.controller.solve(stack.controller.init(), request)
        return PlanMessage(
            0, solution.plan, reference, fan_out(reference, np.arange(N) * 2 * np.pi / N, 0)
        )

    return make


def same(command, alone, i, atol=0.0):
    for name in ("rotor_cmd", "force_W", "moment_B", "thrust"):
        a, b = getattr(command, name), getattr(alone, name)
        np.testing.assert_allclose(a[i], b[i], rtol=0.0, atol=atol)


def test_one_tick_for_all_is_the_tracker_s_step(stack, make_estimate, message_to):
    tracker, message = stack.vehicle_control, message_to((0.3, 0.1, 1.6))
    shared, memory = SharedTracking(tracker, N), tracker.init(N)
    yaw = message.heading.sample(np.zeros(1))[0, :, 0]
    for k in range(YAW_PERIOD_US // STEP_US):
        estimate = moving(make_estimate, stack, k)
        memory, alone = tracker.step(memory, estimate, message.plan, yaw)
        for i in range(N):
            same(shared.command(i, estimate, message, 1.0), alone, i)


@pytest.mark.parametrize("late", [(0, 1, 1, 1), (0, 5, 5, 5), (2, 0, 3, 7)])
def test_agents_whose_plans_differ_for_a_while_fly_as_if_alone(
    stack, make_estimate, message_to, late
):
    tracker, old, new = stack.vehicle_control, message_to((0, 0, 1.5)), message_to((0.3, 0.1, 1.6))
    shared, memories = SharedTracking(tracker, N), [tracker.init(N) for _ in range(N)]
    for k in range(25):
        estimate = moving(make_estimate, stack, k)
        for i in range(N):
            message = new if k >= 10 + late[i] else old
            yaw = message.heading.sample(np.zeros(1))[0, :, 0]  # both rest
            memories[i], alone = tracker.step_one(memories[i], estimate, message.plan, yaw, i)
            same(shared.command(i, estimate, message, 1.0), alone, i)


def test_agents_may_pull_with_different_shares_but_observe_one_load(
    stack, make_estimate, message_to
):
    tracker, message = stack.vehicle_control, message_to((0.0, 0.0, 1.5))
    shared, memories = SharedTracking(tracker, N), [tracker.init(N) for _ in range(N)]
    yaw = message.heading.sample(np.zeros(1))[0, :, 0]
    for k in range(8):
        estimate = moving(make_estimate, stack, k)
        for i in range(N):
            share = 1.0 - 0.1 * (i % 2) * (k == 4)
            memories[i], alone = tracker.step_one(
                memories[i], estimate, message.plan, yaw, i, share
            )
            same(shared.command(i, estimate, message, share), alone, i, atol=5e-4)
