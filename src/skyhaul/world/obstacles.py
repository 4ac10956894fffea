# SPDX-License-Identifier: Apache-2.0
"""Obstacles and how they move."""

from dataclasses import dataclass, field
from typing import Literal

from skyhaul.geometry.shapes import Shape
from skyhaul.params import Params
from skyhaul.types import Vec3


@dataclass(frozen=True, kw_only=True)
class Static(Params):
    """Stays where it is."""

    kind: Literal["static"] = "static"


@dataclass(frozen=True, kw_only=True)
class CyclicPath(Params):
    """Runs round a closed path of straight legs with rounded corners, for ever."""

    kind: Literal["cycle"] = "cycle"
    points_m: tuple[Vec3, ...]
    """Corners of the path, after the obstacle's own position; it returns there [m]."""
    speed_mps: float
    """Speed along the path [m/s]."""
    phase_s: float = 0.0
    """How far into the cycle it is at time 0 [s]; other seeds than 0 draw it."""
    dwell_s: float = 0.0
    """Rest at its own position, once in each cycle [s]."""

    def __post_init__(self) -> None:
        if not self.points_m:
            raise ValueError("points_m must name at least one corner, got none")
        if not self.speed_mps > 0.0:
            raise ValueError(f"speed_mps must be > 0, got {self.speed_mps}")
        if not self.dwell_s >= 0.0:
            raise ValueError(f"dwell_s must be >= 0, got {self.dwell_s}")


@dataclass(frozen=True, kw_only=True)
class Line(Params):
    """Runs along a straight line at constant speed; turns round at the end, or goes on."""

    kind: Literal["line"] = "line"
    velocity_mps: Vec3
    """Velocity [m/s]."""
    length_m: float | None = None
    """Length of the run, there and back again [m]; None: never turns."""
    phase_s: float = 0.0
    """How far into the run it is at time 0 [s]; other seeds than 0 draw it where it turns."""

    def __post_init__(self) -> None:
        if not any(self.velocity_mps):
            raise ValueError("velocity_mps must not be zero; use kind: static")
        if self.length_m is not None and not self.length_m > 0.0:
            raise ValueError(f"length_m must be > 0, got {self.length_m}")


@dataclass(frozen=True, kw_only=True)
class Circle(Params):
    """Runs round a circle that starts at the obstacle's own position."""

    kind: Literal["circle"] = "circle"
    center_m: Vec3
    """Centre of the circle [m]."""
    period_s: float
    """Time of one round [s]; negative runs clockwise seen against `normal`."""
    normal: Vec3 = (0.0, 0.0, 1.0)
    """Axis of the circle; need not be unit."""
    phase_s: float = 0.0
    """How far into the round it is at time 0 [s]; other seeds than 0 draw it."""

    def __post_init__(self) -> None:
        if self.period_s == 0.0:
            raise ValueError("period_s must not be 0")
        if not any(self.normal):
            raise ValueError("normal must not be zero")


Motion = Static | CyclicPath | Line | Circle


@dataclass(frozen=True, kw_only=True)
class Appearance(Params):
    """When an obstacle comes into being; until then it is nowhere. Give exactly one."""

    at_s: float | None = None
    """Time [s]."""
    distance_m: float | None = None
    """Distance of its surface to the team's shape at which it appears [m]."""

    def __post_init__(self) -> None:
        if (self.at_s is None) == (self.distance_m is None):
            raise ValueError("give exactly one of at_s and distance_m")
        for name in ("at_s", "distance_m"):
            value = getattr(self, name)
            if value is not None and not value >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {value}")


@dataclass(frozen=True, kw_only=True)
class Obstacle(Params):
    """One obstacle."""

    name: str
    """Unique name."""
    shape: Shape
    """Its form."""
    center_m: Vec3
    """Where its centre is at phase 0 [m]."""
    motion: Motion = field(default_factory=Static)
    """How it moves."""
    appears: Appearance | None = None
    """When it comes into being; None: it is there from the start."""

    def __post_init__(self) -> None:
        if not self.name:
            raise ValueError("name must not be empty")
