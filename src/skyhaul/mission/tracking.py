# SPDX-License-Identifier: Apache-2.0
"""The control tick of all vehicles that live in one process."""

import numpy as np

from skyhaul.comms.messages import PlanMessage
from skyhaul.control.api import VehicleCommand
from skyhaul.control.vehicle import CableTracker, VehicleMemory
from skyhaul.perception.api import TeamEstimate
from skyhaul.types import Array, TimeUs

YAW_PERIOD_US = 20_000
"""The planned headings, which turn slowly, are sampled this often [us]."""
YAW_AHEAD = 25
"""Samples taken at once, since one costs little less than many."""


class SharedTracking:
    """Computes one tick for all agents that fly the same plan at once; each takes its row.

    Agents with the same estimate and plan would each compute the same; in a process of its own an
    agent calls `CableTracker.step_one` instead. Agents that hold different plans, as while a new
    one is on its way, are computed apart, each from its own memory.
    """

    def __init__(self, tracker: CableTracker, n: int) -> None:
        self._tracker, self._memory = tracker, tracker.init(n)
        self._stamp_us: TimeUs | None = None
        self._ticks: dict[tuple[int, float], tuple[VehicleMemory, VehicleCommand]] = {}
        self._plan_of: list[tuple[int, float] | None] = [None] * n
        self._headings: PlanMessage | None = None
        self._yaw_us, self._yaw_W = -YAW_PERIOD_US, np.zeros((1, n))

    def command(
        self, i: int, estimate: TeamEstimate, message: PlanMessage, share: float
    ) -> VehicleCommand:
        """Commands for this estimate and plan, (n) rows, of which agent i takes its own."""
        if estimate.stamp_us != self._stamp_us:
            self._next_tick(estimate.stamp_us)
            self._look_ahead(estimate.stamp_us, message)
        key = self._plan_of[i] = (id(message.plan), share)
        if key not in self._ticks:
            self._ticks[key] = self._tracker.step(
                self._memory, estimate, message.plan, self._yaw(estimate.stamp_us), share
            )
        return self._ticks[key][1]

    def _look_ahead(self, t_us: TimeUs, message: PlanMessage) -> None:
        """Sample the headings, when the samples end or the next one is due from a new plan."""
        since_us = t_us - self._yaw_us
        renewed = message is not self._headings and since_us >= YAW_PERIOD_US
        if renewed or since_us >= YAW_PERIOD_US * len(self._yaw_W):
            times = t_us + YAW_PERIOD_US * np.arange(YAW_AHEAD, dtype=np.float64)
            self._yaw_us, self._headings = t_us, message
            self._yaw_W = np.ascontiguousarray(message.heading.sample(times)[:, :, 0])

    def _yaw(self, t_us: TimeUs) -> Array:
        """Headings wanted now, (n,) [rad]."""
        yaw: Array = self._yaw_W[(t_us - self._yaw_us) // YAW_PERIOD_US]
        return yaw

    def _next_tick(self, t_us: TimeUs) -> None:
        """Keep of each agent the memory of the plan it flew."""
        if self._ticks:
            memories = {key: memory for key, (memory, _) in self._ticks.items()}
            kept = next(iter(memories.values()))
            if len(memories) > 1:
                rows = kept.vehicles.copy()
                for i, key in enumerate(self._plan_of):
                    if key is not None:
                        rows[i] = memories[key].vehicles[i]
                kept = kept._replace(vehicles=rows)
            self._memory = kept
        self._stamp_us, self._ticks = t_us, {}
        self._plan_of = [None] * len(self._plan_of)
