# SPDX-License-Identifier: Apache-2.0
"""Who replans and re-solves, and when (PAPER_NOTES 13 and 14).

Re-planning asks A* for a new reference; re-solving asks the payload controller for new forces
along the reference in force. Both are decided here, by pure functions of what is known.
"""

import math
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np

from skyhaul.mapping.api import MapChange, WorldMap
from skyhaul.params import Params
from skyhaul.planning.api import Reference
from skyhaul.types import ERR_P, ERR_R, ERR_V, US_PER_S, Array, TimeUs

GRID_US: TimeUs = 20_000
"""Looks ahead along the reference begin at multiples of this, and share their places [us]."""
WINDOW_US: TimeUs = US_PER_S
"""Places are sampled for this long at once [us]."""


class SolveView(NamedTuple):
    """What a solve trigger looks at."""

    since_s: float  # since the last solve was tried, whether it succeeded or not [s]
    age_s: float  # since the plan in force was solved [s]
    plan_s: float  # length of the plan in force [s]
    error: Array | None  # (12,) measured load against the planned one, layout of `types.ERR_P`;
    # None: not looked at now
    clearance_m: float  # smallest clearance along the plan, movers at their predicted places [m]
    reference_changed: bool
    fault: bool  # the set of carrying cables changed
    failed: bool  # the last solve failed


