# SPDX-License-Identifier: Apache-2.0
"""The paper's reference: a clamped cubic spline through waypoints, with times allocated."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from skyhaul.mapping.api import WorldMap
from skyhaul.model.envelope import TeamShape
from skyhaul.params import Params
from skyhaul.planning.api import (
    PlanStatus,
    Reference,
    ReferencePlan,
    ReferenceStatus,
    RefSample,
    Times,
)
from skyhaul.planning.astar import AStar
from skyhaul.planning.candidates import ACCEL_SHARE, MOVING_MPS, SPACING_M
from skyhaul.planning.motion import Drive, run_along
from skyhaul.planning.path import round_corners
from skyhaul.planning.paths import PathSearch
from skyhaul.planning.reference import Tilted, tilt, tilts_of, untilted
from skyhaul.planning.replan import capped
from skyhaul.planning.verify import verify
from skyhaul.types import US_PER_S, Array, TimeUs
from skyhaul.world.scenario import Limits

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline  # slow to import, and few flights need it


@dataclass(frozen=True, eq=False)
class CubicReference(Tilted):
    """Piecewise cubic, C2 inside; its jerk jumps at the waypoints and higher derivatives are 0."""

    start_us: TimeUs
    spline: "CubicSpline"  # of time after the start [s]
    yaw_rad: float

    @property
    def end_us(self) -> TimeUs:
        """When it ends, at rest."""
        return self.start_us + round(US_PER_S * float(self.spline.x[-1]))

    def sample(self, t_us: Times) -> RefSample:
        """See `Reference.sample`."""
        t = (np.atleast_1d(np.asarray(t_us, dtype=np.float64)) - self.start_us) / US_PER_S
        last = float(self.spline.x[-1])
        p = np.zeros((len(t), 7, 3))
        for k in range(4):
            p[:, k] = self.spline(np.clip(t, 0.0, last), nu=k)
        p[(t < 0.0) | (t > last), 1:] = 0.0
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        R = np.zeros((len(t), 7, 3, 3))
        R[:, 0] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
        tilt(self, self.start_us, t, R)
        return RefSample(p_WD=p, R_WD=R)

    def max_speed_mps(self) -> float:
        """Largest speed [m/s]."""
        return self._largest(1)

    def max_acceleration_mps2(self) -> float:
        """Largest acceleration [m/s^2]."""
        return self._largest(2)

    def max_jerk_mps3(self) -> float:
        """Largest jerk [m/s^3]."""
        return self._largest(3)

    def _largest(self, k: int) -> float:
        t = np.arange(self.start_us, self.end_us + 1, 20_000)
        return float(np.max(np.linalg.norm(self.sample(t).p_WD[:, k], axis=1)))


@dataclass(frozen=True, kw_only=True)
class CubicPlanner(Params):
    """A*, shortcuts, times allocated, clamped cubic spline: what the paper prints, made whole.

    Source:
        Paper Sec. III-C: path = CubicSpline({w_i}, t).
    Deviation:
        PAPER_NOTES 30: times come from a speed profile, the ends are clamped, the curve is
        checked with the clearance function and repaired with more waypoints.
    """

    kind: Literal["cubic"] = "cubic"
    path: PathSearch = field(default_factory=AStar)
    """The path search."""
    spacing_m: float = 1.0
    """Distance of the waypoints, halved while the curve is not clear [m]."""
    corner_m: float = 1.0
    """Rounding of a corner takes at most this much of its legs [m]."""

    def __post_init__(self) -> None:
        for name in ("spacing_m", "corner_m"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")

    def build(self, shape: TeamShape) -> "CubicRoutePlanner":
        """The planner of a team."""
        return CubicRoutePlanner(self, shape)


@dataclass(frozen=True)
class CubicRoutePlanner:
    """Implements `ReferencePlanner`; keeps position and velocity, not what lies above."""

    params: CubicPlanner
    shape: TeamShape

    def plan(
        self,
        world_map: WorldMap,
        current: Reference,
        t_us: TimeUs,
        p_WG: Array,
        limits: Limits,
    ) -> ReferencePlan:
        """See `ReferencePlanner.plan`; it goes, more slowly if need be, and never waits."""
        limits = capped(limits, world_map)
        now = untilted(current).sample(np.array([t_us]))
        p_WS, v_WS = now.p_WD[0, 0], now.p_WD[0, 1]
        yaw = math.atan2(now.R_WD[0, 0, 1, 0], now.R_WD[0, 0, 0, 0])
        p_WG = np.asarray(p_WG, dtype=np.float64)
        speed, a = float(np.linalg.norm(v_WS)), ACCEL_SHARE * limits.a_max_mps2
        ahead = p_WS + v_WS * (0.5 * speed / a)  # where it could stop, straight on
        path = self.params.path.plan(world_map, ahead, p_WG, 0.7 * limits.v_max_mps, t_us)
        if len(path.p_WP) == 0:
            return ReferencePlan(ReferenceStatus.NO_PATH, path, None)
        m, least = world_map.arrays, self.params.path.clearance_m
        corners = np.concatenate([p_WS[None], path.p_WP[0 if speed > MOVING_MPS else 1 :]])
        points = round_corners(m, corners, self.params.corner_m, least, SPACING_M)
        effort: Reference | None = None
        for pace in (1.0, 0.6, 0.35):
            for halvings in range(4):
                spacing = self.params.spacing_m * 0.5**halvings
                spline = timed_cubic(points, v_WS, _drive(limits, pace), spacing)
                reference = CubicReference(t_us, spline, yaw, tilts=tilts_of(current))
                smallest, bad, _ = verify(world_map, reference, t_us, limits.v_max_mps)
                effort = effort or reference
                if bad == math.inf and _within(reference, limits):
                    return ReferencePlan(
                        ReferenceStatus.OK,
                        path,
                        reference,
                        reaches_goal=path.status is PlanStatus.FOUND,
                        min_clearance_m=smallest,
                    )
        return ReferencePlan(ReferenceStatus.BLOCKED, path, None, best_effort=effort)


def _drive(limits: Limits, pace: float) -> Drive:
    return Drive(
        speed=0.9 * pace * limits.v_max_mps,
        accel=ACCEL_SHARE * 0.8 * pace * limits.a_max_mps2,
        brake=0.0,
        brake_until=0.0,
        rest_at=-1.0,
        rest_s=0.0,
        end_at=math.inf,
    )


def _within(reference: CubicReference, limits: Limits) -> bool:
    """Limits on speed and acceleration; those of its joints cannot be held on jerk."""
    fast = reference.max_speed_mps() <= 1.05 * limits.v_max_mps
    return fast and reference.max_acceleration_mps2() <= 1.5 * limits.a_max_mps2


def timed_cubic(points: Array, v_WS: Array, drive: Drive, spacing_m: float) -> "CubicSpline":
    """Cubic spline through points of a path, reached at the times of the speed profile.

    Clamped: it begins with velocity v_WS, (3,), and ends at rest.
    """
    from scipy.interpolate import CubicSpline

    run = run_along(points, float(np.linalg.norm(v_WS)), drive)
    if run.way[-1] < 1e-6:
        hold = np.repeat(run.points[:1], 2, axis=0)
        return CubicSpline([0.0, 1.0], hold, bc_type="clamped")
    count = max(2, math.ceil(run.way[-1] / spacing_m)) + 1
    way = np.linspace(0.0, run.way[-1], count)
    time = np.interp(way, run.way, run.time)
    p = np.column_stack([np.interp(way, run.way, run.points[:, c]) for c in range(3)])
    return CubicSpline(time, p, bc_type=((1, v_WS), (1, np.zeros(3))))
