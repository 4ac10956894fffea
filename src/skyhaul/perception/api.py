# SPDX-License-Identifier: Apache-2.0
"""Estimates that perception hands to mapping, planning and control."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

from skyhaul.geometry.shapes import Shape
from skyhaul.model.state import CableState, TeamState
from skyhaul.types import Array, IntArray, Mask, TimeUs, frozen

Memory = TypeVar("Memory")
Reading = TypeVar("Reading", contravariant=True)


@dataclass(frozen=True, eq=False)
class TeamEstimate:
    """Where everything of the team is."""

    stamp_us: TimeUs
    team: TeamState
    cables: CableState
    attached: Mask  # (n,) cables that join a vehicle and the load
    thrust: Array  # (n,) thrust that the rotors give now, from rotor speeds [N]
    load_covariance: Array  # (12, 12) of the load error, layout of `types.ERR_P`; 0 when exact

    def __post_init__(self) -> None:
        frozen(self.attached, self.thrust, self.load_covariance)


@dataclass(frozen=True, eq=False)
class Track:
    """One moving obstacle: its state and where it can be soon.

    The predicted tube at dt after the stamp is the shape at p_WO + v_WO dt, grown by
    `tube_m(dt)` on every side.
    """

    track_id: int
    stamp_us: TimeUs
    shape: Shape
    p_WO: Array  # (3,) [m]
    R_WO: Array  # (3, 3)
    v_WO: Array  # (3,) [m/s]
    covariance: Array  # (6, 6) of p_WO, v_WO
    growth_mps: float  # growth of the tube, from the unknown manoeuvres of the obstacle [m/s]
    tube_base_m: float  # radius of the tube at dt = 0: size error + 3 sigma of the position [m]

    def __post_init__(self) -> None:
        frozen(self.p_WO, self.R_WO, self.v_WO, self.covariance)

    def tube_m(self, dt_s: float) -> float:
        """Radius by which the shape is grown dt after the stamp [m]."""
        return self.tube_base_m + self.growth_mps * abs(dt_s)


class TrackArrays(NamedTuple):
    """Tracks as struct of arrays, all brought to one stamp, for the kernels."""

    kind: IntArray  # (m,) codes of geometry.shapes
    size: Array  # (m, 3)
    p_WO: Array  # (m, 3)
    R_WO: Array  # (m, 3, 3)
    v_WO: Array  # (m, 3)
    tube_base: Array  # (m,)
    growth: Array  # (m,)


@dataclass(frozen=True, eq=False)
class StaticObject:
    """One obstacle that stands: what the static layer is filled with."""

    object_id: int
    shape: Shape
    p_WO: Array  # (3,) [m]
    R_WO: Array  # (3, 3)


@dataclass(frozen=True, eq=False)
class StandingVoxels:
    """Voxels in which something stands, as cameras saw it; W axes."""

    occupied: Mask  # (nx, ny, nz)
    p_WO: Array  # (3,) centre of voxel (0, 0, 0) [m]
    voxel_m: float
    version: int  # rises whenever a voxel changes
    changed: IntArray  # (2, 3) range that changed since the version before, first and one past last

    def __post_init__(self) -> None:
        frozen(self.occupied, self.p_WO, self.changed)


@dataclass(frozen=True, eq=False)
class ObstacleEstimate:
    """What stands and what moves around the team."""

    stamp_us: TimeUs
    statics: tuple[StaticObject, ...]  # every one known so far
    tracks: tuple[Track, ...]  # confirmed and alive
    voxels: StandingVoxels | None = None  # what stands, where it is seen rather than told


class TeamEstimator(Protocol[Memory, Reading]):
    """Readings -> the team's state. Stateful through an explicit memory.

    `kind: truth` takes a `sensors.api.TeamReading`, estimators on real sensors take
    `team.api.TeamReports`.
    """

    def init(self) -> Memory:
        """Memory before the first reading."""
        ...

    def step(self, memory: Memory, reading: Reading) -> tuple[Memory, TeamEstimate]:
        """Take one reading in."""
        ...


class ObstacleEstimator(Protocol[Memory, Reading]):
    """Readings -> obstacles. Stateful through an explicit memory.

    Kinds differ in what they read: `truth` takes an `ObjectsReading`, `events` a `TeamSight`.
    """

    def init(self) -> Memory:
        """Memory before the first reading."""
        ...

    def step(self, memory: Memory, reading: Reading) -> tuple[Memory, ObstacleEstimate]:
        """Take one reading in."""
        ...
