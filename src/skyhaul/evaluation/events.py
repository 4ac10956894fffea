# SPDX-License-Identifier: Apache-2.0
"""What happened in a run, read from its log."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from skyhaul.evaluation.folder import LOG
from skyhaul.evaluation.mcap_log import read_log
from skyhaul.types import US_PER_S, Array


@dataclass(frozen=True)
class TriggerEvent:
    """Something fired."""

    t_s: float
    cause: str
    detail: str


@dataclass(frozen=True)
class ContactEvent:
    """Two bodies began to touch."""

    t_s: float
    body_a: str
    body_b: str
    airborne: bool
    lost: bool
    """One of them belongs to a vehicle that was dead or released."""


@dataclass(frozen=True, eq=False)
class ReplanEvent:
    """One call of the reference planner."""

    t_s: float
    cause: str
    status: str
    path_status: str
    accepted: bool
    reaches_goal: bool
    wait_s: float
    waypoints: Array  # (k, 3) [m]
    wall_ms: float

    @property
    def path_m(self) -> float:
        """Length of the path that was found [m]."""
        return float(np.linalg.norm(np.diff(self.waypoints, axis=0), axis=1).sum())


@dataclass(frozen=True, eq=False)
class ReferenceEvent:
    """A reference came into force."""

    t_s: float
    time_s: Array  # (k,) when the load shall pass the points [s]
    p_WD: Array  # (k, 3) [m]


@dataclass(frozen=True)
class SolveEvent:
    """One call of the payload controller."""

    t_s: float
    cause: str
    status: str
    kkt_residual: float
    iterations: int
    slack_m: float
    wall_ms: float


@dataclass(frozen=True)
class OutcomeEvent:
    """How the flight ended."""

    t_s: float
    success: bool
    reason: str
    wall_s: float
    cpu_s: dict[str, float]


@dataclass(eq=False)
class Events:
    """All events of a run, in order."""

    triggers: list[TriggerEvent] = field(default_factory=list)
    contacts: list[ContactEvent] = field(default_factory=list)
    replans: list[ReplanEvent] = field(default_factory=list)
    references: list[ReferenceEvent] = field(default_factory=list)
    solves: list[SolveEvent] = field(default_factory=list)
    outcome: OutcomeEvent | None = None
    """None: the run was killed."""
    messages: int = 0
    bytes_sent: int = 0


def read_events(folder: Path) -> Events:
    """Read the events of a run folder; a log that breaks off gives what it has.

    Raises:
        FileError: when the log is missing or no MCAP file.
    """
    events = Events()
    for record in read_log(folder / LOG, set(_READERS)):
        _READERS[record.topic](events, record.t_us / US_PER_S, record.message)
    return events


def _trigger(events: Events, t_s: float, m: dict[str, Any]) -> None:
    events.triggers.append(TriggerEvent(t_s, m["cause"], m["detail"]))


def _contact(events: Events, t_s: float, m: dict[str, Any]) -> None:
    bodies = m["body_a"], m["body_b"]
    events.contacts.append(ContactEvent(t_s, *bodies, m["airborne"], m["lost"]))


def _replan(events: Events, t_s: float, m: dict[str, Any]) -> None:
    points = np.array([[p["x"], p["y"], p["z"]] for p in m["waypoints"]]).reshape(-1, 3)
    events.replans.append(
        ReplanEvent(
            t_s,
            m["cause"],
            m["status"],
            m["path_status"],
            m["accepted"],
            m["reaches_goal"],
            m["wait_s"],
            points,
            m["wall_ms"],
        )
    )


def _reference(events: Events, t_s: float, m: dict[str, Any]) -> None:
    time_s, points = [], []
    for pose in m["poses"]:
        at, p = pose["header"]["stamp"], pose["pose"]["position"]
        time_s.append(at["sec"] + 1e-9 * at["nanosec"])
        points.append((p["x"], p["y"], p["z"]))
    events.references.append(ReferenceEvent(t_s, np.array(time_s), np.array(points).reshape(-1, 3)))


def _solve(events: Events, t_s: float, m: dict[str, Any]) -> None:
    keys = ("cause", "status", "kkt_residual", "iterations", "slack_m", "wall_ms")
    events.solves.append(SolveEvent(t_s, *(m[k] for k in keys)))


def _outcome(events: Events, t_s: float, m: dict[str, Any]) -> None:
    cpu_s = dict(zip(m["stages"], m["cpu_s"].tolist(), strict=True))
    events.outcome = OutcomeEvent(t_s, m["success"], m["reason"], m["wall_s"], cpu_s)


def _statistics(events: Events, t_s: float, m: dict[str, Any]) -> None:
    events.messages, events.bytes_sent = m["messages"], m["bytes"]


_READERS: dict[str, Callable[[Events, float, dict[str, Any]], None]] = {
    "/trigger": _trigger,
    "/contact": _contact,
    "/plan/replan": _replan,
    "/plan/reference": _reference,
    "/control/solve": _solve,
    "/mission/outcome": _outcome,
    "/comms/statistics": _statistics,
}
