# SPDX-License-Identifier: Apache-2.0
"""The ray caster: one ray through the centre of every pixel, tile by tile.

The room is met by every ray; which parts a tile can see is told by the cone of its rays and the
balls around the parts. Distances are along the ray (`Frame.range`, float64); `z_depth` turns them
into depth along the optical axis.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.geometry.kernels import mat_t_vec
from skyhaul.geometry.shapes import BOX, SPHERE
from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import SKY, THREAD, Bundle, Hall, Parts, SceneArrays
from skyhaul.sensors.imaging.atlas import Grey
from skyhaul.sensors.imaging.lens import TILE, TILE_H, TILE_W, Lens
from skyhaul.sensors.imaging.shading import shade_face, shade_part, shade_sky
from skyhaul.types import Array, IntArray

_ROOM = 6
"""Codes of hits below this are faces of the room; parts follow."""


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
    flow: NDArray[np.float32]  # (height, width, 2) [px/s], filled by `optical_flow` only
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
        flow=np.zeros((h, w, 2), dtype=np.float32),
        tile=Bundle(
            np.zeros((3, TILE)), np.zeros(TILE), np.zeros(TILE),
            np.zeros(TILE, dtype=np.int64), np.zeros(TILE),
        ),
        culling=Culling(
            np.zeros(b, dtype=np.int64), np.zeros((b, 3)), np.zeros(b), np.zeros(b),
            np.zeros(k, dtype=np.int64),
        ),
    )  # fmt: skip


def z_depth(lens: Lens, frame: Frame) -> Array:
    """Depth along the optical axis, (height, width) [m]; inf: sky."""
    z = np.zeros((lens.height, lens.width))
    for t, (y, x) in enumerate(lens.corner.tolist()):
        block = lens.rays[t, 2].reshape(TILE_H, TILE_W)
        target = z[y : y + TILE_H, x : x + TILE_W]
        target[:] = block[: target.shape[0], : target.shape[1]]
    depth: Array = frame.range * z
    return depth


@njit_ieee
def render(
    scene: SceneArrays, lens: Lens, p_WC: Array, R_WC: Array, own: int, frame: Frame
) -> None:
    """Fill `grey`, `range` and `object_id` of a frame.

    Args:
        scene: Posed.
        lens: Of the camera.
        p_WC: Where the camera is, (3,) [m].
        R_WC: Its axes, x right, y down, z forward, (3, 3).
        own: Object that the camera does not see, its own vehicle; `NOBODY`: sees all.
        frame: Written.
    """
    count = _cull(scene, p_WC, R_WC, own, frame.culling)
    for t in range(lens.corner.shape[0]):
        _aim(lens, t, R_WC, frame.tile)
        _meet_room(scene.hall, p_WC, frame.tile)
        parts = _seen(lens, t, count, frame.culling)
        for i in range(parts):
            k = frame.culling.seen[i]
            if scene.parts.kind[k] == BOX:
                _meet_box(scene.parts, k, p_WC, frame.tile)
            elif scene.parts.kind[k] == SPHERE:
                _meet_sphere(scene.parts, k, p_WC, frame.tile)
            elif scene.parts.kind[k] != THREAD:
                _meet_capsule(scene.parts, k, p_WC, frame.tile)
        _shade(scene, parts, p_WC, frame)
        _write(scene.parts, lens, t, frame)
        for i in range(parts):
            k = frame.culling.seen[i]
            if scene.parts.kind[k] == THREAD:
                _draw_thread(scene, lens, t, k, p_WC, frame)


@njit_ieee
def _cull(scene: SceneArrays, p_WC: Array, R_WC: Array, own: int, culling: Culling) -> int:
    """Balls of objects that are there, in C axes; how many."""
    count, balls = 0, scene.balls
    for b in range(balls.part.shape[0]):
        k = balls.part[b]
        o = scene.parts.object[k]
        if o == own or not scene.objects.present[o]:
            continue
        p = balls.p_W[b]
        offset = mat_t_vec(R_WC, (p[0] - p_WC[0], p[1] - p_WC[1], p[2] - p_WC[2]))
        r = balls.radius[b]
        square = offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2 - r * r
        culling.part[count], culling.radius[count] = k, r
        culling.offset[count, 0], culling.offset[count, 1], culling.offset[count, 2] = offset
        culling.tangent[count] = math.sqrt(square) if square > 0.0 else -1.0
        count += 1
    return count


@njit_ieee
def _seen(lens: Lens, t: int, count: int, culling: Culling) -> int:
    """Parts whose balls reach into the cone of tile t; how many."""
    a0, a1, a2 = lens.axis[t, 0], lens.axis[t, 1], lens.axis[t, 2]
    cosine, sine = lens.cosine[t], lens.sine[t]
    found, last = 0, -1
    for b in range(count):
        along = a0 * culling.offset[b, 0] + a1 * culling.offset[b, 1] + a2 * culling.offset[b, 2]
        tangent = culling.tangent[b]
        if tangent < 0.0 or along >= tangent * cosine - culling.radius[b] * sine:
            k = culling.part[b]
            if k != last:
                culling.seen[found] = k
                found += 1
                last = k
    return found


@njit_ieee
def _aim(lens: Lens, t: int, R: Array, tile: Bundle) -> None:
    """Rays of tile t in W axes."""
    rays, out = lens.rays[t], tile.ray
    tile.pixel[:] = lens.pixel[t]
    for i in range(TILE):
        x, y, z = rays[0, i], rays[1, i], rays[2, i]
        out[0, i] = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
        out[1, i] = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
        out[2, i] = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z


@njit_ieee
def _meet_room(hall: Hall, p: Array, tile: Bundle) -> None:
    """Where rays leave the room; a camera outside looks through the near walls."""
    l0, l1, l2 = hall.low[0] - p[0], hall.low[1] - p[1], hall.low[2] - p[2]
    h0, h1, h2 = hall.high[0] - p[0], hall.high[1] - p[1], hall.high[2] - p[2]
    inside = max(l0, l1, l2) <= 0.0 and min(h0, h1, h2) >= 0.0
    for i in range(TILE):
        d0, d1, d2 = tile.ray[0, i], tile.ray[1, i], tile.ray[2, i]
        t0 = (h0 if d0 > 0.0 else l0) / d0
        t1 = (h1 if d1 > 0.0 else l1) / d1
        t2 = (h2 if d2 > 0.0 else l2) / d2
        leave = min(t0, min(t1, t2))
        tile.range[i] = leave
        face = 4 + (d2 > 0.0)
        if t2 > leave:
            face = 0 + (d0 > 0.0) if t0 == leave else 2 + (d1 > 0.0)
        tile.hit[i] = face
    if inside:
        return
    for i in range(TILE):
        d0, d1, d2 = tile.ray[0, i], tile.ray[1, i], tile.ray[2, i]
        enter = max((l0 if d0 > 0.0 else h0) / d0, (l1 if d1 > 0.0 else h1) / d1)
        enter = max(enter, (l2 if d2 > 0.0 else h2) / d2)
        if enter > tile.range[i] or tile.range[i] <= 0.0:
            tile.range[i], tile.hit[i] = np.inf, -1


@njit_ieee
def _meet_sphere(parts: Parts, k: int, p: Array, tile: Bundle) -> None:
    c, r = parts.p_WP[k], parts.size[k, 0]
    x, y, z = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    power = x * x + y * y + z * z - r * r
    for i in range(TILE):
        b = x * tile.ray[0, i] + y * tile.ray[1, i] + z * tile.ray[2, i]
        square = b * b - power
        if square < 0.0:
            continue
        t = b - math.sqrt(square)
        if 0.0 < t < tile.range[i]:
            tile.range[i], tile.hit[i] = t, _ROOM + k


@njit_ieee
def _meet_box(parts: Parts, k: int, p: Array, tile: Bundle) -> None:
    R, c, s = parts.R_WP[k], parts.p_WP[k], parts.size[k]
    x, y, z = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    q0, q1, q2 = mat_t_vec(R, (x, y, z))
    R00, R01, R02 = R[0, 0], R[0, 1], R[0, 2]
    R10, R11, R12 = R[1, 0], R[1, 1], R[1, 2]
    R20, R21, R22 = R[2, 0], R[2, 1], R[2, 2]
    s0, s1, s2 = s[0], s[1], s[2]
    for i in range(TILE):
        d0, d1, d2 = tile.ray[0, i], tile.ray[1, i], tile.ray[2, i]
        # slabs: with m = 1 / d, the ray is inside for t in -m q -+ |m| s
        m = 1.0 / (R00 * d0 + R10 * d1 + R20 * d2)
        n, w = -m * q0, abs(m) * s0
        near, far = n - w, n + w
        m = 1.0 / (R01 * d0 + R11 * d1 + R21 * d2)
        n, w = -m * q1, abs(m) * s1
        near, far = max(near, n - w), min(far, n + w)
        m = 1.0 / (R02 * d0 + R12 * d1 + R22 * d2)
        n, w = -m * q2, abs(m) * s2
        near, far = max(near, n - w), min(far, n + w)
        if 0.0 < near <= far and near < tile.range[i]:
            tile.range[i], tile.hit[i] = near, _ROOM + k


@njit_ieee
def _meet_capsule(parts: Parts, k: int, p: Array, tile: Bundle) -> None:
    for i in range(TILE):
        t = _capsule_range(parts, k, p, tile.ray[0, i], tile.ray[1, i], tile.ray[2, i])
        if t < tile.range[i]:
            tile.range[i], tile.hit[i] = t, _ROOM + k


@njit_ieee
def _capsule_range(parts: Parts, k: int, p: Array, d0: float, d1: float, d2: float) -> float:
    """Distance along a ray to capsule k [m]; inf: it misses."""
    R, c = parts.R_WP[k], parts.p_WP[k]
    r, half = parts.size[k, 0], parts.size[k, 1]
    a0, a1, a2 = R[0, 2], R[1, 2], R[2, 2]
    x, y, z = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    da = d0 * a0 + d1 * a1 + d2 * a2
    oa = x * a0 + y * a1 + z * a2
    od = x * d0 + y * d1 + z * d2
    A, B = 1.0 - da * da, od - oa * da
    square = B * B - A * (x * x + y * y + z * z - oa * oa - r * r)
    if square < 0.0:
        return np.inf
    along = oa
    if A > 1e-12:
        t = (-B - math.sqrt(square)) / A
        along = oa + t * da
        if abs(along) <= half:
            return t if t > 0.0 else np.inf
    elif da > 0.0:
        along = -1.0
    end = math.copysign(half, along)
    x, y, z = x - end * a0, y - end * a1, z - end * a2
    b = x * d0 + y * d1 + z * d2
    square = b * b - (x * x + y * y + z * z - r * r)
    t = -b - math.sqrt(square) if square >= 0.0 else np.inf
    return t if t > 0.0 else np.inf


@njit_ieee
def _shade(scene: SceneArrays, parts: int, p: Array, frame: Frame) -> None:
    """Give every ray of a tile its grey."""
    tile, faces, solid, nothing = frame.tile, 0, False, False
    for i in range(TILE):
        hit = tile.hit[i]
        if hit >= _ROOM:
            solid = True
        elif hit >= 0:
            faces |= 1 << hit
        else:
            nothing = True
    if nothing:
        shade_sky(scene.hall, scene.atlas, tile)
    for face in range(_ROOM):
        if faces >> face & 1:
            shade_face(scene.hall, scene.atlas, face, p, tile)
    if solid:
        for i in range(parts):
            k = frame.culling.seen[i]
            shade_part(scene.parts, scene.atlas, scene.sun, k, _ROOM + k, p, tile)


@njit_ieee
def _write(parts: Parts, lens: Lens, t: int, frame: Frame) -> None:
    """Copy a tile into the frame."""
    tile, y0, x0 = frame.tile, lens.corner[t, 0], lens.corner[t, 1]
    rows, columns = min(TILE_H, lens.height - y0), min(TILE_W, lens.width - x0)
    for y in range(rows):
        for x in range(columns):
            i = y * TILE_W + x
            hit = tile.hit[i]
            frame.grey[y0 + y, x0 + x] = tile.grey[i]
            frame.range[y0 + y, x0 + x] = tile.range[i]
            if hit >= _ROOM:
                hit = parts.object[hit - _ROOM]
            frame.object_id[y0 + y, x0 + x] = hit if hit >= 0 else SKY


@njit_ieee
def _draw_thread(scene: SceneArrays, lens: Lens, t: int, k: int, p: Array, frame: Frame) -> None:
    """Blend thread k over tile t by the share of each pixel that it covers.

    The share is that of a band of the pixel's width across the thread, so the light that a thread
    takes does not depend on where between the pixels it runs. It gives its id and range to the
    pixels whose centres it passes within half a pixel, however thin it is.
    """
    parts, tile = scene.parts, frame.tile
    y0, x0 = lens.corner[t, 0], lens.corner[t, 1]
    R, c = parts.R_WP[k], parts.p_WP[k]
    r, half = parts.size[k, 0], parts.size[k, 1]
    a0, a1, a2 = R[0, 2], R[1, 2], R[2, 2]
    x, y, z = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    oa = x * a0 + y * a1 + z * a2
    for i in range(TILE):
        row, column = y0 + i // TILE_W, x0 + i % TILE_W
        if row >= lens.height or column >= lens.width:
            continue
        d0, d1, d2 = tile.ray[0, i], tile.ray[1, i], tile.ray[2, i]
        da = d0 * a0 + d1 * a1 + d2 * a2
        od = x * d0 + y * d1 + z * d2
        A = max(1.0 - da * da, 1e-12)
        along = min(max(oa + da * (oa * da - od) / A, -half), half)
        # from the point of the axis that is nearest to the ray
        e0, e1, e2 = along * a0 - x, along * a1 - y, along * a2 - z
        far = e0 * d0 + e1 * d1 + e2 * d2
        if far <= 0.0 or far >= frame.range[row, column]:
            continue
        miss = math.sqrt(max(e0 * e0 + e1 * e1 + e2 * e2 - far * far, 0.0))
        wide = far * lens.pixel[t, i]
        share = (min(r, miss + 0.5 * wide) - max(-r, miss - 0.5 * wide)) / wide
        if share <= 0.0:
            continue
        grey = frame.grey[row, column]
        lit = parts.gain[k]
        frame.grey[row, column] = grey + min(share, 1.0) * (lit - grey)
        if miss < max(r, 0.5 * wide):
            exact = _capsule_range(parts, k, p, d0, d1, d2)
            frame.range[row, column] = min(exact, far)
            frame.object_id[row, column] = parts.object[k]
