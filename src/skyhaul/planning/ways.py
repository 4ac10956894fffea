# SPDX-License-Identifier: Apache-2.0
"""The ways that are tried out of one place: go, slower, round, wait, near, stay, aside."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from skyhaul.mapping.api import WorldMap
from skyhaul.mapping.clearance import clearances
from skyhaul.params import Params
from skyhaul.planning.api import Plan, PlanStatus, ReferencePlan, ReferenceStatus
from skyhaul.planning.candidates import (
    ACCEL_SHARE,
    HARD_SHARE,
    MOVING_MPS,
    WANTED_M,
    Candidate,
    Departure,
    drive_at,
    lead_in,
    make,
    smooth,
)
from skyhaul.planning.cost import way_cost
from skyhaul.planning.detours import detours, posts
from skyhaul.planning.paths import PathSearch
from skyhaul.types import US_PER_S, Array

POSTS = 4
"""Places to wait near the goal that are tried."""


@dataclass(frozen=True, kw_only=True)
class WayParams(Params):
    """What is tried."""

    corner_m: float = 1.5
    """Rounding of a corner takes at most this much of its legs [m]."""
    waits_s: tuple[float, ...] = (0.5, 1.0, 2.0, 3.0, 4.0)
    """Times to wait for movers that are tried [s]."""
    back_off_m: tuple[float, ...] = (0.3, 0.8, 1.6, 3.0)
    """Distances before a blocked place at which waiting is tried [m]."""
    paces: tuple[float, ...] = (0.75, 0.5, 0.3)
    """Slower paces that are tried."""
    aside_m: tuple[float, ...] = (0.8, 1.6)
    """Distances at which a blocked place is passed [m]."""
    sides: int = 8
    """On so many sides."""
    post_m: tuple[float, ...] = (0.5, 0.8, 1.1, 1.4)
    """Distances from a taken goal at which waiting is tried [m]."""

    def __post_init__(self) -> None:
        if not self.corner_m > 0.0:
            raise ValueError(f"corner_m must be > 0, got {self.corner_m}")
        if not all(0.0 < p < 1.0 for p in self.paces):
            raise ValueError(f"paces must lie in (0, 1), got {self.paces}")
        if self.sides < 1:
            raise ValueError(f"sides must be >= 1, got {self.sides}")
        for name in ("waits_s", "back_off_m", "aside_m", "post_m"):
            if not all(x > 0.0 for x in getattr(self, name)):
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")


def _cost(c: Candidate) -> float:
    """What a way costs, but for when it begins [s]."""
    return way_cost(c.end_us / US_PER_S, float(c.run.way[-1]), c.smallest_m)


@dataclass(eq=False)
class Paths:
    """Paths to the goal, searched once for all departures; they begin near the first of them."""

    search: PathSearch
    p_WG: Array
    _still: Plan | None = None
    _moving: Plan | None = None

    def still(self, start: Departure) -> Plan:
        """Among what stands."""
        if self._still is None:
            self._still = self._plan(replace(start.world_map, tracks=()), start)
        return self._still

    def moving(self, start: Departure) -> Plan:
        """Round the tubes of the movers too."""
        if self._moving is None:
            self._moving = self._plan(start.world_map, start)
        return self._moving

    def _plan(self, world_map: WorldMap, s: Departure) -> Plan:
        """A path from half the way to a stop on to the goal."""
        speed = self._typical_speed(s)
        start_us = s.t_us + round(US_PER_S * s.after_s)
        if s.speed_mps < MOVING_MPS:
            return self.search.plan(world_map, s.p_WS, self.p_WG, speed, start_us)
        ahead = s.p_WS + (0.5 * s.stop_m + 0.1) * s.v_WS / s.speed_mps
        plan = self.search.plan(world_map, ahead, self.p_WG, speed, start_us)
        if plan.status is PlanStatus.START_BLOCKED:
            plan = self.search.plan(world_map, s.p_WS, self.p_WG, speed, start_us)
        return plan

    def _typical_speed(self, s: Departure) -> float:
        """Mean speed of the way to the goal, roughly [m/s]."""
        far = float(np.linalg.norm(self.p_WG - s.p_WS))
        v, a = s.limits.v_max_mps, ACCEL_SHARE * s.limits.a_max_mps2
        return far / (far / v + v / a) if far > v * v / a else 0.5 * math.sqrt(far * a) + 1e-3


@dataclass(eq=False)
class Ways:
    """The ways out of one departure, and what was found on the way."""

    params: WayParams
    start: Departure
    paths: Paths
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
            near = [c for c in self._at_posts(direct) if c.good]
            if near:
                return self._result(min(near, key=_cost), goes=False)
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
        clearance = self.paths.search.clearance_m
        return smooth(self.start, lead_in(self.start, path, share), reach, clearance)

    def _around(self, direct: Candidate) -> list[Candidate]:
        """Slower, round the movers, or with a rest at the start or before the blocked place."""
        out = [self._make(direct.points, pace=p) for p in self.params.paces]
        plan = self.paths.moving(self.start)
        if len(plan.p_WP) > 0:
            out.append(self._along(plan.p_WP))
        out += self._past(direct)
        for at in self._rests(direct):
            for wait in self.params.waits_s:
                c = self._make(direct.points, rest_at=at, rest_s=wait)
                out.append(c)
                if c.good or not c.feasible:
                    break
        return out

    def _past(self, direct: Candidate) -> list[Candidate]:
        """Past the blocked place, on all sides of it."""
        blocked = direct.way_at(direct.bad_at_s, self.start.after_s)
        params = self.params
        paths = detours(self.path.p_WP, blocked, params.aside_m, params.sides)
        share = 1.0 if self.start.speed_mps >= MOVING_MPS else 0.0
        return [self._make(self._points(path, share, params.corner_m)) for path in paths]

    def _at_posts(self, direct: Candidate) -> list[Candidate]:
        """To a place near the goal that stays clear, and wait there."""
        s, goal = self.start, self.paths.p_WG
        begin_s = (s.t_us - s.world_map.stamp_us) / US_PER_S
        soonest_s = begin_s + s.after_s + float(np.linalg.norm(goal - s.p_WS)) / s.limits.v_max_mps
        if self.path.status is not PlanStatus.FOUND or not self._goal_taken(soonest_s):
            return []
        out: list[Candidate] = []
        for place in posts(s.world_map, s.p_WS, goal, self.params.post_m, soonest_s)[:POSTS]:
            out.append(self._along(np.concatenate([self.path.p_WP[:-1], place[None]])))
            if out[-1].good:
                break
        return out

    def _goal_taken(self, soonest_s: float) -> bool:
        """Whether a mover is at the goal when the team could be there, or comes soon after."""
        world_map = self.start.world_map
        times = np.linspace(soonest_s, max(world_map.tube_horizon_s, soonest_s), 8)
        goal = np.tile(self.paths.p_WG, (len(times), 1))
        return bool(np.min(clearances(world_map.arrays, goal, times)) < WANTED_M)

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
