# SPDX-License-Identifier: Apache-2.0
"""Everything about a camera that does not change while it flies: rays, their spread, tiles.

The image is cut into tiles of `TILE_W` x `TILE_H` pixels. The rays of a tile lie in a narrow cone,
which tells at once which shapes it can see, whatever the distortion.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.geometry.camera import CameraArrays, CameraModel, pixel_rays, project_jacobian
from skyhaul.jit import njit
from skyhaul.types import Array, IntArray

TILE_W, TILE_H = 16, 8
TILE = TILE_W * TILE_H


class Lens(NamedTuple):
    """Tables of one camera. k tiles, row by row; those at the edge repeat their last pixels."""

    width: int  # [px]
    height: int  # [px]
    rays: Array  # (k, 3, TILE) unit rays, C axes
    pixel: Array  # (k, TILE) angle that a pixel spans, root of its solid angle [rad]
    corner: IntArray  # (k, 2) row and column of the first pixel of a tile
    axis: Array  # (k, 3) middle of the cone of a tile, C axes
    cosine: Array  # (k,) of the half angle of that cone
    sine: Array  # (k,)
    jacobian: NDArray[np.float32]  # (height, width, 2, 3) d(u, v)/d p_C at the unit ray [px]


def make_lens(model: CameraModel) -> Lens:
    """The tables of a camera."""
    w, h = model.size_px
    rays = pixel_rays(model)
    rows, columns = np.arange(0, h, TILE_H), np.arange(0, w, TILE_W)
    corner = np.array([(y, x) for y in rows for x in columns], dtype=np.int64)
    y = np.minimum(corner[:, 0, None] + np.repeat(np.arange(TILE_H), TILE_W), h - 1)
    x = np.minimum(corner[:, 1, None] + np.tile(np.arange(TILE_W), TILE_H), w - 1)
    tiles = rays[y, x]  # (k, TILE, 3)
    axis = tiles.mean(axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    pixel = _pixel_angles(rays)[y, x]
    # a pixel reaches half its diagonal beyond its centre
    half = np.arccos(np.clip(np.einsum("kic,kc->ki", tiles, axis), -1.0, 1.0)).max(axis=1)
    half = np.minimum(half + 0.75 * pixel.max(axis=1), np.pi)
    return Lens(
        width=w,
        height=h,
        rays=np.ascontiguousarray(np.swapaxes(tiles, 1, 2)),
        pixel=np.ascontiguousarray(pixel),
        corner=corner,
        axis=np.ascontiguousarray(axis),
        cosine=np.cos(half),
        sine=np.sin(half),
        jacobian=_jacobians(model, rays),
    )


def _pixel_angles(rays: Array) -> Array:
    """Root of the solid angle of every pixel, (h, w) [rad]."""
    across, down = np.gradient(rays, axis=1), np.gradient(rays, axis=0)
    angles: Array = np.sqrt(np.linalg.norm(np.cross(across, down), axis=2))
    return angles


def _jacobians(model: CameraModel, rays: Array) -> NDArray[np.float32]:
    out = np.empty((*rays.shape[:2], 2, 3), dtype=np.float32)
    camera = model.arrays()
    _fill_jacobians(camera, rays, out)
    return out


@njit
def _fill_jacobians(camera: CameraArrays, rays: Array, out: NDArray[np.float32]) -> None:
    J = np.empty((2, 3))
    for y in range(rays.shape[0]):
        for x in range(rays.shape[1]):
            project_jacobian(camera, rays[y, x, 0], rays[y, x, 1], rays[y, x, 2], J)
            out[y, x] = J
