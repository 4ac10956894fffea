# SPDX-License-Identifier: Apache-2.0
"""When a flight is over, by what the team itself knows."""

from dataclasses import dataclass, replace

import numpy as np

from skyhaul.mission.api import AIRBORNE, Phase
from skyhaul.perception.api import TeamEstimate
from skyhaul.types import US_PER_S, TimeUs
from skyhaul.world.scenario import GoTo, Scenario

_FALLEN_M = 0.02
_TOPPLED = 0.2  # cosine of the load's tilt


@dataclass(frozen=True)
class Verdict:
    """Whether the flight is over, and how it went."""

    over: bool
    success: bool
    reason: str


FLYING_ON = Verdict(over=False, success=False, reason="still flying")


@dataclass(frozen=True)
class JudgeMemory:
    """Since when the end of the task has been held."""

    held_since_us: TimeUs | None = None
    flew: bool = False  # the load has been well above the floor


@dataclass(frozen=True, eq=False)
class Judge:
    """Ends a flight: task done, time over, or load dropped."""

    scenario: Scenario

    def init(self) -> JudgeMemory:
        """Memory before take-off."""
        return JudgeMemory()

    def step(
        self, memory: JudgeMemory, t_us: TimeUs, phase: Phase, estimate: TeamEstimate
    ) -> tuple[JudgeMemory, Verdict]:
        """Look at the team once."""
        height = float(estimate.team.p_WL[2])
        memory = replace(memory, flew=memory.flew or (phase in AIRBORNE and height > 0.2))
        if memory.flew and self._dropped(estimate):
            return memory, Verdict(True, False, "the load was dropped")
        done = phase is Phase.HOVER and self._at_end(estimate)
        since = memory.held_since_us if memory.held_since_us is not None else t_us
        memory = replace(memory, held_since_us=since if done else None)
        if done and t_us - since >= self._hold_us():
            return memory, Verdict(True, True, "task done")
        if t_us >= self.scenario.time_limit_s * US_PER_S:
            where = "safe hover" if phase is Phase.SAFE else f"phase '{phase.value}'"
            return memory, Verdict(True, False, f"time limit reached in {where}")
        return memory, FLYING_ON

    def _dropped(self, estimate: TeamEstimate) -> bool:
        q = estimate.team.q_WL
        upright = 1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2)
        payload = self.scenario.team.payload
        half = 0.5 * payload.size_m[2] if payload.kind == "rigid" else payload.radius_m
        return bool(estimate.team.p_WL[2] < half + _FALLEN_M or upright < _TOPPLED)

    def _at_end(self, estimate: TeamEstimate) -> bool:
        task = self.scenario.task
        if not isinstance(task, GoTo):
            return True
        near = np.linalg.norm(estimate.team.p_WL - np.array(task.goal_m)) < task.within_m
        return bool(near and np.linalg.norm(estimate.team.v_WL) < task.below_mps)

    def _hold_us(self) -> TimeUs:
        task = self.scenario.task
        return round((task.hold_s if isinstance(task, GoTo) else 1.0) * US_PER_S)
