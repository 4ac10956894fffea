# SPDX-License-Identifier: Apache-2.0
"""Cables: capsules thinner than a pixel, blended by the share of each pixel that they cover."""

import math

from skyhaul.geometry.kernels import cross
from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import SceneArrays
from skyhaul.sensors.imaging.frame import Frame
from skyhaul.sensors.imaging.intersect import capsule_axis, capsule_range
from skyhaul.sensors.imaging.lens import TILE, TILE_W, Lens
from skyhaul.types import Array


@njit_ieee
def draw_thread(scene: SceneArrays, lens: Lens, t: int, k: int, p: Array, frame: Frame) -> None:
    """Blend thread k over tile t by the share of each pixel's area that it covers.

    So the light that a thread takes does not depend on where between the pixels it runs. It gives
    its id and range to the pixels whose centres it passes within half a pixel, however thin it is.
    """
    y0, x0 = lens.corner[t, 0], lens.corner[t, 1]
    q, a, r, half = capsule_axis(scene.parts, k, p)
    (a0, a1, a2), (x, y, z) = a, q
    lit, name, ray = scene.parts.gain[k], scene.parts.object[k], frame.tile.ray
    out_grey, out_range, out_id = frame.grey, frame.range, frame.object_id
    height, width = out_grey.shape
    oa = x * a0 + y * a1 + z * a2
    # Camera and axis span a plane. A ray passes the axis at least as far off as it leaves the
    # plane, so most rays are told apart by one product.
    n0, n1, n2 = cross((x, y, z), a)
    off = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    least = math.hypot(off, max(abs(oa) - half, 0.0))
    reach = r / least if least > r and off > 0.0 else math.inf
    scale = 1.0 / max(off, 1e-12)
    p0, p1, p2 = scale * n0, scale * n1, scale * n2
    for i in range(TILE):
        row, column = y0 + i // TILE_W, x0 + i % TILE_W
        if row >= height or column >= width:
            continue
        d0, d1, d2 = ray[0, i], ray[1, i], ray[2, i]
        if abs(d0 * p0 + d1 * p1 + d2 * p2) > reach + 2.0 * lens.pixel[t, i]:
            continue
        da = d0 * a0 + d1 * a1 + d2 * a2
        od = x * d0 + y * d1 + z * d2
        A = max(1.0 - da * da, 1e-12)
        along = min(max(oa + da * (oa * da - od) / A, -half), half)
        # from the camera to the point of the axis that is nearest to the ray
        e0, e1, e2 = along * a0 - x, along * a1 - y, along * a2 - z
        far = e0 * d0 + e1 * d1 + e2 * d2
        if far <= 0.0 or far >= out_range[row, column]:
            continue
        miss = math.sqrt(max(e0 * e0 + e1 * e1 + e2 * e2 - far * far, 0.0))
        if miss > r + 2.0 * far * lens.pixel[t, i]:
            continue
        # how fast the miss grows per pixel along the row and down the column
        n0, n1, n2 = cross((d0, d1, d2), a)
        i_x = i + 1 if i % TILE_W + 1 < TILE_W and column + 1 < width else i - 1
        i_y = i + TILE_W if i + TILE_W < TILE and row + 1 < height else i - TILE_W
        u = n0 * (ray[0, i_x] - d0) + n1 * (ray[1, i_x] - d1) + n2 * (ray[2, i_x] - d2)
        v = n0 * (ray[0, i_y] - d0) + n1 * (ray[1, i_y] - d1) + n2 * (ray[2, i_y] - d2)
        slope = max(math.hypot(u, v), 1e-12)
        wide = far * slope / math.sqrt(A)
        c, s = abs(u) / slope, abs(v) / slope
        share = _area(c, s, (miss + r) / wide) - _area(c, s, (miss - r) / wide)
        if share <= 0.0:
            continue
        out_grey[row, column] += share * (lit - out_grey[row, column])
        if miss < max(r, 0.5 * wide):
            exact = capsule_range(q, a, r, half, d0, d1, d2)
            out_range[row, column] = min(exact, far)
            out_id[row, column] = name


@njit_ieee
def _area(c: float, s: float, x: float) -> float:
    """Share of a unit square on the near side of a line at signed distance x from its centre.

    (c, s) is the line's normal, both >= 0.
    """
    reach, flat = 0.5 * (c + s), 0.5 * abs(c - s)
    if x <= -reach:
        return 0.0
    if x >= reach:
        return 1.0
    if x < -flat:
        return (x + reach) ** 2 / (2.0 * c * s)
    if x <= flat:
        return 0.5 + x / max(c, s)
    return 1.0 - (reach - x) ** 2 / (2.0 * c * s)
