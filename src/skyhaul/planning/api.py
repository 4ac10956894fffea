# SPDX-License-Identifier: Apache-2.0
"""What every path planner and every reference generator takes and returns."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

import numpy as np

from skyhaul.mapping.api import WorldMap
from skyhaul.types import Array, IntArray, TimeUs, frozen
from skyhaul.world.scenario import Limits

Times = Array | IntArray
"""Times (k,) [us]."""


class PlanStatus(Enum):
    """Outcome of a search. FOUND and RELAXED carry waypoints."""

    FOUND = "found"
    RELAXED = "relaxed"
    """Found, but to the free voxel nearest to a blocked goal."""
    NO_PATH = "no path"
    START_BLOCKED = "start blocked"
    GOAL_BLOCKED = "goal blocked"
    OUT_OF_BUDGET = "out of budget"


@dataclass(frozen=True, eq=False)
class Plan:
    """Waypoints of the load from start to goal."""

    status: PlanStatus
    p_WP: Array = field(default_factory=lambda: np.empty((0, 3)))  # (n, 3) [m]
    n_expanded: int = 0

    @property
    def length_m(self) -> float:
        """Length of the path [m]."""
        return float(np.linalg.norm(np.diff(self.p_WP, axis=0), axis=1).sum())


class PathPlanner(Protocol):
    """Finds a collision-free path. Pure: same inputs, same plan."""

    def plan(
        self,
        world_map: WorldMap,
        p_WS: Array,
        p_WG: Array,
        speed_mps: float,
        start_us: TimeUs | None = None,
    ) -> Plan:
        """Plan from start S to goal G, both (3,) [m]. Never raises on an unsolvable map.

        `speed_mps` tells when the load will pass a voxel, for the tubes of the tracks; it leaves
        S at `start_us`, by default the map's stamp.
        """
        ...


@dataclass(frozen=True, eq=False)
class RefSample:
    """Reference motion of the load D at some times (k): derivatives 0..6 of pose."""

    p_WD: Array  # (k, 7, 3) [m, m/s, ...]
    R_WD: Array  # (k, 7, 3, 3) derivatives of the rotation matrix

    def __post_init__(self) -> None:
        frozen(self.p_WD, self.R_WD)


class Reference(Protocol):
    """Desired motion of the load over time; at rest before its start and after its end."""

    @property
    def start_us(self) -> TimeUs:
        """When it begins."""
        ...

    @property
    def end_us(self) -> TimeUs:
        """When it ends, at rest."""
        ...

    def sample(self, t_us: Times) -> RefSample:
        """Derivatives 0..6 at times (k,) [us]; any time is allowed."""
        ...


class Headings(Protocol):
    """Desired yaw of every vehicle over time."""

    def sample(self, t_us: Array) -> Array:
        """Yaw and its first two derivatives at times (k,) [us], (k, n, 3) [rad, rad/s, ..]."""
        ...


class ReferenceStatus(Enum):
    """Outcome of making a reference from a path. Only OK is clear and within the limits."""

    OK = "ok"
    NO_PATH = "no path"
    BLOCKED = "blocked"
    """No clear curve along the path was found."""


@dataclass(frozen=True, eq=False)
class ReferencePlan:
    """A reference and how it came about."""

    status: ReferenceStatus
    path: Plan
    reference: Reference | None  # None unless status is OK
    waits_us: TimeUs = 0  # time it rests for movers to pass
    reaches_goal: bool = False  # ends at the goal itself, not at a place to wait
    min_clearance_m: float = float("nan")  # smallest clearance along the reference
    best_effort: Reference | None = None  # unless OK: the least bad curve that was tried


class ReferencePlanner(Protocol):
    """Path search and reference in one: from M(t) and what is flown now to a new reference."""

    def plan(
        self,
        world_map: WorldMap,
        current: Reference,
        t_us: TimeUs,
        p_WG: Array,
        limits: Limits,
    ) -> ReferencePlan:
        """A reference that continues `current` at `t_us` (derivatives 0..4 at least) to G, (3,).

        Clear of `world_map` all along, within `limits`, and ending at rest in known-free space.
        """
        ...
