# SPDX-License-Identifier: Apache-2.0
"""Path search and reference in one: the cheapest clear way to the goal, waiting where need be."""

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from skyhaul.mapping.api import WorldMap
from skyhaul.mapping.clearance import clearances
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
from skyhaul.planning.candidates import (
    ACCEL_SHARE,
    HARD_SHARE,
    MOVING_MPS,
    Candidate,
    Departure,
    departure,
    drive_at,
    lead_in,
    make,
    smooth,
)
from skyhaul.planning.reference import SplineReference, remaining_time
from skyhaul.planning.verify import verify
from skyhaul.types import US_PER_S, Array, TimeUs
from skyhaul.world.scenario import Limits

AT_GOAL_M = 1e-6
"""A reference that ends this near to the goal reaches it [m]."""
MOVING_BUDGET = 30_000
"""Voxels to expand in the search round movers."""
NEARER_M = 0.3
"""A new place to wait must be nearer to the goal by this [m]."""
METRE_S, ROOMY_M, TIGHT_S = 0.7, 0.25, 3.0
"""Cost of a metre of way [s]; clearance below which a way costs more [m], up to so much [s]."""
REACTION_S = 0.6
"""From when something comes into view until the load brakes [s]."""


@dataclass(frozen=True, kw_only=True)
class SplinePlanner(Params):
    """A*, shortcuts, rounded corners, speed profile, C6 spline; movers by their tubes."""

    kind: Literal["spline"] = "spline"
    astar: AStar = field(default_factory=AStar)
    """The path search."""
    dt_s: float = 0.3
    """Knot spacing of the reference [s]; jerk stays near 0.5 (change of acceleration) / dt."""
    dt_emergency_s: tuple[float, ...] = (0.2, 0.12)
    """Knot spacings when the usual one leaves no clear way, tried in order [s]."""
    corner_m: float = 1.5
    """Rounding of a corner takes at most this much of its legs [m]."""
    keep_ratio: float = 0.85
    """A clear reference to the goal is kept unless another takes less than this share of it."""
    waits_s: tuple[float, ...] = (0.5, 1.0, 2.0, 3.0, 4.0)
    """Times to wait for movers that are tried [s]."""
    back_off_m: tuple[float, ...] = (0.3, 0.8, 1.6, 3.0)
    """Distances before a blocked place at which waiting is tried [m]."""
    paces: tuple[float, ...] = (0.75, 0.5, 0.3)
    """Slower paces that are tried."""

    def __post_init__(self) -> None:
        for name in ("dt_s", "corner_m"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
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
        reference is kept (`current` itself comes back) unless the new one is much quicker or, if
        neither reaches the goal, ends nearer to it.
        """
        p_WG = np.asarray(p_WG, dtype=np.float64)
        limits = capped(limits, world_map)
        kept = self._kept(world_map, current, t_us, p_WG, limits)
        paths = _Paths(self.params, p_WG)
        results: list[ReferencePlan] = []
        for start in self._departures(world_map, current, t_us, limits):
            safe = kept is not None or any(r.status is ReferenceStatus.OK for r in results)
            if start.hurry and safe and results:
                break
            results.append(_Tries(self.params, start, paths).best())
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
            quicker = is_better(new.reference, kept.reference, t_us, self.params.keep_ratio)
            return new if new.reaches_goal and quicker else kept
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


def is_better(new: Reference, current: Reference, t_us: TimeUs, ratio: float) -> bool:
    """Whether a reference takes less than a share of the time that the current one still takes."""
    return remaining_time(new, t_us) < ratio * remaining_time(current, t_us)


def _cost(c: Candidate) -> float:
    """What a way costs: its time, its length, and little clearance [s]."""
    tight = max(0.0, 1.0 - c.smallest_m / ROOMY_M)
    return c.end_us / US_PER_S + METRE_S * float(c.run.way[-1]) + TIGHT_S * tight


@dataclass(eq=False)
class _Paths:
    """Paths to the goal, searched once for all departures; they begin near the first of them."""

    params: SplinePlanner
    p_WG: Array
    _still: Plan | None = None
    _moving: Plan | None = None

    def still(self, start: Departure) -> Plan:
        """Among what stands."""
        if self._still is None:
            world_map = replace(start.world_map, tracks=())
            self._still = self._search(world_map, start, self.params.astar)
        return self._still

    def moving(self, start: Departure) -> Plan:
        """Round the tubes of the movers too; with less effort, as waiting may do as well."""
        if self._moving is None:
            astar = self.params.astar
            astar = replace(astar, max_expanded=min(astar.max_expanded, MOVING_BUDGET))
            self._moving = self._search(start.world_map, start, astar)
        return self._moving

    def _search(self, world_map: WorldMap, s: Departure, astar: AStar) -> Plan:
        """A path from half the way to a stop on to the goal."""
        speed = self._typical_speed(s)
        start_us = s.t_us + round(US_PER_S * s.after_s)
        if s.speed_mps < MOVING_MPS:
            return astar.plan(world_map, s.p_WS, self.p_WG, speed, start_us)
        ahead = s.p_WS + (0.5 * s.stop_m + 0.1) * s.v_WS / s.speed_mps
        plan = astar.plan(world_map, ahead, self.p_WG, speed, start_us)
        if plan.status is PlanStatus.START_BLOCKED:
            plan = astar.plan(world_map, s.p_WS, self.p_WG, speed, start_us)
        return plan

    def _typical_speed(self, s: Departure) -> float:
        """Mean speed of the way to the goal, roughly [m/s]."""
        far = float(np.linalg.norm(self.p_WG - s.p_WS))
        v, a = s.limits.v_max_mps, ACCEL_SHARE * s.limits.a_max_mps2
        return far / (far / v + v / a) if far > v * v / a else 0.5 * math.sqrt(far * a) + 1e-3


@dataclass(eq=False)
class _Tries:
    """The ways out of one departure, and what was found on the way."""

    params: SplinePlanner
    start: Departure
    paths: _Paths
    path: Plan = field(default_factory=lambda: Plan(PlanStatus.NO_PATH))
    closest: Candidate | None = None  # of all curves the one with the largest clearance

    def best(self) -> ReferencePlan:
        """The quickest clear way of the first group that has one."""
        direct = self._direct()
        if direct is not None and direct.good:
            return self._result(direct, goes=True)
        if direct is not None:
            around = [c for c in self._around(direct) if c.good]
            if around:
                return self._result(min(around, key=_cost), goes=True)
        for c in (*(self._near(direct) if direct is not None else ()), *self._stay()):
            if c.good:
                return self._result(c, goes=False)
        aside = self._aside()
        if aside and aside[-1].good:
            return self._result(aside[-1], goes=False)
        status = ReferenceStatus.BLOCKED
        if self.path.status not in (PlanStatus.FOUND, PlanStatus.RELAXED):
            status = ReferenceStatus.NO_PATH
        if self.closest is None:
            return ReferencePlan(status, self.path, None, min_clearance_m=-math.inf)
        effort, clearance = self.closest.reference, self.closest.smallest_m
        return ReferencePlan(status, self.path, None, min_clearance_m=clearance, best_effort=effort)

    def _result(self, c: Candidate, goes: bool) -> ReferencePlan:
        arrives = goes and self.path.status is PlanStatus.FOUND
        return ReferencePlan(
            status=ReferenceStatus.OK,
            path=replace(self.path, p_WP=c.run.points),
            reference=c.reference,
            waits_us=round(US_PER_S * c.rest_s),
            reaches_goal=arrives,
            min_clearance_m=c.smallest_m,
        )

    def _make(self, points: Array, hard: bool = False, **how: float) -> Candidate:
        drive = drive_at(self.start, **how)
        if hard:
            drive = drive._replace(accel=HARD_SHARE * self.start.limits.a_brake_mps2)
        c = make(self.start, points, drive)
        if c.feasible and (self.closest is None or c.smallest_m > self.closest.smallest_m):
            self.closest = c
        return c

    def _direct(self) -> Candidate | None:
        """Go at full pace, on the path among what stands; sharper or slower if that is tight."""
        self.path = self.paths.still(self.start)
        if len(self.path.p_WP) == 0:
            return None
        return self._along(self.path.p_WP)

    def _along(self, path: Array) -> Candidate:
        """The first good curve along a path, or the last one tried."""
        tries = []
        shares = (0.5, 1.0, 1.6) if self.start.speed_mps >= MOVING_MPS else (0.0,)
        for reach, pace in ((self.params.corner_m, 1.0), (0.4, 1.0), (0.1, 0.5)):
            for share in shares:
                points = self._points(path, share, reach)
                c = self._make(points, pace=pace)
                if c.good:
                    return c
                tries.append(c)
                if c.feasible:
                    break
            if tries[-1].feasible and self._meets_mover(tries[-1]):
                return tries[-1]
        return max(tries, key=lambda c: (c.feasible, c.bad_at_s))

    def _meets_mover(self, c: Candidate) -> bool:
        """Whether what blocks a curve is a mover: it is clear of what stands."""
        t_us = self.start.t_us + round(US_PER_S * c.bad_at_s)
        p = c.reference.sample(np.array([t_us])).p_WD[:, 0]
        still = self.start.world_map.arrays
        return bool(clearances(still, p, np.array([math.inf]))[0] > 0.02)

    def _points(self, path: Array, share: float, reach: float) -> Array:
        clearance = self.params.astar.clearance_m
        return smooth(self.start, lead_in(self.start, path, share), reach, clearance)

    def _around(self, direct: Candidate) -> list[Candidate]:
        """Slower, round the movers, or with a rest at the start or before the blocked place."""
        out = [self._make(direct.points, pace=p) for p in self.params.paces]
        plan = self.paths.moving(self.start)
        if len(plan.p_WP) > 0:
            out.append(self._along(plan.p_WP))
        for at in self._rests(direct):
            for wait in self.params.waits_s:
                c = self._make(direct.points, rest_at=at, rest_s=wait)
                out.append(c)
                if c.good or not c.feasible:
                    break
        return out

    def _rests(self, direct: Candidate) -> list[float]:
        """Distances along the path at which to wait: before the blocked place, and at once."""
        blocked = direct.way_at(direct.bad_at_s, self.start.after_s)
        first = self.start.stop_m * 1.05 + 0.02 if self.start.speed_mps >= MOVING_MPS else 0.0
        before = [blocked - back for back in self.params.back_off_m]
        return [*(b for b in before if b > first + 0.1), first]

    def _near(self, direct: Candidate) -> list[Candidate]:
        """Go as near as is clear, and end there."""
        out = []
        for at in self._rests(direct):
            if at > 0.0:
                c = self._make(direct.points, end_at=at)
                out.append(c)
                if c.good:
                    break
        return out

    def _stay(self) -> list[Candidate]:
        """Stop, straight on."""
        s = self.start
        if s.speed_mps < MOVING_MPS:
            return [self._make(s.p_WS[None])]
        ahead = s.p_WS + (s.stop_m * 1.05 + 0.02) * s.v_WS / s.speed_mps
        return [self._make(smooth(s, np.array([s.p_WS, ahead]), 0.0, 0.0))]

    def _aside(self) -> list[Candidate]:
        """Go to a place near by that stays clear; of 26 directions, the soonest reached first."""
        s = self.start
        steps = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
        d = np.array([e for e in steps if any(e)], dtype=np.float64)
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        stop = s.p_WS + s.stop_m * s.v_WS / max(s.speed_mps, 1e-9)
        places = np.concatenate([stop + r * d for r in (0.3, 0.6, 1.0, 1.6)])
        begin = (s.t_us - s.world_map.stamp_us) / US_PER_S + s.after_s
        ahead = np.linspace(begin + 0.5, max(s.world_map.tube_horizon_s, begin + 1.0), 8)
        c = clearances(
            s.world_map.arrays, np.repeat(places, len(ahead), axis=0), np.tile(ahead, len(places))
        )
        worst = np.min(c.reshape(len(places), -1)[:, 2:], axis=1)
        out = []
        for i in np.argsort(-np.minimum(worst, 0.3), kind="stable")[:16]:
            leg = np.array([s.p_WS, places[i]])
            if s.speed_mps >= MOVING_MPS:
                leg = lead_in(s, leg, 1.0)
            found = self._make(smooth(s, leg, 0.3, -1.0), pace=1.0, hard=s.hurry)
            out.append(found)
            if found.good:
                break
        return out
