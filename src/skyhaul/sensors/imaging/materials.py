# SPDX-License-Identifier: Apache-2.0
"""Every texture of a scene, and who wears which."""

from dataclasses import dataclass

import numpy as np

from skyhaul.sensors.imaging.atlas import Atlas, build_atlas
from skyhaul.sensors.imaging.hall import ceiling, clouds, floor, grain, openings, wall
from skyhaul.sensors.imaging.plate import plate
from skyhaul.sensors.imaging.wares import ware
from skyhaul.types import Array, IntArray
from skyhaul.world.scenario import Room

POOL = 24
"""Number of textures that obstacles and vehicles share."""
PERIOD_MAX_M = 16.0
"""Walls longer than this repeat [m]."""

_OPENING, _GRAIN, _CLOUDS, _PLATE, _FIRST_WARE = 6, 7, 8, 9, 10


@dataclass(frozen=True, eq=False)
class Materials:
    """Textures and who wears which."""

    atlas: Atlas
    room_faces: IntArray  # (6,)
    room_periods: Array  # (6,) [m]
    opening: int
    detail: int
    clouds: int
    seed: int

    def obstacle_faces(self, j: int) -> IntArray:
        """Textures of the six faces of obstacle j, all different."""
        return self._draw(j, 1)

    def vehicle_faces(self, i: int) -> IntArray:
        """Textures of vehicle i."""
        return self._draw(i, 2)

    def payload_faces(self) -> IntArray:
        """The plate with its tag on top, a crate around."""
        return np.array([*self._draw(0, 3)[:5], _PLATE], dtype=np.int64)

    def plain_faces(self) -> IntArray:
        """Grain only."""
        return np.full(6, self.detail, dtype=np.int64)

    def _draw(self, which: int, family: int) -> IntArray:
        rng = np.random.default_rng([self.seed, family, which])
        return np.asarray(_FIRST_WARE + rng.permutation(POOL)[:6], dtype=np.int64)


def make_materials(room: Room, plate_m: tuple[float, float], seed: int) -> Materials:
    """Paint every texture; the same arguments give the same.

    Args:
        room: The room.
        plate_m: Edges of the load's upper face, x and y [m].
        seed: Draws the textures.
    """
    x, y, z = (min(b - a, PERIOD_MAX_M) for a, b in zip(room.min_m, room.max_m, strict=True))
    edges = [max(y, z)] * 2 + [max(x, z)] * 2 + [max(x, y)] * 2
    rngs = [np.random.default_rng([seed, 0, k]) for k in range(10)]
    textures = [wall(rngs[k], (y, y, x, x)[k], z, edges[k]) for k in range(4)]
    textures += [floor(rngs[4], x, y, edges[4]), ceiling(rngs[5], x, y, edges[5])]
    textures += [openings(rngs[6], x, y, edges[5]), grain(rngs[7]), clouds(rngs[8])]
    textures.append(plate(*plate_m))
    textures += [ware(np.random.default_rng([seed, 4, k]), k) for k in range(POOL)]
    return Materials(
        atlas=build_atlas(textures),
        room_faces=np.arange(6),
        room_periods=np.array(edges),
        opening=_OPENING,
        detail=_GRAIN,
        clouds=_CLOUDS,
        seed=seed,
    )
