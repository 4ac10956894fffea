# SPDX-License-Identifier: Apache-2.0
"""What a flight tells its recorder, and how it ended."""

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from skyhaul.comms.api import Envelope
from skyhaul.control.api import Solution, VehicleCommand
from skyhaul.mapping.api import WorldMap
from skyhaul.perception.api import TeamEstimate
from skyhaul.planning.api import Reference, ReferencePlan
from skyhaul.plant.api import Truth
from skyhaul.types import Array, TimeUs


class Phase(Enum):
    """What the team is doing."""

    FLY_IN = "fly in"
    """Vehicles fly from their places to the load (paper-metres)."""
    TAUTEN = "tauten"
    """Vehicles rise over the load until every cable is taut, load on the floor."""
    LIFT = "lift"
    """The forces grow to the load's weight and hand over to the payload controller."""
    CARRY = "carry"
    """The load follows its reference."""
    HOVER = "hover"
    """At the goal (or at the end of the task), holding still."""
    SAFE = "safe hover"
    """Something failed for good: the team holds still and waits."""
    ABORT = "called off"
    """A vehicle was lost before the load left the floor: the others fly back to their places."""
    DOWN = "down"
    """They stand there, rotors off; the end."""


PULLING = (Phase.LIFT, Phase.CARRY, Phase.HOVER, Phase.SAFE)
"""Phases in which the vehicles pull at the load."""
LIFTED_M = 0.03
"""The load has left the floor once it is this high above it: lift-off. From then on tracking,
contacts and tensions count [m]."""


@dataclass(frozen=True, eq=False)
class Tick:
    """One step of 2 ms, for the recorder."""

    truth: Truth
    estimate: TeamEstimate
    phase: Phase
    reference: Array  # (13,) reference load state on the reference clock; nan before CARRY
    command: VehicleCommand
    rotor_cmd: Array  # (n, 4) [N]
    planned_force_W: Array  # (n, 3) of the force plan now [N]; nan without a plan
    planned_thrust: Array  # (n,) [N]; nan without a plan
    flat_cable_dir_W: Array  # (n, 3) cable directions of the flat reference; nan before CARRY


@dataclass(frozen=True, eq=False)
class Trigger:
    """Something fired: a replan, a solve or both."""

    stamp_us: TimeUs
    cause: str  # snake_case, the <cause> of `triggers_<cause>`
    detail: str  # one short sentence for people


@dataclass(frozen=True, eq=False)
class Replan:
    """One call of the reference planner."""

    stamp_us: TimeUs
    cause: str
    result: ReferencePlan
    accepted: bool
    wall_ms: float


@dataclass(frozen=True, eq=False)
class Solve:
    """One call of the payload controller."""

    stamp_us: TimeUs
    cause: str
    solution: Solution


@dataclass(frozen=True, eq=False)
class Outcome:
    """How the flight ended."""

    success: bool
    reason: str  # one sentence
    end_us: TimeUs
    cpu_s: dict[str, float]  # by stage
    wall_s: float


class Recorder(Protocol):
    """Takes everything down. Each call is cheap; nothing comes back."""

    def tick(self, tick: Tick) -> None:
        """Every plant step."""
        ...

    def trigger(self, trigger: Trigger) -> None:
        """Something fired."""
        ...

    def replan(self, replan: Replan) -> None:
        """A reference was planned, accepted or not."""
        ...

    def reference(self, stamp_us: TimeUs, reference: Reference) -> None:
        """A reference came into force."""
        ...

    def solve(self, solve: Solve) -> None:
        """A control plan was solved."""
        ...

    def map(self, world_map: WorldMap) -> None:
        """M(t) changed."""
        ...

    def message(self, envelope: Envelope[object]) -> None:
        """A message went over the bus."""
        ...

    def close(self, outcome: Outcome) -> None:
        """The flight is over, or was interrupted; called exactly once."""
        ...
