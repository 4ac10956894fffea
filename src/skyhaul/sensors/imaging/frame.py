# SPDX-License-Identifier: Apache-2.0
"""What a camera sees, before its sensor."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.sensors.imaging.arrays import SKY, Bundle, SceneArrays
from skyhaul.sensors.imaging.atlas import Grey, blank_reading, blank_spots, same_patches
from skyhaul.sensors.imaging.lens import TILE, TILE_H, TILE_W, Lens
from skyhaul.types import Array, IntArray


class Culling(NamedTuple):
    """The balls that this camera can see, b at most, and the parts a tile can see."""

    part: IntArray  # (b,)
    offset: Array  # (b, 3) from the camera, C axes [m]
    tangent: Array  # (b,) length of the tangent from the camera [m]; -1: it is inside
    radius: Array  # (b,) [m]
    seen: IntArray  # (k,) parts


class Frame(NamedTuple):
    """What one camera sees, and room to work; `blank_frame` makes it, `render` fills it."""

    grey: Grey  # (height, width) linear intensity, 1: white in full light
    range: Array  # (height, width) distance along the ray [m]; inf: sky
    object_id: NDArray[np.int16]  # (height, width) index of the object, or SKY
    hit: NDArray[np.int16]  # (height, width) code of the surface, for the kernels
    flow: NDArray[np.float32]  # (height, width, 2) [px/s], filled by `optical_flow` only
    only: NDArray[np.int16]  # (k,) code of the surface that fills a tile, or MIXED, for the kernels
    edge: IntArray  # (TILE // 4, 2) rows and columns of edge pixels of a tile
    tile: Bundle
    culling: Culling


def blank_frame(scene: SceneArrays, lens: Lens) -> Frame:
    """Buffers for one camera in one scene."""
    h, w = lens.height, lens.width
    b, k = len(scene.balls.part), len(scene.parts.kind)
    return Frame(
        grey=np.zeros((h, w), dtype=np.float32),
        range=np.full((h, w), np.inf),
        object_id=np.full((h, w), SKY, dtype=np.int16),
        hit=np.zeros((h, w), dtype=np.int16),
        flow=np.zeros((h, w, 2), dtype=np.float32),
        only=np.zeros(len(lens.corner), dtype=np.int16),
        edge=np.zeros((TILE // 4, 2), dtype=np.int64),
        tile=_blank_bundle(scene),
        culling=Culling(
            np.zeros(b, dtype=np.int64), np.zeros((b, 3)), np.zeros(b), np.zeros(b),
            np.zeros(k, dtype=np.int64),
        ),
    )  # fmt: skip


def _blank_bundle(scene: SceneArrays) -> Bundle:
    atlas, hall = scene.atlas, scene.hall
    return Bundle(
        ray=np.zeros((3, TILE)),
        pixel=np.zeros(TILE),
        range=np.zeros(TILE),
        hit=np.zeros(TILE, dtype=np.int64),
        grey=np.zeros(TILE, dtype=np.float32),
        light=np.zeros(TILE, dtype=np.float32),
        spots=blank_spots(TILE),
        patches=same_patches(atlas, 0, 0.0, TILE),
        grain=same_patches(atlas, hall.detail, hall.detail_per_m, TILE),
        opening=same_patches(atlas, hall.opening, 1.0 / float(hall.period[5]), TILE),
        fine=np.zeros(TILE, dtype=np.float32),
        work=blank_reading(TILE),
    )


def z_depth(lens: Lens, frame: Frame) -> Array:
    """Depth along the optical axis, (height, width) [m]; inf: sky."""
    z = np.zeros((lens.height, lens.width))
    for t, (y, x) in enumerate(lens.corner.tolist()):
        block = lens.rays[t, 2].reshape(TILE_H, TILE_W)
        target = z[y : y + TILE_H, x : x + TILE_W]
        target[:] = block[: target.shape[0], : target.shape[1]]
    depth: Array = frame.range * z
    return depth
