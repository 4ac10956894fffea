# SPDX-License-Identifier: Apache-2.0
"""Other paths round a blocked place, and places near a taken goal at which to wait."""

import itertools
import math

import numpy as np

from skyhaul.mapping.api import WorldMap
from skyhaul.mapping.clearance import clearances
from skyhaul.types import Array

POST_DIRECTIONS = np.array(
    [d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)], dtype=np.float64
)
POST_DIRECTIONS /= np.linalg.norm(POST_DIRECTIONS, axis=1, keepdims=True)


def detours(path: Array, way_m: float, aside_m: tuple[float, ...], sides: int) -> list[Array]:
    """The path led past a place of it, on all sides and in several distances.

    Args:
        path: Corners, (n, 3), n > 1 [m].
        way_m: Where on the path the place is, from its beginning [m].
        aside_m: Distances from the path at which to pass [m].
        sides: Directions normal to the path, evenly spread, the first level.

    Returns:
        Corners of the other paths, the nearest first.
    """
    legs = np.diff(path, axis=0)
    length = np.linalg.norm(legs, axis=1)
    ends = np.append(0.0, np.cumsum(length))
    at = min(max(way_m, 0.0), float(ends[-1]))
    k = min(max(int(np.searchsorted(ends, at)) - 1, 0), len(legs) - 1)
    along = legs[k] / max(length[k], 1e-9)
    place = path[k] + (at - ends[k]) * along
    level, upward = _normals(along)
    out = []
    for aside in aside_m:
        before, after = path[ends < at - 1.2 * aside], path[ends > at + 1.2 * aside]
        before = before if len(before) else path[:1]
        after = after if len(after) else path[-1:]
        for s in range(sides):
            angle = 2.0 * math.pi * s / sides
            via = place + aside * (math.cos(angle) * level + math.sin(angle) * upward)
            out.append(np.concatenate([before, via[None], after]))
    return out


def posts(
    world_map: WorldMap, p_WS: Array, p_WG: Array, reach_m: tuple[float, ...], from_s: float
) -> Array:
    """Places near a goal that stay clear of all movers, (k, 3) [m]; the handiest first.

    Handy is a place with a short way over it, most of all from it to the goal.

    Args:
        world_map: M(t).
        p_WS: Where the team is, (3,) [m].
        p_WG: The goal, (3,) [m].
        reach_m: Distances from the goal that are tried [m].
        from_s: When the team can be there at the soonest, after the map's stamp [s].
    """
    places = np.concatenate([p_WG + r * POST_DIRECTIONS for r in reach_m])
    times = np.linspace(min(from_s, world_map.tube_horizon_s), world_map.tube_horizon_s, 6)
    clear = clearances(
        world_map.arrays, np.repeat(places, len(times), axis=0), np.tile(times, len(places))
    )
    worst = np.min(clear.reshape(len(places), len(times)), axis=1)
    there = np.linalg.norm(places - p_WS, axis=1)
    on = np.linalg.norm(places - p_WG, axis=1)
    order = np.argsort(there + 2.0 * on - 0.5 * np.minimum(worst, 0.4), kind="stable")
    return np.asarray(places[order[worst[order] > 0.1]])


def _normals(along: Array) -> tuple[Array, Array]:
    """Two unit vectors normal to a direction and to each other, the first one level, (3,) each."""
    level = np.array([-along[1], along[0], 0.0])
    norm = float(np.linalg.norm(level))
    level = level / norm if norm > 1e-6 else np.array([1.0, 0.0, 0.0])
    return level, np.cross(along, level)
