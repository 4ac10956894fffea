# SPDX-License-Identifier: Apache-2.0
"""Keeps M(t) up to date from what perception reports."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skyhaul.mapping.api import MapChange, OccupancyGrid, StaticLayer, WorldMap
from skyhaul.mapping.field import DEPTH_M, reach_cells, update_field
from skyhaul.mapping.tubes import has_strayed
from skyhaul.mapping.voxels import cells_of, mark, shape_extent
from skyhaul.model.envelope import TeamShape
from skyhaul.model.state import TeamState
from skyhaul.params import Params
from skyhaul.perception.api import ObstacleEstimate, StandingVoxels, StaticObject, Track
from skyhaul.types import Array, IntArray, TimeUs
from skyhaul.world.scenario import MapFrame, Room

Statics = dict[int, StaticObject]


@dataclass(frozen=True, kw_only=True)
class Mapping(Params):
    """Voxels for what stands, tubes for what moves."""

    kind: Literal["grid"] = "grid"
    truncation_m: float = 2.5
    """Clearances are told apart up to this [m]."""
    tube_horizon_s: float = 5.5
    """Predicted tubes of movers are trusted this far ahead [s]."""
    known_range_m: float = 4.0
    """Obstacles this near to a vehicle are known [m]."""
    exempt_m: float = 0.6
    """Radius of the column around the start in which the floor does not count [m]."""
    window_shift_m: float = 2.0
    """The rolling window follows when the load is this far from its centre [m]."""

    def __post_init__(self) -> None:
        if not self.truncation_m > DEPTH_M:
            raise ValueError(f"truncation_m must be > {DEPTH_M}, got {self.truncation_m}")
        for name in ("tube_horizon_s", "known_range_m", "window_shift_m"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if self.exempt_m < 0.0:
            raise ValueError(f"exempt_m must be >= 0, got {self.exempt_m}")

    def build(self, frame: MapFrame, room: Room, shape: TeamShape) -> "Mapper":
        """The mapper of one flight."""
        return Mapper(self, frame, room, shape)


@dataclass(frozen=True, eq=False)
class MapperMemory:
    """What the mapper keeps between steps."""

    fine: StaticLayer | None = None
    coarse: StaticLayer | None = None
    statics: tuple[StaticObject, ...] = ()
    voxels: StandingVoxels | None = None
    tracks: tuple[Track, ...] = ()
    planned: tuple[Track, ...] = ()  # tracks as the last plan knew them
    floor_exempt: Array | None = None  # (3,) x, y, radius [m]
    version: int = 0


@dataclass(frozen=True)
class Mapper:
    """Estimates of obstacles -> M(t) and e(t)."""

    params: Mapping
    frame: MapFrame
    room: Room
    shape: TeamShape

    def init(self) -> MapperMemory:
        """Memory before the first step."""
        return MapperMemory()

    def mark_planned(self, memory: MapperMemory) -> MapperMemory:
        """Note that a plan was made with the tracks of now: from these tubes they may stray."""
        return replace(memory, planned=memory.tracks)

    def step(
        self, memory: MapperMemory, obstacles: ObstacleEstimate, team: TeamState
    ) -> tuple[MapperMemory, WorldMap, MapChange]:
        """Take obstacles in; `team` is where the window rolls to and, at first, the column."""
        m = self._static_step(memory, obstacles.statics, team.p_WL)
        changed = m.version != memory.version
        m, voxel_low, voxel_high = self._voxel_step(m, obstacles.voxels)
        before = {t.track_id for t in memory.tracks}
        now = {t.track_id for t in obstacles.tracks}
        low, high = _changed_region(
            memory.statics, obstacles.statics if changed else memory.statics
        )
        low, high = np.minimum(low, voxel_low), np.maximum(high, voxel_high)
        planned = {t.track_id: t for t in memory.planned}
        strayed = tuple(
            t.track_id
            for t in obstacles.tracks
            if t.track_id in planned and has_strayed(planned[t.track_id], t)
        )
        for t in obstacles.tracks:
            if t.track_id in strayed or t.track_id not in planned:
                planned[t.track_id] = t
        kept = tuple(planned[i] for i in sorted(planned) if i in now)
        m = replace(m, tracks=obstacles.tracks, planned=kept)
        change = MapChange(
            stamp_us=obstacles.stamp_us,
            changed_min=low,
            changed_max=high,
            born=tuple(sorted(now - before)),
            died=tuple(sorted(before - now)),
            strayed=strayed,
        )
        return m, self._world_map(m, obstacles.stamp_us), change

    def _static_step(
        self, memory: MapperMemory, statics: tuple[StaticObject, ...], p_WL: Array
    ) -> MapperMemory:
        """Static layers brought up to date."""
        if memory.fine is None:
            column = np.array([p_WL[0], p_WL[1], self.params.exempt_m])
            memory = replace(
                memory,
                fine=self._empty(self._window_origin(p_WL), self._fine_cells(), self.frame.voxel_m),
                coarse=self._empty_coarse(),
                floor_exempt=column,
                version=memory.version + 1,
            )
        assert memory.fine is not None
        new, differing = _by_id(statics), _differing(memory.statics, statics)
        fine, coarse = memory.fine, memory.coarse
        if self._window_left(fine, p_WL):
            cells = np.array(fine.grid.occupied.shape)
            fine = self._empty(self._window_origin(p_WL), cells, self.frame.voxel_m)
            fine = self._redraw(fine, list(new.values()), new)
        elif differing:
            fine = self._redraw(fine, differing, new)
        if coarse is not None and differing:
            coarse = self._redraw(coarse, differing, new)
        version = memory.version + (fine is not memory.fine)
        return replace(memory, fine=fine, coarse=coarse, statics=statics, version=version)

    def _voxel_step(
        self, m: MapperMemory, voxels: StandingVoxels | None
    ) -> tuple[MapperMemory, Array, Array]:
        """Voxels that were seen, where they are news; smallest and largest corner of those [m]."""
        assert m.fine is not None
        nowhere = np.full(3, np.inf), np.full(3, -np.inf)
        old, grid = m.voxels, m.fine.grid
        if voxels is None or (old is not None and old.version == voxels.version):
            return m, *nowhere
        same = voxels.occupied.shape == grid.occupied.shape
        if not same or not np.allclose(voxels.p_WO, grid.p_WO, atol=1e-9):
            raise ValueError("voxels that are seen must be those of the map")
        n = np.array(grid.occupied.shape)
        missed = old is None or voxels.version > old.version + 1
        box = np.array([np.zeros(3, np.int64), n]) if missed else voxels.changed
        if np.any(box[0] >= box[1]):
            return replace(m, voxels=voxels), *nowhere
        occupied, clearance = voxels.occupied.copy(), m.fine.clearance.copy()
        for obj in m.statics:
            mark(occupied, grid.p_WO, grid.voxel_m, obj, box)
        grow = reach_cells(self.shape, self.params.truncation_m, grid.voxel_m)
        region = np.array([np.maximum(box[0] - grow, 0), np.minimum(box[1] + grow, n)])
        update_field(
            clearance, occupied, self.shape, grid.voxel_m, self.params.truncation_m, region
        )
        fine = StaticLayer(OccupancyGrid(occupied, grid.p_WO, grid.voxel_m), clearance)
        corner = grid.p_WO - 0.5 * grid.voxel_m
        low, high = corner + grid.voxel_m * box[0], corner + grid.voxel_m * box[1]
        return replace(m, fine=fine, voxels=voxels, version=m.version + 1), low, high

    def _redraw(
        self, layer: StaticLayer, differing: list[StaticObject], statics: Statics
    ) -> StaticLayer:
        """A layer after some objects came, went or changed: their voxels and the field around."""
        grid, voxel = layer.grid, layer.grid.voxel_m
        occupied, clearance = grid.occupied.copy(), layer.clearance.copy()
        n = np.array(occupied.shape)
        grow = reach_cells(self.shape, self.params.truncation_m, voxel)
        for box in _boxes(differing, grid, n, grow):
            occupied[tuple(slice(a, b) for a, b in box.T)] = False
            for obj in statics.values():
                mark(occupied, grid.p_WO, voxel, obj, box)
        for box in _boxes(differing, grid, n, grow):
            region = np.array([np.maximum(box[0] - grow, 0), np.minimum(box[1] + grow, n)])
            update_field(clearance, occupied, self.shape, voxel, self.params.truncation_m, region)
        return StaticLayer(OccupancyGrid(occupied, grid.p_WO, voxel), clearance)

    def _empty(self, p_WO: Array, cells: IntArray, voxel_m: float) -> StaticLayer:
        occupied = np.zeros(cells, dtype=np.bool_)
        clearance = np.full(cells, self.params.truncation_m, dtype=np.float32)
        return StaticLayer(OccupancyGrid(occupied, p_WO, voxel_m), clearance)

    def _empty_coarse(self) -> StaticLayer | None:
        voxel = self.frame.coarse_voxel_m
        if self.frame.window_m is None or voxel is None:
            return None
        cells = np.ceil(np.array(self.frame.size_m) / voxel - 1e-9).astype(np.int64)
        return self._empty(np.array(self.frame.origin_m) + 0.5 * voxel, cells, voxel)

    def _fine_cells(self) -> IntArray:
        size = np.array(self.frame.window_m or self.frame.size_m)
        return np.ceil(size / self.frame.voxel_m - 1e-9).astype(np.int64)

    def _window_origin(self, p_WL: Array) -> Array:
        """Centre of the first voxel: of the map, or of a window around the load, inside the map.

        Windows sit on whole voxels of the map.
        """
        origin, voxel = np.array(self.frame.origin_m), self.frame.voxel_m
        if self.frame.window_m is None:
            return origin + 0.5 * voxel
        room = np.array(self.frame.size_m) - np.array(self.frame.window_m)
        corner = np.clip(p_WL - 0.5 * np.array(self.frame.window_m) - origin, 0.0, room)
        return np.asarray(origin + voxel * (np.floor(corner / voxel) + 0.5))

    def _window_left(self, fine: StaticLayer, p_WL: Array) -> bool:
        """Whether the window must follow the load."""
        if self.frame.window_m is None:
            return False
        move = np.abs(self._window_origin(p_WL) - fine.grid.p_WO)
        return bool(np.max(move) > self.params.window_shift_m)

    def _world_map(self, m: MapperMemory, stamp_us: TimeUs) -> WorldMap:
        assert m.fine is not None
        return WorldMap(
            stamp_us=stamp_us,
            grid=m.fine.grid,
            static_clearance=m.fine.clearance,
            truncation_m=self.params.truncation_m,
            tracks=m.tracks,
            shape=self.shape,
            version=m.version,
            room_min=np.array(self.room.min_m),
            room_max=np.array(self.room.max_m),
            floor_exempt=m.floor_exempt,
            tube_horizon_s=self.params.tube_horizon_s,
            known_range_m=self.params.known_range_m,
            coarse=m.coarse,
        )


def static_map(
    grid: OccupancyGrid, shape: TeamShape, room: Room | None = None, truncation_m: float = 2.5
) -> WorldMap:
    """M(t) of a given grid, nothing moving: for studies of a planner alone."""
    clearance = np.full(grid.occupied.shape, truncation_m, dtype=np.float32)
    update_field(clearance, grid.occupied, shape, grid.voxel_m, truncation_m)
    reach = 0.5 * grid.voxel_m
    last = grid.p_WO + grid.voxel_m * (np.array(grid.occupied.shape) - 1)
    low = grid.p_WO - reach if room is None else np.array(room.min_m)
    high = last + reach if room is None else np.array(room.max_m)
    return WorldMap(
        stamp_us=0,
        grid=grid,
        static_clearance=clearance,
        truncation_m=truncation_m,
        tracks=(),
        shape=shape,
        version=0,
        room_min=low,
        room_max=high,
    )


def _by_id(statics: tuple[StaticObject, ...]) -> Statics:
    return {o.object_id: o for o in statics}


def _same(a: StaticObject, b: StaticObject | None) -> bool:
    """Whether two reports of an object fill the same voxels."""
    if b is None:
        return False
    return a is b or (
        a.shape == b.shape and np.array_equal(a.p_WO, b.p_WO) and np.array_equal(a.R_WO, b.R_WO)
    )


def _boxes(
    objects: list[StaticObject], grid: OccupancyGrid, n: IntArray, grow: IntArray
) -> list[IntArray]:
    """Ranges of voxels that hold the objects; those whose fields overlap a lot become one."""
    boxes: list[IntArray] = []
    for obj in objects:
        box = cells_of(*shape_extent(obj), grid.p_WO, grid.voxel_m, n)
        if np.any(box[0] >= box[1]):
            continue
        for other in boxes:
            both = np.array([np.minimum(other[0], box[0]), np.maximum(other[1], box[1])])
            if _volume(both, grow) <= _volume(other, grow) + _volume(box, grow):
                other[:] = both
                break
        else:
            boxes.append(box)
    return boxes


def _volume(box: IntArray, grow: IntArray) -> float:
    return float(np.prod(box[1] - box[0] + 2 * grow))


def _differing(old: tuple[StaticObject, ...], new: tuple[StaticObject, ...]) -> list[StaticObject]:
    """Objects that came, went or changed: as they were, then as they are."""
    if old == new:
        return []
    a, b = _by_id(old), _by_id(new)
    gone = [o for i, o in a.items() if not _same(o, b.get(i))]
    return gone + [o for i, o in b.items() if not _same(o, a.get(i))]


def _changed_region(
    old: tuple[StaticObject, ...], new: tuple[StaticObject, ...]
) -> tuple[Array, Array]:
    """Smallest and largest corner of all objects that came, went or changed, (3,) each [m]."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for obj in _differing(old, new):
        first, last = shape_extent(obj)
        low, high = np.minimum(low, first), np.maximum(high, last)
    return low, high
