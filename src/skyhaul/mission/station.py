# SPDX-License-Identifier: Apache-2.0
"""Where a vehicle flies while it carries nothing: to its station over the load, or away from it."""

from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from skyhaul.geometry.kernels import norm
from skyhaul.jit import njit
from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.types import Array

Share = TypeVar("Share", float, Array)


class Setpoint(NamedTuple):
    """Where a vehicle shall be."""

    p_WD: Array  # (3,) [m]
    v_WD: Array  # (3,) [m/s]
    a_WD: Array  # (3,) [m/s^2]


@dataclass(frozen=True, eq=False)
class Route:
    """Progress along a polyline; `rate` 1 runs forwards, -1 backwards."""

    corners: Array  # (k, 3) [m]
    length_m: float  # of the polyline [m]
    progress_s: float = 0.0
    rate: float = 0.0


def route_along(corners: Array) -> Route:
    """A route at its beginning, (k, 3) corners [m]."""
    return Route(corners, float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()))


@dataclass(frozen=True, kw_only=True)
class StationParams(Params):
    """How vehicles fly to their stations and tauten the cables."""

    speed_mps: float = 1.3
    """Largest speed on the way [m/s]."""
    slack_share: float = 0.995
    """The station lies this share of the cable length from the hook."""
    creep_mps: float = 0.15
    """Speed of the creep that tautens the cable [m/s]."""
    taut_n: float = 0.1
    """Tension at which the creep stops [N]."""
    settle_s: float = 0.1
    """A cable is taut once it has held that tension for this long [s]."""
    creep_max_share: float = 0.4
    """The creep goes at most this share of the cable length [-]."""
    attach_s: float = 2.0
    """A hook that does not close within this time at the station is a fault [s]."""
    turn_s: float = 0.5
    """Time to turn from forwards to backwards [s]."""
    cruise_height_m: float = 1.5
    """Height of the fly-in [m]."""
    clear_m: float = 1.5
    """How far a vehicle without a cable flies off [m]."""

    def __post_init__(self) -> None:
        for name in (
            *("speed_mps", "creep_mps", "taut_n", "attach_s", "turn_s"),
            *("cruise_height_m", "clear_m"),
        ):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not self.settle_s >= 0.0:
            raise ValueError(f"settle_s must be >= 0, got {self.settle_s}")
        if not 0.0 < self.creep_max_share <= 1.0:
            raise ValueError(f"creep_max_share must lie in (0, 1], got {self.creep_max_share}")
        if not 0.5 <= self.slack_share < 1.0:
            raise ValueError(f"slack_share must lie in [0.5, 1), got {self.slack_share}")

    def duration_s(self, route: Route) -> float:
        """Time from one end of the route to the other [s]."""
        return max(1.875 * route.length_m / self.speed_mps, 1e-3)

    def advance(self, route: Route, dt_s: float, *, forwards: bool) -> Route:
        """The route a little later."""
        wanted, slew = (1.0 if forwards else -1.0), 2.0 * dt_s / self.turn_s
        rate = route.rate + min(max(wanted - route.rate, -slew), slew)
        end = self.duration_s(route)
        progress = min(max(route.progress_s + rate * dt_s, 0.0), end)
        at_end = (progress == end and rate > 0.0) or (progress == 0.0 and rate < 0.0)
        return replace(route, progress_s=progress, rate=0.0 if at_end else rate)

    def setpoint(self, route: Route) -> Setpoint:
        """Minimum-jerk motion along the polyline."""
        end = self.duration_s(route)
        s = route.progress_s / end
        share = minimum_jerk(s)
        slope = 30.0 * s * s * (1.0 - s) ** 2 / end * route.rate
        p, tangent = _along(route.corners, share)
        bend = (60.0 * s - 180.0 * s * s + 120.0 * s**3) * (route.rate / end) ** 2
        return Setpoint(p, slope * route.length_m * tangent, bend * route.length_m * tangent)

    def arrived(self, route: Route) -> bool:
        """Whether the end of the route is reached."""
        return route.progress_s >= self.duration_s(route)


@dataclass(frozen=True, kw_only=True)
class TakeOffParams(Params):
    """How long the steps of a take-off last, and how far it keeps off movers."""

    tauten_s: float = 0.6
    """From the stations until all cables are known to be taut [s]."""
    rise_s: float = 0.4
    """From the first pull at full weight until the load leaves the floor [s]."""
    dodge_s: float = 0.8
    """From then on it takes this long to be on another course [s]."""
    margin_m: float = 0.1
    """Vehicles and cables keep at least this far off the tubes of movers [m]."""
    closer_m: float = 0.05
    """A mover inside the team's shape may come this much closer while the team rises [m]."""

    def __post_init__(self) -> None:
        for name in ("tauten_s", "rise_s", "dodge_s", "margin_m", "closer_m"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")


def minimum_jerk(s: Share) -> Share:
    """Share of a route's length that is done at a share of its time, both 0 to 1."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


@njit
def _along(corners: Array, share: float) -> tuple[Array, Array]:
    """Point at a share of a polyline's length, and the tangent there."""
    last = corners.shape[0] - 2
    total, before = 0.0, 0.0
    for k in range(last + 1):
        total += _leg(corners, k)
    k = 0
    while k < last and before + _leg(corners, k) < share * total:
        before += _leg(corners, k)
        k += 1
    point, tangent, length = np.empty(3), np.empty(3), max(_leg(corners, k), 1e-12)
    for c in range(3):
        tangent[c] = (corners[k + 1, c] - corners[k, c]) / length
        point[c] = corners[k, c] + (share * total - before) * tangent[c]
    return point, tangent


@njit
def _leg(corners: Array, k: int) -> float:
    """Length of leg k of a polyline [m]."""
    a, b = corners[k], corners[k + 1]
    return norm((b[0] - a[0], b[1] - a[1], b[2] - a[2]))


def station_point(team: Team, p_WL: Array, R_WL: Array, i: int, share: float) -> Array:
    """Place of vehicle i in the formation, its cable stretched to a share of its length, (3,)."""
    length = share * team.cable_lengths_m()[i]
    point: Array = p_WL + R_WL @ (team.hooks_L()[i] + length * team.formation_dirs_L()[i])
    return point


def way_in(start: str, cruise_m: float, p_WB: Array, end: Array) -> Array:
    """Corners of the way from a parking place to a station, (k, 3) [m].

    Args:
        start: Kind of the start: from the ground beside the load it is straight, from afar up,
            across and down.
        cruise_m: Height of the way across, if the station is not higher [m].
        p_WB: Parking place, (3,) [m].
        end: Station, (3,) [m].
    """
    if start != "fly-in":
        return np.array([p_WB, end])
    height = max(cruise_m, end[2] + 0.3)
    above = np.array([p_WB[0], p_WB[1], height])
    return np.array([p_WB, above, [end[0], end[1], height], end])
