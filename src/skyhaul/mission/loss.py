# SPDX-License-Identifier: Apache-2.0
"""When a cable carries no longer: the motion of the load, and what a vehicle does meanwhile."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from skyhaul.comms.messages import PlanMessage
from skyhaul.control.failure import Equilibrium, equilibrium_after_loss
from skyhaul.mission.setup import Stack
from skyhaul.model.team import Team
from skyhaul.planning.api import Reference
from skyhaul.planning.heading import fan_out
from skyhaul.planning.reference import Tilted, resting_reference, stop_reference, with_tilt
from skyhaul.types import Array, Mask, TimeUs

TILT_US = 350_000
"""Time to turn the load to another attitude after a vehicle is lost [us]. The plate falls into it
by itself in some 0.3 s: a slower reference first pulls it back, and a faster one pushes it on."""


def reference_after_loss(
    stack: Stack, reference: Reference, t_us: TimeUs, R_WL: Array
) -> Reference:
    """The load turned on its way; a reference of a kind that cannot turn it comes to rest.

    Args:
        stack: The stack.
        reference: In force until now.
        t_us: When the turn begins [us].
        R_WL: Attitude of the equilibrium of the cables that are left, at yaw 0, (3, 3).
    """
    if isinstance(reference, Tilted):
        return with_tilt(reference, t_us, R_WL, TILT_US)
    return with_tilt(stop_reference(reference, t_us, stack.limits), t_us, R_WL, TILT_US)


def hover_message(stack: Stack) -> PlanMessage:
    """What a team that begins in the air hovers by until its leader is heard.

    Every vehicle knows the start. The stamp -1 is older than that of any plan of a leader.
    """
    reference = resting_reference(np.array(stack.start.payload_m), 0.0, 0)
    plan = stack.backup.plan(reference, 0, np.ones(stack.team.count, np.bool_))
    heading = fan_out(reference, stack.team.azimuths_rad, 0, 0.0, stack.heading)
    return PlanMessage(-1, plan, reference, heading)


def makeshift_plan(stack: Stack, message: PlanMessage, t_us: TimeUs, active: Mask) -> PlanMessage:
    """What a follower flies from when it hears of a loss until the leader's plan arrives.

    The backup law along the reference that it has, on the cables that are left: every follower
    comes to about the same forces as the leader. The stamp stays that of the leader's last plan,
    so that its next one replaces this.

    Args:
        stack: The stack.
        message: The leader's last plan.
        t_us: Time now [us].
        active: Cables that carry, (n,); at least one.
    """
    rest = rest_after_loss(stack.team, tuple(bool(a) for a in active))
    reference = message.reference
    if rest.survivable and stack.arrays.rigid:
        reference = reference_after_loss(stack, reference, t_us, rest.R_WL)
    plan = stack.backup.plan(reference, t_us, active)
    return replace(message, plan=plan, reference=reference)


def plan_in_silence(stack: Stack, message: PlanMessage, t_us: TimeUs) -> PlanMessage:
    """What a follower flies from when the leader's plan is over and no other has come.

    The backup law along the reference that it has, with the cables of that plan: all who fell
    silent fly on to the end of that reference together, and rest there.
    """
    plan = stack.backup.plan(message.reference, t_us, message.plan.active)
    return replace(message, plan=plan)


@lru_cache(maxsize=8)
def rest_after_loss(team: Team, active: tuple[bool, ...]) -> Equilibrium:
    """`equilibrium_after_loss`, searched once."""
    return equilibrium_after_loss(team, np.array(active))
