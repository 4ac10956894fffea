# SPDX-License-Identifier: Apache-2.0
"""One way to fly to the goal: a path, how fast, where to rest; made into a curve and judged."""

import math
from dataclasses import dataclass

import numpy as np

from skyhaul.mapping.api import WorldMap
from skyhaul.planning.api import Reference
from skyhaul.planning.bspline import BASIS, largest_derivatives
from skyhaul.planning.motion import Drive, Run, control_points, run_along
from skyhaul.planning.path import round_corners
from skyhaul.planning.reference import SplineReference, continuation, tilts_of
from skyhaul.planning.verify import Pace, fastest, verify_spline
from skyhaul.types import US_PER_S, Array, TimeUs
from skyhaul.world.scenario import Limits

MOVING_MPS = 0.05
"""Slower than this the first leg of a new path may point anywhere [m/s]."""
SPACING_M = 0.05
"""Distance of the points along a path [m]."""
ACCEL_SHARE = 0.85
"""Share of the acceleration limit that the speed profile uses; rounding takes the rest."""
WANTED_M = 0.05
"""A new curve keeps this clear; one in force is given up only when it is not clear at all [m]."""
HARD_SHARE = 0.85
"""Share of the braking acceleration that is used in a hurry; rounding takes the rest."""
DODGE_M = 1.5
"""In a hurry the load may also turn hard, for this long after the way to a stop [m]."""
TOLERANCE = 1.02
"""Limits may be exceeded by this factor."""
FLOWN = np.array([1.0, 1.02, 1.05, 1.25])
"""So much of the speed, acceleration and jerk that are flown anyway may be flown further."""


@dataclass(frozen=True, eq=False)
class Departure:
    """Where and how a new curve leaves the current one."""

    world_map: WorldMap
    current: Reference
    t_us: TimeUs
    dt_us: TimeUs  # knot spacing of the new curve
    start_us: TimeUs  # its first knot
    first: Array  # (7 or 8, 4) its first control points
    after_s: float  # when the last of them acts, after the departure
    allowed: Array  # (4,) largest derivatives 0..3, entry 0 unused
    limits: Limits
    hurry: bool  # emergencies: brake hard on the first leg

    @property
    def dt_s(self) -> float:
        """Knot spacing [s]."""
        return self.dt_us / US_PER_S

    @property
    def p_WS(self) -> Array:
        """Where the new path begins, (3,): the last control point that is fixed [m]."""
        return np.asarray(self.first[-1, :3])

    @property
    def v_WS(self) -> Array:
        """Velocity there, (3,) [m/s]."""
        return np.asarray((self.first[-1, :3] - self.first[-2, :3]) / self.dt_s)

    @property
    def speed_mps(self) -> float:
        """Speed there [m/s]."""
        return float(np.linalg.norm(self.v_WS))

    @property
    def sane(self) -> bool:
        """Whether its first control points are no wild extrapolation."""
        p = self.first[:, :3]
        speed = np.max(np.linalg.norm(np.diff(p, axis=0), axis=1)) / self.dt_s
        accel = np.max(np.linalg.norm(np.diff(p, 2, axis=0), axis=1)) / self.dt_s**2
        return bool(speed <= 1.05 * self.allowed[1] and accel <= 1.5 * self.allowed[2])

    @property
    def brake_mps2(self) -> float:
        """Acceleration on the first leg [m/s^2]."""
        limits = self.limits
        return HARD_SHARE * limits.a_brake_mps2 if self.hurry else ACCEL_SHARE * limits.a_max_mps2

    @property
    def stop_m(self) -> float:
        """Way to a stop, straight on [m]."""
        return self.speed_mps**2 / (2.0 * self.brake_mps2)


