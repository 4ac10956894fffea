# SPDX-License-Identifier: Apache-2.0
"""The map M(t): voxels that stand, tracks that move, and the clearance of the team to both."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.mapping.tubes import track_arrays
from skyhaul.model.envelope import TeamShape
from skyhaul.perception.api import Track, TrackArrays
from skyhaul.types import US_PER_S, Array, IntArray, Mask, TimeUs, frozen

if TYPE_CHECKING:
    from skyhaul.mapping.clearance import MapGradient

Cell = tuple[int, int, int]
FieldArray = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Axis-aligned voxels of world W; True is occupied."""

    occupied: Mask  # (nx, ny, nz)
    p_WO: Array  # (3,) centre of voxel (0, 0, 0) [m]
    voxel_m: float

    def __post_init__(self) -> None:
        self.occupied.setflags(write=False)

    def cell(self, p_WP: Array) -> Cell | None:
        """Voxel that contains point P, or None outside the grid."""
        i, j, k = np.rint((p_WP - self.p_WO) / self.voxel_m).astype(int)
        inside = all(0 <= c < n for c, n in zip((i, j, k), self.occupied.shape, strict=True))
        return (int(i), int(j), int(k)) if inside else None

    def center(self, cells: list[Cell]) -> Array:
        """Centres of voxels, (n, 3) [m]."""
        return self.p_WO + self.voxel_m * np.asarray(cells, dtype=np.float64).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class StaticLayer:
    """Voxels and the clearance of the team to them."""

    grid: OccupancyGrid
    clearance: FieldArray  # (nx, ny, nz) with the load at each voxel centre, truncated [m]

    def __post_init__(self) -> None:
        frozen(self.clearance)


class LayerArrays(NamedTuple):
    """A `StaticLayer` as the kernels see it."""

    clearance: FieldArray  # (nx, ny, nz) [m]
    origin: Array  # (3,) centre of voxel (0, 0, 0) [m]
    voxel: float  # [m]


class MapArrays(NamedTuple):
    """M(t) as the kernels see it; times are in seconds after the map's stamp."""

    fine: LayerArrays
    coarse: LayerArrays  # of everything; the fine one itself when there is no other
    windowed: bool  # the fine layer is a window: what lies outside is in the coarse one only
    truncation: float  # [m]
    room_min: Array  # (3,) [m]
    room_max: Array  # (3,) [m]
    exempt: Array  # (3,) x, y, radius of the column in which the floor does not count [m]
    shape: Array  # (3,) radius, above, below of the team's cylinder [m]
    tracks: TrackArrays
    horizon: float  # tubes count until then [s]


def _everywhere() -> Array:
    return np.full(3, np.inf)


@dataclass(frozen=True, eq=False)
class WorldMap:
    """M(t) at one time. The one source of clearance for planner, triggers and controller.

    Clearance is from the surface of the team's shape, its load's centre of mass at P, to the
    nearest obstacle or wall, negative inside; the static part is lowered by half a voxel
    diagonal, so that it never exceeds the truth. Walls, ceiling and floor are planes of their
    own, not voxels, and are not lowered. Tubes of tracks count up to `tube_horizon_s` after the
    stamp: farther ahead nobody knows where a mover is, and replanning must do. One that stands
    is taken to stand on, its tube as wide as at the horizon.
    """

    stamp_us: TimeUs
    grid: OccupancyGrid
    static_clearance: FieldArray  # (nx, ny, nz) to voxels, load at the centre, truncated [m]
    truncation_m: float  # larger clearances are stored as this
    tracks: tuple[Track, ...]
    shape: TeamShape
    version: int  # rises whenever the static layer changes
    room_min: Array = field(default_factory=lambda: -_everywhere())  # (3,) [m]
    room_max: Array = field(default_factory=_everywhere)  # (3,) [m]
    floor_exempt: Array | None = None  # (3,) x, y, radius of the lift-off column [m]
    tube_horizon_s: float = 4.0
    known_range_m: float = 4.0  # obstacles this near to a vehicle are known [m]
    coarse: StaticLayer | None = None  # what is known outside the rolling window

    def __post_init__(self) -> None:
        frozen(self.static_clearance)

    @cached_property
    def arrays(self) -> MapArrays:
        """The same for the kernels."""
        fine = LayerArrays(self.static_clearance, self.grid.p_WO, self.grid.voxel_m)
        coarse = fine
        if self.coarse is not None:
            grid = self.coarse.grid
            coarse = LayerArrays(self.coarse.clearance, grid.p_WO, grid.voxel_m)
        exempt = np.zeros(3) if self.floor_exempt is None else self.floor_exempt
        shape = np.array([self.shape.radius_m, self.shape.above_m, self.shape.below_m])
        tracks = track_arrays(self.tracks, self.stamp_us)
        return MapArrays(
            fine,
            coarse,
            self.coarse is not None,
            self.truncation_m,
            np.asarray(self.room_min, dtype=np.float64),
            np.asarray(self.room_max, dtype=np.float64),
            np.asarray(exempt, dtype=np.float64),
            shape,
            tracks,
            self.tube_horizon_s,
        )

    def after_s(self, t_us: Array | IntArray) -> Array:
        """Times after the stamp, (k,) [s]."""
        return (np.asarray(t_us, dtype=np.float64) - self.stamp_us) / US_PER_S

    def clearance(self, p_WP: Array, t_us: Array | IntArray) -> Array:
        """Clearance to the static layer and to the tracks' tubes at those times, (k,) [m].

        Args:
            p_WP: Load positions, (k, 3) [m].
            t_us: When the load is there, (k,) [us].
        """
        from skyhaul.mapping.clearance import map_clearance  # the kernel imports these classes

        return map_clearance(self, p_WP, t_us)

    def clearance_gradient(self, p_WP: Array, t_us: Array) -> "MapGradient":
        """The same for the static layer and for each track, apart, with gradients; args as above.

        Tracks do not count at times later than `tube_horizon_s` after the stamp.
        """
        from skyhaul.mapping.clearance import map_clearance_gradient

        return map_clearance_gradient(self, p_WP, t_us)


@dataclass(frozen=True, eq=False)
class MapChange:
    """The paper's e(t): what changed in M(t) since the last update."""

    stamp_us: TimeUs
    changed_min: Array  # (3,) smallest corner of the changed static region [m]; empty: +inf
    changed_max: Array  # (3,) largest corner [m]; empty: -inf
    born: tuple[int, ...]  # ids of tracks that are new
    died: tuple[int, ...]  # ids of tracks that are gone
    strayed: tuple[int, ...]  # ids of tracks that left the tube predicted at the last plan

    @property
    def static_changed(self) -> bool:
        """Whether any voxel changed."""
        return bool(np.all(self.changed_min <= self.changed_max))
