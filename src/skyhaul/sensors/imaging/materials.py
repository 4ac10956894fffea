# SPDX-License-Identifier: Apache-2.0
"""Textures of the hall and of what is in it."""

from dataclasses import dataclass

import cv2
import numpy as np

from skyhaul.sensors.imaging.atlas import Atlas, Grey, build_atlas
from skyhaul.types import Array, IntArray
from skyhaul.world.scenario import Room

POOL = 24
"""Number of textures that obstacles share."""


@dataclass(frozen=True, eq=False)
class Materials:
    """Textures and who wears which."""

    atlas: Atlas
    room_faces: IntArray  # (6,)
    room_periods: Array  # (6,) [m]
    opening: int
    detail: int
    clouds: int
    tag: int
    pool: int  # first of the POOL textures of obstacles
    seed: int

    def obstacle_faces(self, j: int) -> IntArray:
        """Textures of the six faces of obstacle j."""
        rng = np.random.default_rng([self.seed, j, 1])
        return self.pool + rng.permutation(POOL)[:6]

    def vehicle_faces(self, i: int) -> IntArray:
        """Textures of vehicle i."""
        return self.pool + np.random.default_rng([self.seed, i, 2]).permutation(POOL)[:6]

    def payload_faces(self) -> IntArray:
        """The tag on top, plain sides."""
        return np.array([self.detail] * 5 + [self.tag], dtype=np.int64)

    def plain_faces(self) -> IntArray:
        """Grain only."""
        return np.full(6, self.detail, dtype=np.int64)


def make_materials(room: Room, objects: int, seed: int) -> Materials:
    """Draw every texture."""
    rng = np.random.default_rng([seed, 0])
    textures = [_rich(rng, 1024) for _ in range(6)]
    textures += [np.zeros((64, 64), np.float32), _noise(rng, 256), _noise(rng, 512), _tag()]
    textures += [_rich(rng, 256) for _ in range(POOL)]
    return Materials(
        atlas=build_atlas(textures),
        room_faces=np.arange(6),
        room_periods=np.full(6, 16.0),
        opening=6,
        detail=7,
        clouds=8,
        tag=9,
        pool=10,
        seed=seed,
    )


def _noise(rng: np.random.Generator, n: int) -> Grey:
    image = np.zeros((n, n), np.float32)
    for octave, weight in ((4, 0.35), (8, 0.3), (16, 0.25), (32, 0.2), (64, 0.15)):
        cells = rng.random((octave, octave), dtype=np.float32)
        image += weight * cv2.resize(cells, (n, n), interpolation=cv2.INTER_CUBIC)
    low, high = float(image.min()), float(image.max())
    return np.asarray((image - low) / (high - low), dtype=np.float32)


def _rich(rng: np.random.Generator, n: int) -> Grey:
    image = 0.2 + 0.5 * _noise(rng, n)
    for _ in range(60 * n // 256):
        grey = float(rng.uniform(0.1, 0.95))
        p = rng.integers(0, n, 2)
        q = p + rng.integers(6, 40, 2)
        cv2.rectangle(image, p.tolist(), q.tolist(), grey, -1)
    return image


def _tag() -> Grey:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_16h5)
    marker = cv2.aruco.generateImageMarker(dictionary, 0, 192)
    image = np.full((256, 256), 255, np.uint8)
    image[32:224, 32:224] = marker
    return np.asarray(image / 255.0 * 0.85 + 0.05, dtype=np.float32)
