# SPDX-License-Identifier: Apache-2.0
"""Which phase follows which, and when."""

import math
from dataclasses import dataclass, replace

import numpy as np

from skyhaul.comms.messages import Status
from skyhaul.control.api import ForcePlan
from skyhaul.control.failure import Equilibrium
from skyhaul.mission.api import LIFTED_M, Phase
from skyhaul.mission.setup import Stack
from skyhaul.model.formation import hover_forces
from skyhaul.types import Array, Mask, TimeUs

LEVEL_DEG = 1.0
"""A load that tilts less hangs level [deg]."""


@dataclass(frozen=True, eq=False)
class LeaderView:
    """What decides on the phase."""

    phase: Phase
    since_s: float  # in this phase [s]
    statuses: tuple[Status | None, ...]  # of the vehicles that carry; None: not heard yet
    column_blocked: bool  # a mover comes into the lift-off column
    reference_ended: bool
    reaches_goal: bool  # the reference leads to the goal (or the task is no journey)
    lifted_m: float  # height of the load above where it stood [m]
    enough_left: bool  # the vehicles that are left can carry the load
    lifts_level: bool  # and they can lift it from the floor, where it cannot tilt


def next_phase(stack: Stack, view: LeaderView) -> Phase:
    """The phase that follows from what is seen; often the same."""
    heard = [s for s in view.statuses if s is not None]
    complete = len(heard) == len(view.statuses)
    called_off = view.phase in (Phase.ABORT, Phase.DOWN)
    if _on_floor(view) and not (view.enough_left and view.lifts_level):
        return Phase.ABORT
    if not called_off and not view.enough_left:
        return Phase.SAFE
    match view.phase:
        case Phase.FLY_IN:
            ready = complete and all(s.at_station and s.attached for s in heard)
            return Phase.TAUTEN if ready else view.phase
        case Phase.TAUTEN:
            taut = complete and all(s.at_station and s.taut for s in heard)
            return Phase.LIFT if taut and not view.column_blocked else view.phase
        case Phase.LIFT:
            spooled = view.since_s > stack.mission.spool_s
            lifted = spooled and view.lifted_m > stack.mission.clear_of_floor_m
            return Phase.CARRY if lifted else view.phase
        case Phase.CARRY:
            done = view.reference_ended and view.reaches_goal
            return Phase.HOVER if done else view.phase
        case Phase.HOVER:
            return view.phase if view.reference_ended else Phase.CARRY
        case Phase.ABORT:
            parked = all(math.isinf(s.station_in_s) for s in heard)
            return Phase.DOWN if parked else view.phase
        case Phase.SAFE | Phase.DOWN:
            return view.phase


def _on_floor(view: LeaderView) -> bool:
    """Whether the take-off can still be called off."""
    pulled = view.phase is Phase.LIFT and view.lifted_m < LIFTED_M
    return pulled or view.phase in (Phase.FLY_IN, Phase.TAUTEN)


def lifts_level(stack: Stack, rest: Equilibrium) -> bool:
    """Whether the load hangs level in an equilibrium; a point mass always does."""
    level = rest.formation and rest.tilt_deg < LEVEL_DEG
    return rest.survivable and (level or not stack.arrays.rigid)


def spool_plan(stack: Stack, t_us: TimeUs, load: Array, active: Mask) -> ForcePlan:
    """Constant cable forces that bear the load where it stands, open loop: the floor holds it.

    The vehicles pull with a growing share of them, `spool_share`.
    """
    n = stack.team.count
    force = hover_forces(stack.team, active)
    rest = load.copy()
    rest[7:] = 0.0
    e3 = np.array([0.0, 0.0, stack.arrays.g])
    thrust = np.linalg.norm(force + stack.arrays.m_B[:, None] * e3, axis=1)
    return ForcePlan(
        stamp_us=t_us,
        node_s=np.array([0.0, stack.mission.spool_s + 1.0]),
        load=np.tile(rest, (2, 1)),
        accel_W=np.zeros((2, 3)),
        force_W=np.tile(force, (2, 1, 1)),
        dforce_W=np.zeros((2, n, 3)),
        gain=np.zeros((2, n, 3, 12)),
        thrust=np.tile(thrust, (2, 1)),
        active=active,
    )


def spool_share(stack: Stack, since_s: float) -> float:
    """Share of the planned forces to pull with, a time after the lift began."""
    return min(1.0, 0.2 + 0.8 * since_s / stack.mission.spool_s)


def without_feedback(plan: ForcePlan) -> ForcePlan:
    """The same plan, flown open loop."""
    return replace(plan, gain=np.zeros_like(plan.gain))
