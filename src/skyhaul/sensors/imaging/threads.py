# SPDX-License-Identifier: Apache-2.0
"""Cables: capsules thinner than a pixel, blended by the share of each pixel that they cover."""

import math

from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import SceneArrays
from skyhaul.sensors.imaging.frame import Frame
from skyhaul.sensors.imaging.intersect import capsule_axis, capsule_range
from skyhaul.sensors.imaging.lens import TILE, TILE_W, Lens
from skyhaul.types import Array


@njit_ieee
def draw_thread(scene: SceneArrays, lens: Lens, t: int, k: int, p: Array, frame: Frame) -> None:
    """Blend thread k over tile t by the share of each pixel that it covers.

    The share is that of a band of the pixel's width across the thread, so the light that a thread
    takes does not depend on where between the pixels it runs. It gives its id and range to the
    pixels whose centres it passes within half a pixel, however thin it is.
    """
    y0, x0 = lens.corner[t, 0], lens.corner[t, 1]
    q, a, r, half = capsule_axis(scene.parts, k, p)
    (a0, a1, a2), (x, y, z) = a, q
    lit, name, ray, pixel = (
        scene.parts.gain[k],
        scene.parts.object[k],
        frame.tile.ray,
        lens.pixel[t],
    )
    out_grey, out_range, out_id = frame.grey, frame.range, frame.object_id
    height, width = out_grey.shape
    oa = x * a0 + y * a1 + z * a2
    for i in range(TILE):
        row, column = y0 + i // TILE_W, x0 + i % TILE_W
        if row >= height or column >= width:
            continue
        d0, d1, d2 = ray[0, i], ray[1, i], ray[2, i]
        da = d0 * a0 + d1 * a1 + d2 * a2
        od = x * d0 + y * d1 + z * d2
        A = max(1.0 - da * da, 1e-12)
        along = min(max(oa + da * (oa * da - od) / A, -half), half)
        # from the point of the axis that is nearest to the ray
        e0, e1, e2 = along * a0 - x, along * a1 - y, along * a2 - z
        far = e0 * d0 + e1 * d1 + e2 * d2
        if far <= 0.0 or far >= out_range[row, column]:
            continue
        miss = math.sqrt(max(e0 * e0 + e1 * e1 + e2 * e2 - far * far, 0.0))
        wide = far * pixel[i]
        share = (min(r, miss + 0.5 * wide) - max(-r, miss - 0.5 * wide)) / wide
        if share <= 0.0:
            continue
        grey = out_grey[row, column]
        out_grey[row, column] = grey + min(share, 1.0) * (lit - grey)
        if miss < max(r, 0.5 * wide):
            exact = capsule_range(q, a, r, half, d0, d1, d2)
            out_range[row, column] = min(exact, far)
            out_id[row, column] = name
