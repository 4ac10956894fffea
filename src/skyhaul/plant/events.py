# SPDX-License-Identifier: Apache-2.0
"""When the scripted events of a scenario are due."""

import numpy as np

from skyhaul.errors import ConfigError
from skyhaul.types import US_PER_S, Array, TimeUs
from skyhaul.world.scenario import GoTo, Scenario, ScriptedEvent


class EventQueue:
    """Scripted events, each given out once."""

    def __init__(self, scenario: Scenario, p_WS: Array) -> None:
        """Take the events of a scenario whose load starts at S, (3,) [m]."""
        for event in scenario.events:
            if not 0 <= event.vehicle < scenario.team.count:
                raise ConfigError(f"events: there is no vehicle {event.vehicle}")
        self._waiting = list(scenario.events)
        self._p_WS = p_WS.copy()
        self._way: Array | None = None
        if isinstance(scenario.task, GoTo):
            self._way = np.array(scenario.task.goal_m) - p_WS
        elif any(_needs_progress(e) for e in self._waiting):
            raise ConfigError("events: at_progress needs a task with a goal; give at_s")

    def due(self, t_us: TimeUs, p_WL: Array) -> list[ScriptedEvent]:
        """Events that happen now, with the load at p_WL, (3,) [m]; in the order of the file."""
        if not self._waiting:
            return []
        due = [e for e in self._waiting if self._is_due(e, t_us, p_WL)]
        self._waiting = [e for e in self._waiting if e not in due]
        return due

    def _is_due(self, event: ScriptedEvent, t_us: TimeUs, p_WL: Array) -> bool:
        if event.kind == "vehicle-dies" and event.at_s is None:
            return self.progress(p_WL) >= (event.at_progress or 0.0)
        return t_us >= round((event.at_s or 0.0) * US_PER_S)

    def progress(self, p_WL: Array) -> float:
        """Share of the straight way from start to goal that the load has covered."""
        if self._way is None:
            return 0.0
        square = float(self._way @ self._way)
        return float((p_WL - self._p_WS) @ self._way) / square if square > 0.0 else 1.0


def _needs_progress(event: ScriptedEvent) -> bool:
    return event.kind == "vehicle-dies" and event.at_progress is not None