def departure(
    world_map: WorldMap,
    current: Reference,
    t_us: TimeUs,
    dt_us: TimeUs,
    limits: Limits,
    hurry: bool = False,
) -> Departure:
    """Leave the current reference at a time."""
    begin = continuation(current, t_us, dt_us)
    ahead = current.sample(t_us + dt_us * np.arange(0, 9) // 2).p_WD[:, :4]
    flown = np.max(np.linalg.norm(ahead, axis=2), axis=0)
    wanted = [math.inf, limits.v_max_mps, limits.a_max_mps2, limits.j_max_mps3]
    if hurry:
        wanted[2], wanted[3] = limits.a_brake_mps2, math.inf
    allowed = np.maximum(np.array(wanted) * TOLERANCE, FLOWN * flown)
    after_s = begin.free_after_s(t_us, dt_us / US_PER_S)
    return Departure(world_map, current, t_us, dt_us, *begin, after_s, allowed, limits, hurry)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A curve and its merits."""

    reference: SplineReference
    points: Array  # (k, 3) the path from the departure's last fixed control point [m]
    run: Run
    feasible: bool  # within the limits
    smallest_m: float  # clearance
    bad_at_s: float  # when it is not clear, after the departure; inf: never
    rest_s: float = 0.0

    @property
    def good(self) -> bool:
        """Clear and within the limits."""
        return self.feasible and self.bad_at_s == math.inf

    @property
    def end_us(self) -> TimeUs:
        """When it ends."""
        return self.reference.end_us

    def way_at(self, after_s: float, lead_s: float) -> float:
        """Distance along the path at a time after the departure [m]."""
        return float(np.interp(after_s - lead_s, self.run.time, self.run.way))


def lead_in(start: Departure, path: Array, share: float) -> Array:
    """A path whose first leg follows the present velocity for a share of the way to a stop."""
    if start.speed_mps < MOVING_MPS:
        return np.concatenate([start.p_WS[None], path[1:]])
    ahead = start.p_WS + (share * start.stop_m + 0.1) * start.v_WS / start.speed_mps
    return np.concatenate([start.p_WS[None], ahead[None], path[1:]])


def smooth(start: Departure, path: Array, reach_m: float, clearance_m: float) -> Array:
    """Points along a path with rounded corners, (k, 3) [m]."""
    path = np.ascontiguousarray(path)
    return round_corners(start.world_map.arrays, path, reach_m, clearance_m, SPACING_M)


def drive_at(
    start: Departure,
    pace: float = 1.0,
    rest_at: float = -1.0,
    rest_s: float = 0.0,
    end_at: float = math.inf,
) -> Drive:
    """Limits at a pace, 0..1: times grow by 1 / pace."""
    limits = start.limits
    hard = HARD_SHARE * limits.a_brake_mps2 if start.hurry else 0.0
    return Drive(
        speed=pace * limits.v_max_mps,
        accel=ACCEL_SHARE * pace * limits.a_max_mps2,
        brake=hard,
        brake_until=start.stop_m + DODGE_M if start.hurry else 0.0,
        rest_at=rest_at,
        rest_s=rest_s,
        end_at=end_at,
    )


def make(start: Departure, points: Array, drive: Drive) -> Candidate:
    """Fly points in a certain way: the curve, its limits and its clearance."""
    run = run_along(points, start.speed_mps, drive)
    control = control_points(start.first, run, start.dt_s)
    reference = SplineReference(start.start_us, start.dt_us, control, tilts=tilts_of(start.current))
    top = largest_derivatives(control, start.dt_s, BASIS, 4)
    feasible = run.feasible and bool(np.all(top[1:4] <= start.allowed[1:4]))
    begin = (start.start_us - start.world_map.stamp_us) / US_PER_S
    since = (start.t_us - start.start_us) / US_PER_S
    pace = Pace(fastest(start.world_map, max(top[1], 0.1)), WANTED_M)
    smallest, bad, _ = verify_spline(
        start.world_map.arrays, control, start.dt_s, begin, since, pace, BASIS
    )
    return Candidate(reference, points, run, feasible, smallest, bad, drive.rest_s)
