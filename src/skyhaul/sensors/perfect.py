# SPDX-License-Identifier: Apache-2.0
"""Perfect sensors, for `--perception truth`: exact states, obstacles in reach and in sight."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.geometry.distance import shape_distance
from skyhaul.geometry.shapes import CAPSULE, Shape, ShapeArrays
from skyhaul.jit import njit
from skyhaul.params import Params
from skyhaul.plant.api import Truth
from skyhaul.sensors.api import ObjectReading, ObjectsReading, TeamReading
from skyhaul.types import Array, Mask

_MOVING_MPS = 1e-3


@dataclass(frozen=True, kw_only=True)
class PerfectState(Params):
    """Reads the state of the team as it is."""

    kind: Literal["perfect"] = "perfect"

    def read(self, truth: Truth) -> TeamReading:
        """The state now."""
        return TeamReading(
            stamp_us=truth.stamp_us,
            team=truth.team,
            cables=truth.cables,
            attached=truth.attached,
            thrust=truth.rotor_thrust.sum(axis=1),
        )


class SeenObjects(NamedTuple):
    """Memory of `PerfectObjects`: which obstacles were ever seen, and seen moving."""

    seen: Mask  # (m,)
    moved: Mask  # (m,)


@dataclass(frozen=True, kw_only=True)
class PerfectObjects(Params):
    """Sees every obstacle whose surface is near a vehicle and not hidden by another obstacle."""

    kind: Literal["perfect"] = "perfect"
    range_m: float = 4.0
    """Reach, from a vehicle's centre to the obstacle's surface [m]."""

    def __post_init__(self) -> None:
        if not self.range_m > 0.0:
            raise ValueError(f"range_m must be > 0, got {self.range_m}")

    def init(self, n_obstacles: int) -> SeenObjects:
        """Nothing seen yet."""
        return SeenObjects(np.zeros(n_obstacles, np.bool_), np.zeros(n_obstacles, np.bool_))

    def read(
        self, memory: SeenObjects, truth: Truth, shapes: tuple[Shape, ...]
    ) -> tuple[SeenObjects, ObjectsReading]:
        """What is in reach and in sight now; `shapes` are those of the scenario, in order."""
        o = truth.obstacles
        visible = _visible(truth.team.p_WB, o, truth.present, self.range_m)
        moves = np.linalg.norm(truth.v_WO, axis=1) > _MOVING_MPS
        moved = (memory.moved & memory.seen) | (visible & moves)
        objects = tuple(
            ObjectReading(
                object_id=int(j),
                shape=shapes[j],
                p_WO=o.p_WO[j].copy(),
                R_WO=o.R_WO[j].copy(),
                v_WO=truth.v_WO[j].copy(),
                moves=bool(moved[j]),
            )
            for j in np.flatnonzero(visible)
        )
        return SeenObjects(memory.seen | visible, moved), ObjectsReading(truth.stamp_us, objects)


@njit
def _visible(p_WB: Array, obstacles: ShapeArrays, present: Mask, range_m: float) -> Mask:
    """Which obstacles some vehicle sees: in range, and the line to their centre is free."""
    m = obstacles.kind.shape[0]
    out = np.zeros(m, np.bool_)
    line = ShapeArrays(np.full(1, CAPSULE), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3, 3)))
    for j in range(m):
        if not present[j]:
            continue
        for i in range(p_WB.shape[0]):
            _set_segment(line, p_WB[i], p_WB[i])  # a point
            if shape_distance(line, 0, obstacles, j) > range_m:
                continue
            _set_segment(line, p_WB[i], obstacles.p_WO[j])
            if not _hidden(line, obstacles, present, j):
                out[j] = True
                break
    return out


@njit
def _hidden(line: ShapeArrays, obstacles: ShapeArrays, present: Mask, j: int) -> bool:
    """Whether another obstacle than j cuts the line of sight."""
    for k in range(obstacles.kind.shape[0]):
        if k != j and present[k] and shape_distance(line, 0, obstacles, k) <= 0.0:
            return True
    return False


@njit
def _set_segment(line: ShapeArrays, a: Array, b: Array) -> None:
    """Make row 0 the segment from a to b: a capsule without radius."""
    length = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    line.size[0, 1] = 0.5 * length
    for r in range(3):
        line.p_WO[0, r] = 0.5 * (a[r] + b[r])
        line.R_WO[0, r, 2] = (b[r] - a[r]) / length if length > 0.0 else 0.0
