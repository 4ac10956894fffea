# SPDX-License-Identifier: Apache-2.0
"""Path search and reference in one: the cheapest clear way to the goal, waiting where need be."""

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from skyhaul.mapping.api import WorldMap
from skyhaul.model.envelope import TeamShape
from skyhaul.params import Params
from skyhaul.planning.api import (
    Plan,
    PlanStatus,
    Reference,
    ReferencePlan,
    ReferenceStatus,
)
from skyhaul.planning.astar import AStar
from skyhaul.planning.candidates import Departure, departure
from skyhaul.planning.cost import is_better, reference_cost
from skyhaul.planning.paths import PathSearch
from skyhaul.planning.reference import SplineReference, remaining_time
from skyhaul.planning.verify import verify
from skyhaul.planning.ways import Paths, WayParams, Ways
from skyhaul.types import US_PER_S, Array, TimeUs
from skyhaul.world.scenario import Limits

AT_GOAL_M = 1e-6
"""A reference that ends this near to the goal reaches it [m]."""
NEARER_M = 0.3
"""A new place to wait must be nearer to the goal by this [m]."""
REACTION_S = 0.6
"""From when something comes into view until the load brakes [s]."""


@dataclass(frozen=True, kw_only=True)
class SplinePlanner(Params):
    """A*, shortcuts, rounded corners, speed profile, C6 spline; movers by their tubes."""

    kind: Literal["spline"] = "spline"
    path: PathSearch = field(default_factory=AStar)
    """The path search."""
    dt_s: float = 0.3
    """Knot spacing of the reference [s]; jerk stays near 0.5 (change of acceleration) / dt."""
    dt_emergency_s: tuple[float, ...] = (0.2, 0.12)
    """Knot spacings when the usual one leaves no clear way, tried in order [s]."""
    keep_ratio: float = 0.85
    """A clear reference to the goal is kept unless another costs less by the rest of its time."""
    ways: WayParams = field(default_factory=WayParams)
    """What is tried among movers."""

    def __post_init__(self) -> None:
        if not self.dt_s > 0.0:
            raise ValueError(f"dt_s must be > 0, got {self.dt_s}")
        if not all(0.0 < dt <= self.dt_s for dt in self.dt_emergency_s):
            raise ValueError(f"dt_emergency_s must lie in (0, dt_s], got {self.dt_emergency_s}")
        if not 0.0 < self.keep_ratio <= 1.0:
            raise ValueError(f"keep_ratio must lie in (0, 1], got {self.keep_ratio}")

    def build(self, shape: TeamShape) -> "RoutePlanner":
        """The planner of a team."""
        return RoutePlanner(self, shape)


@dataclass(frozen=True)
class RoutePlanner:
    """Implements `ReferencePlanner`. Pure: same inputs, same plan."""

    params: SplinePlanner
    shape: TeamShape

    def plan(
        self,
        world_map: WorldMap,
        current: Reference,
        t_us: TimeUs,
        p_WG: Array,
        limits: Limits,
    ) -> ReferencePlan:
        """See `ReferencePlanner.plan`.

        Ways are tried in order, and of the first group with a clear one the quickest is taken:
        go; go slower, round the movers, or wait on the way; go near and wait there; stay; step
        aside. First with the usual knots, then with short ones and hard braking. A clear
        reference is kept (`current` itself comes back) unless the new one costs much less or, if
        neither reaches the goal, ends nearer to it.
        """
        p_WG = np.asarray(p_WG, dtype=np.float64)
        limits = capped(limits, world_map)
        kept = self._kept(world_map, current, t_us, p_WG, limits)
        paths = Paths(self.params.path, p_WG)
        results: list[ReferencePlan] = []
        for start in self._departures(world_map, current, t_us, limits):
            safe = kept is not None or any(r.status is ReferenceStatus.OK for r in results)
            if start.hurry and safe and results:
                break
            results.append(Ways(self.params.ways, start, paths).best())
            if results[-1].reaches_goal:
                break
        best = max(results, key=_merit)
        return best if kept is None else self._choose(kept, best, t_us, p_WG)

    def _departures(
        self, world_map: WorldMap, current: Reference, t_us: TimeUs, limits: Limits
    ) -> list[Departure]:
        """The usual knots, those of the current reference if shorter, short ones in a hurry."""
        usual = round(US_PER_S * self.params.dt_s)
        out = [departure(world_map, current, t_us, usual, limits)]
        own = current.dt_us if isinstance(current, SplineReference) else usual
        if own < usual:
            out.append(departure(world_map, current, t_us, own, limits))
        for dt_s in self.params.dt_emergency_s:
            dt_us = min(own, round(US_PER_S * dt_s))
            out.append(departure(world_map, current, t_us, dt_us, limits, hurry=True))
        return [d for d in out if d.sane] or out[-1:]

    def _kept(
        self, world_map: WorldMap, current: Reference, t_us: TimeUs, p_WG: Array, limits: Limits
    ) -> ReferencePlan | None:
        """The current reference, if it is clear."""
        smallest, bad_at, _ = verify(world_map, current, t_us, limits.v_max_mps)
        if bad_at < math.inf:
            return None
        ends = current.sample(np.array([t_us, current.end_us])).p_WD[:, 0]
        return ReferencePlan(
            ReferenceStatus.OK,
            Plan(PlanStatus.FOUND, ends),
            current,
            reaches_goal=_gap(current, p_WG) < AT_GOAL_M,
            min_clearance_m=smallest,
        )

    def _choose(
        self, kept: ReferencePlan, new: ReferencePlan, t_us: TimeUs, p_WG: Array
    ) -> ReferencePlan:
        """The clear plan in force, unless the new one is much quicker or comes nearer."""
        kept = replace(kept, path=new.path)
        if new.reference is None or kept.reference is None:
            return kept
        if kept.reaches_goal:
            better = is_better(
                reference_cost(new.reference, t_us, new.min_clearance_m),
                reference_cost(kept.reference, t_us, kept.min_clearance_m),
                remaining_time(kept.reference, t_us),
                self.params.keep_ratio,
            )
            return new if new.reaches_goal and better else kept
        nearer = _gap(new.reference, p_WG) < _gap(kept.reference, p_WG) - NEARER_M
        return new if new.reaches_goal or nearer else kept


def _merit(r: ReferencePlan) -> tuple[bool, bool, float]:
    """Order of plans: to the goal, clear, far from everything."""
    return r.reaches_goal, r.status is ReferenceStatus.OK, r.min_clearance_m


def _gap(reference: Reference, p_WG: Array) -> float:
    """Distance of the end of a reference to the goal [m]."""
    end = reference.sample(np.array([reference.end_us])).p_WD[0, 0]
    return float(np.linalg.norm(end - p_WG))


def capped(limits: Limits, world_map: WorldMap) -> Limits:
    """Limits whose speed lets the team stop inside the space that it knows.

    Obstacles are known within `known_range_m` of a vehicle, so free space is known at least that
    far minus the team's radius ahead of its surface. The cap solves
    v t_r + v^2 / (2 a_brake) = range - radius; every curve may then brake, at any time, in space
    already seen.
    """
    ahead = max(world_map.known_range_m - world_map.shape.radius_m, 0.05)
    a = limits.a_brake_mps2
    cap = a * (math.sqrt(REACTION_S**2 + 2.0 * ahead / a) - REACTION_S)
    return replace(limits, v_max_mps=min(limits.v_max_mps, cap))
