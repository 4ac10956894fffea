# SPDX-License-Identifier: Apache-2.0
"""Clusters of mover events: dense cells of a grid that touch, without comparing points."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, label, uniform_filter

from skyhaul.params import Params
from skyhaul.perception.events.lens import EventLens
from skyhaul.sensors.api import EventReading
from skyhaul.types import US_PER_S, Array, IntArray, TimeUs, frozen


@dataclass(frozen=True, eq=False)
class Clusters:
    """What moves in one image, one row per cluster."""

    stamp_us: TimeUs
    middle: Array  # (k, 2) of the boxes [px]
    half_size: Array  # (k, 2) half their width and height [px]
    count: IntArray  # (k,) events that made the box
    age_s: Array  # (k,) how long before the stamp they were, the mean [s]
    dir_C: Array  # (k, 3) unit rays through the middles
    half_angle_rad: Array  # (k,) half the angle that a ball of that size fills

    def __post_init__(self) -> None:
        frozen(self.middle, self.half_size, self.count, self.age_s, self.dir_C)
        frozen(self.half_angle_rad)


@dataclass(frozen=True, kw_only=True)
class ClusterRules(Params):
    """What is dense, and what is one."""

    cell_px: int = 4
    """Edge of the grid's cells [px]."""
    dense_count: float = 4.0
    """Events in a cell and the eight around it that make it dense."""
    join_cells: int = 1
    """Dense cells join across a gap of twice as many cells."""
    min_events: int = 15
    """A cluster has no fewer events than this."""
    newest: int | None = None
    """A box is that of so many of its newest events; null: of all."""
    trim: float = 0.01
    """Share of its events that a box leaves out at each side."""
    margin: float = 0.1
    """What a box is grown by at each side, as a share of it: its faint edges are no movers."""
    edge_px: float = 0.5
    """What a box is grown by besides [px]: half a pixel, its events being those of whole pixels."""
    largest: float = 0.5
    """A cluster whose box is larger than this share of the image is no obstacle."""

    def __post_init__(self) -> None:
        for name in ("cell_px", "dense_count", "min_events", "largest"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if self.newest is not None and self.newest < self.min_events:
            raise ValueError(f"newest must be >= min_events, got {self.newest}")
        if self.join_cells < 0:
            raise ValueError(f"join_cells must be >= 0, got {self.join_cells}")
        for name in ("margin", "edge_px"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")
        if not 0.0 <= self.trim < 0.5:
            raise ValueError(f"trim must lie in [0, 0.5), got {self.trim}")

    def find(self, lens: EventLens, movers: EventReading, stamp_us: TimeUs) -> Clusters:
        """Clusters of mover events, the largest first."""
        names = self.labels(lens, movers)
        boxes, counts, ages = [], [], []
        for name in range(1, int(names.max(initial=0)) + 1):
            mine = np.flatnonzero(names == name)
            if len(mine) >= self.min_events:
                mine = mine[-self.newest :] if self.newest is not None else mine
                sides = (self.trim, 1.0 - self.trim)
                x0, x1 = np.quantile(movers.x[mine], sides)
                y0, y1 = np.quantile(movers.y[mine], sides)
                if (x1 - x0) * (y1 - y0) <= self.largest * lens.width * lens.height:
                    boxes.append((x0, y0, x1, y1))
                    counts.append(len(mine))
                    ages.append((stamp_us - float(movers.t_us[mine].mean())) / US_PER_S)
        order = np.argsort(-np.array(counts, dtype=np.int64), kind="stable")
        box = np.array(boxes, dtype=np.float64).reshape(-1, 4)[order]
        count = np.array(counts, dtype=np.int64)[order]
        age_s = np.array(ages, dtype=np.float64)[order]
        middle = 0.5 * (box[:, :2] + box[:, 2:])
        half = (0.5 + self.margin) * (box[:, 2:] - box[:, :2]) + self.edge_px
        half = np.maximum(half, 0.5)
        dir_C, half_angle = directions(lens, middle, half)
        return Clusters(stamp_us, middle, half, count, age_s, dir_C, half_angle)

    def labels(self, lens: EventLens, movers: EventReading) -> IntArray:
        """Number of each event's cluster from 1 on, 0 for none, (k,)."""
        shape = (-(-lens.height // self.cell_px), -(-lens.width // self.cell_px))
        row, col = movers.y // self.cell_px, movers.x // self.cell_px
        flat = row.astype(np.int64) * shape[1] + col
        count = np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)
        around = uniform_filter(count, 3, mode="constant") * 9.0
        dense = (count > 0) & (around >= self.dense_count - 1e-6)
        near = (
            binary_dilation(dense, np.ones((3, 3), dtype=bool), self.join_cells)
            if self.join_cells
            else dense
        )
        names, _ = label(near, np.ones((3, 3)))
        found: IntArray = np.where(dense, names, 0).ravel()[flat].astype(np.int64)
        return found


def directions(lens: EventLens, middle: Array, half_size: Array) -> tuple[Array, Array]:
    """Rays (k, 3) through places in the image, and half angles (k,) of boxes around them.

    The half angle is that of a ball whose image has the box's area: the geometric mean of the
    box's two half angles.
    """
    dir_C = _rays(lens, middle)
    halves = np.ones(len(middle))
    for axis in range(2):
        side = np.zeros((len(middle), 2))
        side[:, axis] = half_size[:, axis]
        a, b = _rays(lens, middle - side), _rays(lens, middle + side)
        halves *= 0.5 * np.arccos(np.clip(np.sum(a * b, axis=1), -1.0, 1.0))
    return dir_C, np.sqrt(halves)


def _rays(lens: EventLens, uv: Array) -> Array:
    """Rays of the nearest pixels' table, interpolated, (k, 3); at the border the border's."""
    u = np.clip(uv[:, 0], 0.0, lens.width - 1.001)
    v = np.clip(uv[:, 1], 0.0, lens.height - 1.001)
    x, y = u.astype(np.int64), v.astype(np.int64)
    a, b = (u - x)[:, None], (v - y)[:, None]
    r = lens.rays_C
    top = (1.0 - a) * r[y, x] + a * r[y, x + 1]
    bottom = (1.0 - a) * r[y + 1, x] + a * r[y + 1, x + 1]
    ray = (1.0 - b) * top + b * bottom
    unit: Array = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    return unit