@dataclass(frozen=True, kw_only=True)
class Tube(Params):
    """How far the load may be off its plan before the plan is moved after it."""

    position_m: float = 0.06
    """Position [m]."""
    velocity_mps: float = 0.25
    """Velocity [m/s]."""
    angle_deg: float = 10.0
    """Attitude [deg]."""

    def __post_init__(self) -> None:
        for name in ("position_m", "velocity_mps", "angle_deg"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")

    def measure(self, error: Array) -> float:
        """Size of a load error, (12,), in radii of the tube: above 1 it is outside."""
        return max(
            float(np.linalg.norm(error[ERR_P])) / self.position_m,
            float(np.linalg.norm(error[ERR_V])) / self.velocity_mps,
            float(np.linalg.norm(error[ERR_R])) / math.radians(self.angle_deg),
        )


@dataclass(frozen=True, kw_only=True)
class EventTrigger(Params):
    """Re-solve when the load leaves a tube around its plan, or on an event."""

    kind: Literal["event"] = "event"
    tube: Tube = field(default_factory=Tube)
    """The tube."""
    max_age_s: float = 0.75
    """Oldest plan that is flown in the open [s]."""
    near_m: float = 0.5
    """Closer than this to an obstacle ... [m]"""
    max_age_near_s: float = 0.2
    """... this is the oldest plan [s]."""
    dwell_s: float = 0.1
    """Least time between two solves, but for faults and new references [s]."""
    sqp_iterations: int = 3
    """SQP iterations of each solve."""
    feedback: Literal[True] = True
    """Linear feedback along the plan."""

    def __post_init__(self) -> None:
        for name in ("max_age_s", "max_age_near_s"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        for name in ("near_m", "dwell_s"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")
        _check_iterations(self.sqp_iterations)

    def cause(self, view: SolveView) -> str | None:
        """Why to solve now, or None."""
        if view.fault:
            return "fault"
        if view.reference_changed:
            return "new_reference"
        if view.since_s < self.dwell_s:
            return None
        if view.failed:
            return "solver_failure"
        if view.error is not None and self.tube.measure(view.error) > 1.0:
            return "tube_exit"
        limit = self.max_age_near_s if view.clearance_m < self.near_m else self.max_age_s
        return "plan_age" if view.age_s >= min(limit, 0.5 * view.plan_s) else None


@dataclass(frozen=True, kw_only=True)
class PeriodicTrigger(Params):
    """Re-solve at a fixed rate from the measured state: the classical NMPC."""

    kind: Literal["periodic"] = "periodic"
    rate_hz: float = 20.0
    """Solves per second [Hz]."""
    sqp_iterations: int = 1
    """SQP iterations of each solve."""
    feedback: Literal[False] = False
    """Nothing between the solves."""

    def __post_init__(self) -> None:
        if not self.rate_hz > 0.0:
            raise ValueError(f"rate_hz must be > 0, got {self.rate_hz}")
        _check_iterations(self.sqp_iterations)

    def cause(self, view: SolveView) -> str | None:
        """Why to solve now, or None."""
        return _periodic_cause(self.rate_hz, view)


@dataclass(frozen=True, kw_only=True)
class PeriodicFeedbackTrigger(Params):
    """Re-solve at a fixed low rate, with the same feedback as the event trigger between."""

    kind: Literal["periodic-feedback"] = "periodic-feedback"
    tube: Tube = field(default_factory=Tube)
    """The tube."""
    rate_hz: float = 2.0
    """Solves per second [Hz]."""
    sqp_iterations: int = 3
    """SQP iterations of each solve."""
    feedback: Literal[True] = True
    """Linear feedback along the plan."""

    def __post_init__(self) -> None:
        if not self.rate_hz > 0.0:
            raise ValueError(f"rate_hz must be > 0, got {self.rate_hz}")
        _check_iterations(self.sqp_iterations)

    def cause(self, view: SolveView) -> str | None:
        """Why to solve now, or None."""
        return _periodic_cause(self.rate_hz, view)


def _check_iterations(count: int) -> None:
    if count < 1:
        raise ValueError(f"sqp_iterations must be >= 1, got {count}")


SolveTrigger = EventTrigger | PeriodicTrigger | PeriodicFeedbackTrigger


def _periodic_cause(rate_hz: float, view: SolveView) -> str | None:
    if view.fault:
        return "fault"
    return "period" if view.since_s >= 1.0 / rate_hz - 1e-9 else None


@dataclass(frozen=True, kw_only=True)
class ReplanTriggers(Params):
    """When the reference planner is asked again."""

    horizon_s: float = 4.0
    """How far ahead along the reference the clearance is watched [s]."""
    step_s: float = 0.1
    """Spacing of the watched places [s]."""
    margin_m: float = 0.02
    """Fires when the predicted clearance falls below this [m]."""
    dwell_s: float = 0.3
    """Least time between two replans that are not urgent [s]."""
    urgent_s: float = 1.5
    """A loss of clearance nearer than this does not wait for the dwell [s]."""
    retry_s: float = 0.5
    """While waiting for a goal or a corridor: pause between two looks [s]."""
    better_period_s: float = 1.5
    """Pause between two looks for a better path [s]."""
    better_share: float = 0.15
    """A path must save this share of the time left to be taken."""
    tracking_m: float = 0.3
    """A tracking error larger than this restarts the reference at the load [m]."""

    def __post_init__(self) -> None:
        for name in ("horizon_s", "step_s", "retry_s", "better_period_s", "tracking_m"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        for name in ("dwell_s", "urgent_s"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")
        if not 0.0 <= self.better_share < 1.0:
            raise ValueError(f"better_share must lie in [0, 1), got {self.better_share}")


class ReplanView(NamedTuple):
    """What the replan triggers look at."""

    stamp_us: TimeUs
    last_replan_us: TimeUs
    change: MapChange
    clearance_m: float  # smallest clearance ahead along the reference [m]
    blocked_in_s: float  # until it falls below the margin [s]; inf when it never does
    tracking_m: float  # distance of the load from the reference [m]
    waiting: bool  # the reference in force does not lead to the goal


def predicted_clearance(
    world_map: WorldMap, reference: Reference, t_us: TimeUs, params: ReplanTriggers
) -> tuple[float, float]:
    """Smallest clearance ahead along a reference, and the time until it is below the margin.

    Returns:
        Clearance [m] and time [s]; the time is inf when the margin is kept all along.
    """
    ahead_s, ahead_us = _ahead(params.horizon_s, params.step_s)
    times = t_us + ahead_us
    step_us = round(params.step_s * US_PER_S)
    if t_us % GRID_US == 0 and step_us % GRID_US == 0:
        first, stride, count = (t_us % WINDOW_US) // GRID_US, step_us // GRID_US, len(ahead_us)
        known: Any = reference  # hashed by identity: references never change
        window = _places_along(known, t_us - t_us % WINDOW_US, stride * count)
        p_WD = window[first : first + stride * count : stride]
    else:
        p_WD = reference.sample(times).p_WD[:, 0]
    clear = world_map.clearance(p_WD, times)
    low = np.flatnonzero(clear < params.margin_m)
    return float(clear.min()), float(ahead_s[low[0]]) if low.size else np.inf


@lru_cache(maxsize=2)
def _places_along(reference: Reference, start_us: TimeUs, further: int) -> Array:
    """Places of a reference at `GRID_US`: a window from a time on, and so many more, (k, 3) [m].

    The looks of a second see the same places again and again.
    """
    count = WINDOW_US // GRID_US + further
    places: Array = reference.sample(start_us + GRID_US * np.arange(count, dtype=np.float64)).p_WD
    return np.ascontiguousarray(places[:, 0])


@cache
def _ahead(horizon_s: float, step_s: float) -> tuple[Array, Array]:
    """Times of the watched places after now [s] [us]."""
    ahead_s = np.arange(0.0, horizon_s + 1e-9, step_s)
    return ahead_s, np.round(ahead_s * US_PER_S)


def replan_cause(params: ReplanTriggers, view: ReplanView) -> str | None:
    """Why to replan now, or None: the paper's e(t), made definite."""
    since_s = (view.stamp_us - view.last_replan_us) / US_PER_S
    if view.blocked_in_s < params.urgent_s and since_s >= 0.1:
        return "clearance"
    if since_s < params.dwell_s:
        return None
    if view.blocked_in_s < np.inf:
        if view.change.born:
            return "new_obstacle"
        if view.change.strayed:
            return "tube_exit"
        return "map_change" if view.change.static_changed else "clearance"
    if view.tracking_m > params.tracking_m:
        return "tracking_error"
    if view.waiting and since_s >= params.retry_s:
        return "corridor_free"
    return "better_path" if since_s >= params.better_period_s else None
