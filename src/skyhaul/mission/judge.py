# SPDX-License-Identifier: Apache-2.0
"""When a flight is over, by what the team itself knows."""

from dataclasses import dataclass, replace

import numpy as np

from skyhaul.mission.api import LIFTED_M, PULLING, Phase
from skyhaul.perception.api import TeamEstimate
from skyhaul.types import US_PER_S, TimeUs
from skyhaul.world.check import rest_height_m
from skyhaul.world.scenario import GoTo, Scenario

_FALLEN_M = 0.02
_TOPPLED = 0.2  # cosine of the load's tilt

CALLED_OFF = "the take-off was called off: a vehicle was lost before the load left the floor"


@dataclass(frozen=True)
class Verdict:
    """Whether the flight is over, and how it went."""

    over: bool
    success: bool
    reason: str
    timed_out: bool = False


FLYING_ON = Verdict(over=False, success=False, reason="still flying")


@dataclass(frozen=True)
class JudgeMemory:
    """Since when the end of the task has been held."""

    held_since_us: TimeUs | None = None
    flew: bool = False  # the load has left the floor


@dataclass(frozen=True, eq=False)
class Judge:
    """Ends a flight: task done, time over, called off, or something came down."""

    scenario: Scenario

    def init(self) -> JudgeMemory:
        """Memory before take-off."""
        return JudgeMemory()

    def step(
        self, memory: JudgeMemory, t_us: TimeUs, phase: Phase, estimate: TeamEstimate
    ) -> tuple[JudgeMemory, Verdict]:
        """Look at the team once."""
        if phase is Phase.DOWN:
            return memory, Verdict(True, False, CALLED_OFF)
        if phase in PULLING:
            memory = replace(memory, flew=memory.flew or self._height_m(estimate) > LIFTED_M)
            crash = self._crash(memory, estimate)
            if crash is not None:
                return memory, Verdict(True, False, crash)
        done = phase is Phase.HOVER and self._at_end(estimate)
        since = memory.held_since_us if memory.held_since_us is not None else t_us
        memory = replace(memory, held_since_us=since if done else None)
        if done and t_us - since >= self._hold_us():
            return memory, Verdict(True, True, "task done")
        if t_us >= self.scenario.time_limit_s * US_PER_S:
            where = "safe hover" if phase is Phase.SAFE else f"phase '{phase.value}'"
            return memory, Verdict(True, False, f"time limit reached in {where}", timed_out=True)
        return memory, FLYING_ON

    def _crash(self, memory: JudgeMemory, estimate: TeamEstimate) -> str | None:
        """What came down: the load after it flew, or, at any time, a vehicle on its cable."""
        q = estimate.team.q_WL
        upright = 1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2)
        if upright < _TOPPLED or (memory.flew and self._height_m(estimate) < _FALLEN_M):
            return "the load was dropped"
        lowest = self.scenario.team.vehicle.half_height_m + _FALLEN_M
        down = np.flatnonzero(estimate.attached & (estimate.team.p_WB[:, 2] < lowest))
        return f"vehicle {down[0]} came down" if down.size else None

    def _height_m(self, estimate: TeamEstimate) -> float:
        """Height of the load above where it stands on the floor [m]."""
        return float(estimate.team.p_WL[2]) - rest_height_m(self.scenario.team)

    def _at_end(self, estimate: TeamEstimate) -> bool:
        task = self.scenario.task
        if not isinstance(task, GoTo):
            return True
        near = np.linalg.norm(estimate.team.p_WL - np.array(task.goal_m)) < task.within_m
        return bool(near and np.linalg.norm(estimate.team.v_WL) < task.below_mps)

    def _hold_us(self) -> TimeUs:
        task = self.scenario.task
        return round((task.hold_s if isinstance(task, GoTo) else 1.0) * US_PER_S)
