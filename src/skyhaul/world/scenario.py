# SPDX-License-Identifier: Apache-2.0
"""The scenario: everything that is given before the flight."""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.types import Vec3
from skyhaul.world.obstacles import Obstacle

VOXELS_MAX = 100_000_000
"""Most voxels of a map."""
VOXEL_BYTES = 32
"""Memory for a voxel: the map, its copy while it is redrawn, the path search [byte]."""


@dataclass(frozen=True, kw_only=True)
class MapFrame(Params):
    """Extent and resolution of the map."""

    origin_m: Vec3 = (-2.0, -2.0, 0.0)
    """Smallest corner [m]."""
    size_m: Vec3 = (14.0, 14.0, 13.0)
    """Edge lengths [m]."""
    voxel_m: float = 0.1
    """Edge of a voxel [m]."""
    window_m: Vec3 | None = None
    """Edges of the rolling window around the team that is held at `voxel_m` [m]; None: all."""
    coarse_voxel_m: float | None = None
    """Edge of the cells of the search outside the window [m]; needed with `window_m`."""

    def __post_init__(self) -> None:
        _check_positive(min(self.size_m), "size_m")
        _check_positive(self.voxel_m, "voxel_m")
        if (self.window_m is None) != (self.coarse_voxel_m is None):
            raise ValueError("window_m and coarse_voxel_m go together: give both or neither")
        if self.window_m is not None and not min(self.window_m) > self.voxel_m:
            raise ValueError(f"window_m must be larger than a voxel, got {self.window_m}")
        if self.coarse_voxel_m is not None and self.coarse_voxel_m < self.voxel_m:
            raise ValueError(
                f"coarse_voxel_m must be >= voxel_m = {self.voxel_m}, got {self.coarse_voxel_m}"
            )
        self._check_memory()

    def _check_memory(self) -> None:
        count = math.prod(s / self.voxel_m for s in self.window_m or self.size_m)
        if self.coarse_voxel_m is not None:
            count += math.prod(s / self.coarse_voxel_m for s in self.size_m)
        if count > VOXELS_MAX:
            raise ValueError(
                f"voxel_m = {self.voxel_m} makes {count:.3g} voxels, which take "
                f"{count * VOXEL_BYTES / 1e9:.3g} GB of memory; at most {VOXELS_MAX:.3g} are "
                "allowed: enlarge the voxels, make the map smaller or give it a window_m"
            )


@dataclass(frozen=True, kw_only=True)
class Room(Params):
    """Floor, walls and ceiling around the flight; the floor is at z = 0."""

    min_m: Vec3 = (-2.0, -2.0, 0.0)
    """Smallest corner [m]."""
    max_m: Vec3 = (12.0, 12.0, 13.0)
    """Largest corner [m]."""

    def __post_init__(self) -> None:
        if not all(a < b for a, b in zip(self.min_m, self.max_m, strict=True)):
            raise ValueError(f"max_m must exceed min_m in x, y and z, got {self.max_m}")
        if self.min_m[2] != 0.0:
            raise ValueError(f"min_m must have z = 0, the floor, got {self.min_m[2]}")


@dataclass(frozen=True, kw_only=True)
class Wind(Params):
    """Mean wind, Dryden turbulence and single gusts."""

    mean_mps: Vec3 = (0.0, 0.0, 0.0)
    """Mean wind, W axes [m/s]."""
    turbulence_mps: float = 0.0
    """RMS of the turbulence along each axis [m/s]."""
    length_scale_m: float = 5.0
    """Dryden length scale [m]."""
    gusts: tuple["Gust", ...] = ()
    """Single gusts."""

    def __post_init__(self) -> None:
        if not self.turbulence_mps >= 0.0:
            raise ValueError(f"turbulence_mps must be >= 0, got {self.turbulence_mps}")
        _check_positive(self.length_scale_m, "length_scale_m")


@dataclass(frozen=True, kw_only=True)
class Gust(Params):
    """One minus-cosine gust."""

    start_s: float
    """When it begins [s]."""
    duration_s: float
    """How long it lasts [s]."""
    peak_mps: Vec3
    """Wind at its peak, W axes [m/s]."""

    def __post_init__(self) -> None:
        if not self.start_s >= 0.0:
            raise ValueError(f"start_s must be >= 0, got {self.start_s}")
        _check_positive(self.duration_s, "duration_s")


