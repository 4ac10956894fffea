# SPDX-License-Identifier: Apache-2.0
"""Antialiasing: pixels at the rims of surfaces are looked at with four rays instead of one."""

import math

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import MIXED
from skyhaul.sensors.imaging.frame import Frame
from skyhaul.sensors.imaging.lens import TILE, TILE_H, TILE_W, Lens
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"

_MOST = TILE // 4
"""Edge pixels that a tile may have; those beyond keep their one ray."""


@njit_ieee
def aim_at_edges(lens: Lens, t: int, R: Array, frame: Frame) -> int:
    """Fill the bundle with four rays through each edge pixel of tile t; how many such pixels.

    The four lie on a turned square, so that no two share a row or a column of the pixel.
    """
    hit, edge, rays, out = frame.hit, frame.edge, lens.rays[t], frame.tile.ray
    y0, x0, count = lens.corner[t, 0], lens.corner[t, 1], 0
    height, width = hit.shape
    rows, columns = min(TILE_H, height - y0), min(TILE_W, width - x0)
    if _is_plain_around(lens, t, frame.only):
        return 0
    for y in range(rows):
        v = y0 + y
        above, below = max(v - 1, 0), min(v + 1, height - 1)
        for x in range(columns):
            u = x0 + x
            left, right, here = max(u - 1, 0), min(u + 1, width - 1), hit[v, u]
            inner = hit[v, left] == here and hit[v, right] == here
            if inner and hit[above, u] == here and hit[below, u] == here:
                continue
            if count < _MOST:
                edge[count, 0], edge[count, 1] = v, u
                i = y * TILE_W + x
                i_x = i + 1 if x + 1 < columns else i - 1
                i_y = i + TILE_W if y + 1 < rows else i - TILE_W
                _aim_four(rays, i, i_x, i_y, R, 4 * count, out)
                for s in range(4):
                    frame.tile.pixel[4 * count + s] = lens.pixel[t, i]
                count += 1
    return count


@njit_ieee
def _is_plain_around(lens: Lens, t: int, only: NDArray[np.int16]) -> bool:
    """Whether one surface fills a tile and the four beside it."""
    here, wide = only[t], (lens.width + TILE_W - 1) // TILE_W
    column, last = t % wide, only.shape[0] - 1
    left, right = t - min(column, 1), t + min(wide - 1 - column, 1)
    above, below = (t - wide if t >= wide else t), (t + wide if t + wide <= last else t)
    around = only[left] == here and only[right] == here
    return around and only[above] == here and only[below] == here and here != MIXED


@njit_ieee
def average_edges(edges: int, frame: Frame) -> None:
    """Give edge pixels the mean of their four rays."""
    out, edge, grey = frame.grey, frame.edge, frame.tile.grey
    for e in range(edges):
        mean = 0.25 * (grey[4 * e] + grey[4 * e + 1] + grey[4 * e + 2] + grey[4 * e + 3])
        out[edge[e, 0], edge[e, 1]] = mean


@njit_ieee
def _aim_four(rays: Array, i: int, i_x: int, i_y: int, R: Array, first: int, out: Array) -> None:
    """Four rays around ray i; i_x and i_y are its neighbours along rows and columns."""
    a, b = 0.125, 0.375
    for s in range(4):  # (1, 3), (3, -1), (-1, -3), (-3, 1) eighths of a pixel
        x = rays[0, i] + a * (rays[0, i_x] - rays[0, i]) + b * (rays[0, i_y] - rays[0, i])
        y = rays[1, i] + a * (rays[1, i_x] - rays[1, i]) + b * (rays[1, i_y] - rays[1, i])
        z = rays[2, i] + a * (rays[2, i_x] - rays[2, i]) + b * (rays[2, i_y] - rays[2, i])
        scale = 1.0 / math.sqrt(x * x + y * y + z * z)
        for c in range(3):
            out[c, first + s] = scale * (R[c, 0] * x + R[c, 1] * y + R[c, 2] * z)
        a, b = b, -a
