# SPDX-License-Identifier: Apache-2.0
"""The ray caster: one ray through the centre of every pixel, four where surfaces meet.

Tile by tile: the room is met by every ray; which parts a tile can see is told by the cone of its
rays and the balls around the parts. A second pass looks again, with four rays, at the pixels whose
neighbours show another surface, and draws the cables. Distances are along the ray, in float64
(`Frame.range`); `z_depth` turns them into depth along the optical axis.
"""

from skyhaul.geometry.shapes import BOX, SPHERE
from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import (
    CEILING,
    FIRST_PART,
    MIXED,
    SKY,
    THREAD,
    Parts,
    SceneArrays,
)
from skyhaul.sensors.imaging.cull import cull, seen_parts
from skyhaul.sensors.imaging.edges import aim_at_edges, average_edges
from skyhaul.sensors.imaging.frame import Frame
from skyhaul.sensors.imaging.intersect import meet_box, meet_capsule, meet_room, meet_sphere
from skyhaul.sensors.imaging.lens import TILE, TILE_H, TILE_W, Lens
from skyhaul.sensors.imaging.shading import only_surface, shade
from skyhaul.sensors.imaging.threads import draw_thread
from skyhaul.types import Array


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
    count = cull(scene, p_WC, R_WC, own, frame.culling)
    for t in range(lens.corner.shape[0]):
        _aim(lens, t, R_WC, frame)
        parts = seen_parts(lens, t, count, frame.culling)
        frame.only[t] = _cast(scene, parts, p_WC, frame, TILE)
        _write(scene.parts, lens, t, frame)
    for t in range(lens.corner.shape[0]):
        edges = aim_at_edges(lens, t, R_WC, frame)
        parts = seen_parts(lens, t, count, frame.culling)
        if edges > 0:
            _cast(scene, parts, p_WC, frame, 4 * edges)
            average_edges(edges, frame)
        _draw_threads(scene, lens, t, parts, p_WC, R_WC, frame)


@njit_ieee
def _aim(lens: Lens, t: int, R: Array, frame: Frame) -> None:
    """Rays of tile t in W axes."""
    rays, pixel, out, out_pixel = lens.rays[t], lens.pixel[t], frame.tile.ray, frame.tile.pixel
    for i in range(TILE):
        x, y, z = rays[0, i], rays[1, i], rays[2, i]
        out[0, i] = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
        out[1, i] = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
        out[2, i] = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
        out_pixel[i] = pixel[i]


@njit_ieee
def _cast(scene: SceneArrays, parts: int, p: Array, frame: Frame, n: int) -> int:
    """Follow the first n rays of the bundle to what they meet, and shade them.

    Returns:
        Code of the surface that all of them met, or MIXED.
    """
    meet_room(scene.hall, p, frame.tile, n)
    for i in range(parts):
        k = frame.culling.seen[i]
        kind = scene.parts.kind[k]
        if kind == BOX:
            meet_box(scene.parts, k, p, frame.tile, n)
        elif kind == SPHERE:
            meet_sphere(scene.parts, k, p, frame.tile, n)
        elif kind != THREAD:
            meet_capsule(scene.parts, k, p, frame.tile, n)
    only = only_surface(frame.tile, n)
    shade(scene, parts, frame.culling.seen, only, p, frame.tile, n)
    return only if only != -1 else CEILING


@njit_ieee
def _write(parts: Parts, lens: Lens, t: int, frame: Frame) -> None:
    """Copy a tile into the frame."""
    y0, x0, only = lens.corner[t, 0], lens.corner[t, 1], frame.only[t]
    grey, far, hits, objects = frame.tile.grey, frame.tile.range, frame.tile.hit, parts.object
    out_grey, out_range, out_hit, out_id = frame.grey, frame.range, frame.hit, frame.object_id
    rows, columns = min(TILE_H, lens.height - y0), min(TILE_W, lens.width - x0)
    for y in range(rows):
        for x in range(columns):
            i = y * TILE_W + x
            out_grey[y0 + y, x0 + x], out_range[y0 + y, x0 + x] = grey[i], far[i]
    if only != MIXED and only != CEILING:
        name = objects[only - FIRST_PART] if only >= FIRST_PART else only
        for y in range(rows):
            for x in range(columns):
                out_hit[y0 + y, x0 + x], out_id[y0 + y, x0 + x] = only, name
        return
    for y in range(rows):
        for x in range(columns):
            hit = hits[y * TILE_W + x]
            # an open place of the ceiling is no edge
            out_hit[y0 + y, x0 + x] = hit if hit >= 0 else CEILING
            if hit >= FIRST_PART:
                hit = objects[hit - FIRST_PART]
            out_id[y0 + y, x0 + x] = hit if hit >= 0 else SKY


@njit_ieee
def _draw_threads(
    scene: SceneArrays, lens: Lens, t: int, parts: int, p: Array, R: Array, frame: Frame
) -> None:
    """Draw the threads that tile t can see."""
    aimed = False
    for i in range(parts):
        k = frame.culling.seen[i]
        if scene.parts.kind[k] == THREAD:
            if not aimed:
                _aim(lens, t, R, frame)
                aimed = True
            draw_thread(scene, lens, t, k, p, frame)