@dataclass(frozen=True, kw_only=True)
class LightChange(Params):
    """The light rises or falls to another level."""

    at_s: float
    """When it begins [s]."""
    level: float
    """Level afterwards, 1 is a lit hall."""
    ramp_s: float = 0.0
    """How long it takes, along a straight line [s]."""

    def __post_init__(self) -> None:
        for name in ("at_s", "level", "ramp_s"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class Light(Params):
    """How bright the hall is lit over time; only cameras notice."""

    level: float = 1.0
    """Level at the start, 1 is a lit hall."""
    changes: tuple[LightChange, ...] = ()
    """Changes, in order of time; each begins after the one before has ended."""

    def __post_init__(self) -> None:
        if not self.level >= 0.0:
            raise ValueError(f"level must be >= 0, got {self.level}")
        for a, b in pairwise(self.changes):
            if b.at_s < a.at_s + a.ramp_s:
                raise ValueError(
                    f"changes must not overlap: one runs from {a.at_s} to {a.at_s + a.ramp_s} s, "
                    f"the next begins at {b.at_s} s"
                )

    def at(self, t_s: float) -> float:
        """Level at a time [s]."""
        level = self.level
        for change in self.changes:
            if t_s < change.at_s:
                break
            done = (t_s - change.at_s) / change.ramp_s if change.ramp_s > 0.0 else 1.0
            level += min(done, 1.0) * (change.level - level)
        return level


@dataclass(frozen=True, kw_only=True)
class World(Params):
    """Room, map, obstacles, wind, light."""

    room: Room = field(default_factory=Room)
    """Floor, walls, ceiling."""
    map: MapFrame = field(default_factory=MapFrame)
    """What of it is mapped, and how finely."""
    obstacles: tuple[Obstacle, ...] = ()
    """Static and moving obstacles."""
    wind: Wind = field(default_factory=Wind)
    """Moving air."""
    light: Light = field(default_factory=Light)
    """How bright it is."""


@dataclass(frozen=True, kw_only=True)
class GroundStart(Params):
    """Everything stands on the floor, cables slack."""

    kind: Literal["ground"] = "ground"
    payload_m: tuple[float, float] = (0.5, 0.5)
    """Where the load stands, x and y [m]."""
    vehicles_m: tuple[tuple[float, float], ...] | None = None
    """Where the vehicles stand, x and y [m]; default: on a ring of 0.7 cable lengths."""


@dataclass(frozen=True, kw_only=True)
class AirStart(Params):
    """The team hovers in formation, cables taut, at rest."""

    kind: Literal["air"] = "air"
    payload_m: Vec3 = (0.0, 0.0, 1.0)
    """Centre of mass of the load [m]."""


@dataclass(frozen=True, kw_only=True)
class FlyInStart(Params):
    """The vehicles fly in from their places, hook up to the load on the floor, then carry."""

    kind: Literal["fly-in"] = "fly-in"
    payload_m: tuple[float, float]
    """Where the load stands, x and y [m]."""
    vehicles_m: tuple[tuple[float, float], ...]
    """Where the vehicles stand, x and y [m]."""


Start = GroundStart | AirStart | FlyInStart


@dataclass(frozen=True, kw_only=True)
class GoTo(Params):
    """Carry the load to the goal and hover there."""

    kind: Literal["goto"] = "goto"
    goal_m: Vec3 = (9.0, 9.0, 9.0)
    """Where the load shall be [m]."""
    within_m: float = 0.2
    """Done: nearer than this ... [m]"""
    below_mps: float = 0.1
    """... and slower than this ... [m/s]"""
    hold_s: float = 2.0
    """... for this long [s]."""

    def __post_init__(self) -> None:
        _check_positive(self.within_m, "within_m")
        _check_positive(self.below_mps, "below_mps")
        if not self.hold_s >= 0.0:
            raise ValueError(f"hold_s must be >= 0, got {self.hold_s}")


@dataclass(frozen=True, kw_only=True)
class HoverTask(Params):
    """Stay where the flight began."""

    kind: Literal["hover"] = "hover"
    duration_s: float = 10.0
    """How long [s]."""
    within_m: float = 0.5
    """The load must never be farther from its reference [m]."""

    def __post_init__(self) -> None:
        _check_positive(self.duration_s, "duration_s")
        _check_positive(self.within_m, "within_m")


@dataclass(frozen=True, kw_only=True)
class CircleTask(Params):
    """Fly horizontal circles through the start; the speed rises and falls smoothly."""

    kind: Literal["circle"] = "circle"
    radius_m: float = 1.0
    """Radius [m]."""
    period_s: float = 10.0
    """Time of a lap at speed [s]."""
    laps: int = 3
    """Full laps, run-up and run-out not counted."""
    within_m: float = 0.5
    """The load must never be farther from its reference [m]."""

    def __post_init__(self) -> None:
        _check_positive(self.radius_m, "radius_m")
        _check_positive(self.period_s, "period_s")
        _check_positive(self.laps, "laps")
        _check_positive(self.within_m, "within_m")


@dataclass(frozen=True, kw_only=True)
class Figure8Task(Params):
    """Fly a lying eight around the start; the speed rises and falls smoothly."""

    kind: Literal["figure8"] = "figure8"
    size_m: Vec3 = (2.0, 1.0, 0.4)
    """Half extents along x, y and z [m]."""
    period_s: float = 12.0
    """Time of a lap at speed [s]."""
    laps: int = 2
    """Full laps."""
    yaw_amplitude_deg: float = 0.0
    """The load's yaw swings this far, once a lap [deg]."""
    within_m: float = 0.5
    """The load must never be farther from its reference [m]."""

    def __post_init__(self) -> None:
        if not min(self.size_m) >= 0.0:
            raise ValueError(f"size_m must be >= 0, got {self.size_m}")
        _check_positive(self.period_s, "period_s")
        _check_positive(self.laps, "laps")
        _check_positive(self.within_m, "within_m")


Task = GoTo | HoverTask | CircleTask | Figure8Task


@dataclass(frozen=True, kw_only=True)
class Limits(Params):
    """Limits on the motion of the load."""

    v_max_mps: float = 1.5
    """Speed [m/s]."""
    a_max_mps2: float = 1.0
    """Acceleration in planning [m/s^2]."""
    j_max_mps3: float = 3.0
    """Jerk in planning [m/s^3]."""
    a_brake_mps2: float = 3.0
    """Acceleration in emergencies [m/s^2]."""

    def __post_init__(self) -> None:
        for name in ("v_max_mps", "a_max_mps2", "j_max_mps3", "a_brake_mps2"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class VehicleDies(Params):
    """The rotors of one vehicle stop for good."""

    kind: Literal["vehicle-dies"] = "vehicle-dies"
    vehicle: int
    """Which, 0-based."""
    at_s: float | None = None
    """Time [s]; or give `at_progress`."""
    at_progress: float | None = None
    """Share of the way from start to goal the load has covered, 0..1."""

    def __post_init__(self) -> None:
        if (self.at_s is None) == (self.at_progress is None):
            raise ValueError("give exactly one of at_s and at_progress")
        if self.at_s is not None and not self.at_s >= 0.0:
            raise ValueError(f"at_s must be >= 0, got {self.at_s}")
        if self.at_progress is not None and not 0.0 <= self.at_progress <= 1.0:
            raise ValueError(f"at_progress must lie in 0..1, got {self.at_progress}")


@dataclass(frozen=True, kw_only=True)
class CableCut(Params):
    """A cable breaks."""

    kind: Literal["cable-cut"] = "cable-cut"
    vehicle: int
    """Which, 0-based."""
    at_s: float
    """Time [s]."""

    def __post_init__(self) -> None:
        if not self.at_s >= 0.0:
            raise ValueError(f"at_s must be >= 0, got {self.at_s}")


@dataclass(frozen=True, kw_only=True)
class HookRelease(Params):
    """A hook lets go though nobody asked."""

    kind: Literal["hook-release"] = "hook-release"
    vehicle: int
    """Which, 0-based."""
    at_s: float
    """Time [s]."""

    def __post_init__(self) -> None:
        if not self.at_s >= 0.0:
            raise ValueError(f"at_s must be >= 0, got {self.at_s}")


ScriptedEvent = VehicleDies | CableCut | HookRelease


STACK_KEYS = ("sensors", "perception", "mapping", "planning", "control", "comms", "mission")
"""Roots of a scenario file that are not the scenario's: they configure the stack that flies it."""


@dataclass(frozen=True, kw_only=True)
class Scenario(Params):
    """Team, world and task."""

    name: str = "paper"
    """Name, for folders and titles."""
    description: str = ""
    """One sentence."""
    team: Team = field(default_factory=Team)
    """Vehicles, cables, load."""
    world: World = field(default_factory=World)
    """Room, map, obstacles, wind."""
    start: Start = field(default_factory=GroundStart)
    """Where everything is at time 0."""
    task: Task = field(default_factory=GoTo)
    """What shall be done."""
    limits: Limits = field(default_factory=Limits)
    """How fast the load may move."""
    events: tuple[ScriptedEvent, ...] = ()
    """What goes wrong, and when."""
    time_limit_s: float = 120.0
    """The mission has failed when it takes longer [s]."""

    def __post_init__(self) -> None:
        _check_positive(self.time_limit_s, "time_limit_s")


def _check_positive(value: float, name: str) -> None:
    if not value > 0.0:
        raise ValueError(f"{name} must be > 0, got {value}")
