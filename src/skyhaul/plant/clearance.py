# SPDX-License-Identifier: Apache-2.0
"""Clearance and contacts of every body of the team, at every step, surface to surface.

Bodies are the rows payload, vehicles 0 .. n-1, cables 0 .. n-1 of one `ShapeArrays`; the distance
kernels decide what touches. MuJoCo only makes the forces of a contact, cables have none.
"""

import math
from typing import NamedTuple

import numpy as np

from skyhaul.geometry.distance import bounding_radius, lowest_point, point_distance, shape_distance
from skyhaul.geometry.shapes import ShapeArrays
from skyhaul.jit import njit
from skyhaul.types import Array, IntArray, Mask

LEAVE_M = 1e-3
"""A contact has ended when the bodies are farther apart than this: resting bodies tremble [m]."""


class Surroundings(NamedTuple):
    """What the team can touch."""

    obstacles: ShapeArrays  # (m)
    reach: Array  # (m,) their bounding radii [m]
    present: Mask  # (m,)
    room_min: Array  # (3,) [m]
    room_max: Array  # (3,) [m]


class TouchMemory(NamedTuple):
    """What touches now. Columns: obstacles 0 .. m-1, room, payload, vehicles 0 .. n-1."""

    touching: Mask  # (1 + 2 n, m + 2 + n)
    begun: IntArray  # (k, 2) body row and column of the contacts that began in the last step
    closest: IntArray  # (2,) body row and obstacle of the last smallest clearance


def touch_memory(n: int, m: int) -> TouchMemory:
    """Memory for n vehicles and m obstacles, nothing touching."""
    touching = np.zeros((1 + 2 * n, m + 2 + n), dtype=np.bool_)
    begun = np.zeros((touching.size, 2), dtype=np.int64)
    return TouchMemory(touching, begun, np.zeros(2, dtype=np.int64))


@njit
def update_touches(
    bodies: ShapeArrays, attached: Mask, around: Surroundings, memory: TouchMemory
) -> tuple[float, int, float]:
    """Smallest clearance to any present obstacle, how many contacts began, and the room left.

    Cables count while attached. Contacts are those with obstacles and the room, of vehicles with
    each other and with the payload, and of cables with other vehicles than their own.

    Args:
        bodies: Payload, vehicles, cables: 1 + 2 n rows.
        attached: Cables that are attached, (n,).
        around: Obstacles and room.
        memory: Updated in place; the first rows of `begun` are the new contacts.

    Returns:
        Clearance, inf without obstacles [m]; number of rows of `begun`; a distance that payload
        and vehicles surely keep from everything: obstacles, room, each other [m].
    """
    n, m = attached.shape[0], around.present.shape[0]
    best, count, gap = np.inf, 0, _team_gap(bodies, n)
    row, column = memory.closest
    if m > 0 and around.present[column] and (row <= n or attached[row - 1 - n]):
        best = shape_distance(bodies, row, around.obstacles, column)
    touching, p, q, far = memory.touching, bodies.p_WO, around.obstacles.p_WO, around.reach
    for r in range(1 + 2 * n):
        if r > n and not attached[r - 1 - n]:
            touching[r, :] = False
            continue
        reach = bounding_radius(bodies, r)
        for j in range(m):
            if not around.present[j]:
                continue
            limit = max(best, LEAVE_M)
            away = limit + reach + far[j]
            x, y, z = p[r, 0] - q[j, 0], p[r, 1] - q[j, 1], p[r, 2] - q[j, 2]
            if x * x + y * y + z * z > away * away:
                touching[r, j] = False
                continue
            d = _distance_within(bodies, r, reach, around.obstacles, j, limit)
            count = _note(memory, r, j, d, count)
            if d < best:
                best = d
                memory.closest[0], memory.closest[1] = r, j
        if r <= n:
            wall = room_distance(bodies, r, around)
            gap = min(gap, wall)
            count = _note(memory, r, m, wall, count)
        count = _touch_team(bodies, r, reach, attached, memory, count)
    return best, count, min(gap, best)


@njit
def _team_gap(bodies: ShapeArrays, n: int) -> float:
    """Smallest distance of the spheres around payload and vehicles from each other [m]."""
    p, gap = bodies.p_WO, np.inf
    for r in range(1, n + 1):
        reach = bounding_radius(bodies, r)
        for k in range(r):
            x, y, z = p[r, 0] - p[k, 0], p[r, 1] - p[k, 1], p[r, 2] - p[k, 2]
            apart = math.sqrt(x * x + y * y + z * z) - reach - bounding_radius(bodies, k)
            gap = min(gap, apart)
    return gap


@njit
def _touch_team(
    bodies: ShapeArrays, r: int, reach: float, attached: Mask, memory: TouchMemory, count: int
) -> int:
    """Contacts of body r with the payload (vehicles only) and the vehicles; each pair once."""
    n, p, touching = attached.shape[0], bodies.p_WO, memory.touching
    payload_column = touching.shape[1] - 1 - n
    first = 1 if r > n else 0
    last = n if r > n else r - 1
    far = LEAVE_M + reach + max(bounding_radius(bodies, 0), bounding_radius(bodies, 1))
    for k in range(first, last + 1):
        x, y, z = p[r, 0] - p[k, 0], p[r, 1] - p[k, 1], p[r, 2] - p[k, 2]
        if r == k + n:
            continue
        if x * x + y * y + z * z > far * far:
            touching[r, payload_column + k] = False
            continue
        d = _distance_within(bodies, r, reach, bodies, k, LEAVE_M)
        count = _note(memory, r, payload_column + k, d, count)
    return count


@njit
def _distance_within(
    a: ShapeArrays, i: int, reach: float, b: ShapeArrays, j: int, limit: float
) -> float:
    """Distance of two shapes where it is below `limit`, else some lower bound not below it."""
    bound = point_distance(b, j, a.p_WO[i, 0], a.p_WO[i, 1], a.p_WO[i, 2]) - reach
    if bound > limit:
        return bound
    return shape_distance(a, i, b, j)


@njit
def room_distance(bodies: ShapeArrays, r: int, around: Surroundings) -> float:
    """Distance of a body to the floor, the walls and the ceiling, negative outside."""
    d = np.inf
    for k in range(3):
        d = min(d, lowest_point(bodies, r, k, 1.0) - around.room_min[k])
        d = min(d, lowest_point(bodies, r, k, -1.0) + around.room_max[k])
    return d


@njit
def _note(memory: TouchMemory, r: int, column: int, d: float, count: int) -> int:
    """Update one pair; a contact begins at distance 0 and ends beyond `LEAVE_M`."""
    if d <= 0.0 and not memory.touching[r, column]:
        memory.touching[r, column] = True
        memory.begun[count, 0], memory.begun[count, 1] = r, column
        return count + 1
    if d > LEAVE_M:
        memory.touching[r, column] = False
    return count
