# SPDX-License-Identifier: Apache-2.0
"""Line-of-sight shortcuts of a voxel path, with the one clearance function."""

import itertools
import math

import numpy as np

from skyhaul.jit import njit
from skyhaul.mapping.api import MapArrays
from skyhaul.mapping.clearance import static_clearance, tube_clearance
from skyhaul.planning.search import SearchRules, price
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"


@njit
def line_cost(m: MapArrays, rules: SearchRules, a: Array, b: Array, way: float) -> float:
    """Cost of flying straight from a to b, (3,) each [m]; inf when it is not clear.

    Args:
        m: The map.
        rules: Those of the search.
        a: From.
        b: To.
        way: Length flown before a [m].

    Limits:
        Looks at places no farther apart than a voxel or the clearance found.
    """
    length = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    scratch = np.empty(3)
    done, cost = 0.0, 0.0
    while True:
        u = done / length if length > 0.0 else 0.0
        x, y, z = a[0] + u * (b[0] - a[0]), a[1] + u * (b[1] - a[1]), a[2] + u * (b[2] - a[2])
        c = static_clearance(m, x, y, z)
        if c < rules.clearance - 1e-9:
            return math.inf
        step = max(m.fine.voxel, 0.8 * (c - rules.clearance - rules.band))
        if rules.tubes:
            t = rules.start + (way + done) / rules.speed
            tube = tube_clearance(m, x, y, z, t, c, scratch)
            if tube < rules.clearance:
                return math.inf
            step = min(step, max(m.fine.voxel, 0.8 * (tube - rules.clearance)))
        if done >= length:
            return cost
        step = min(step, length - done)
        cost += step * price(c, rules)
        done = done + step if step < length - done else length


@njit
def shortcut(m: MapArrays, rules: SearchRules, path: Array) -> Array:
    """The cheapest path over a subset of its points, ends kept, (k, 3) [m].

    Straight legs replace what costs as much or more; dynamic programming over all pairs.
    """
    n = len(path)
    best, origin, way = np.full(n, np.inf), np.zeros(n, np.int64), np.zeros(n)
    best[0] = 0.0
    for j in range(1, n):
        for i in range(j):
            if best[i] == np.inf:
                continue
            length = 0.0
            for c in range(3):
                length += (path[j, c] - path[i, c]) ** 2
            length = math.sqrt(length)
            if best[i] + length >= best[j]:
                continue
            cost = best[i] + line_cost(m, rules, path[i], path[j], way[i])
            if cost < best[j]:
                best[j], origin[j], way[j] = cost, i, way[i] + length
        if best[j] == np.inf:  # not clear by the finer look: keep the leg of the voxel path
            origin[j] = j - 1
            leg = math.sqrt(np.sum((path[j] - path[j - 1]) ** 2))
            best[j], way[j] = best[j - 1] + (1.0 + rules.weight) * leg, way[j - 1] + leg
    keep = np.zeros(n, np.bool_)
    j = n - 1
    while j > 0:
        keep[j] = True
        j = origin[j]
    keep[0] = True
    return path[keep]


def corners(path: Array) -> Array:
    """A path without the points that lie on straight legs, (k, 3)."""
    if len(path) < 3:
        return path
    d = np.diff(path, axis=0)
    d = d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-12)
    turns = np.linalg.norm(np.diff(d, axis=0), axis=1) > 1e-6
    return path[np.concatenate([[True], turns, [True]])]


def subdivide(path: Array, step_m: float) -> Array:
    """A path with points added so that no leg is longer than `step_m`."""
    out = [path[:1]]
    for a, b in itertools.pairwise(path):
        k = max(1, math.ceil(float(np.linalg.norm(b - a)) / step_m))
        out.append(a + np.arange(1, k + 1)[:, None] / k * (b - a))
    return np.concatenate(out)


def straighten(m: MapArrays, rules: SearchRules, path: Array, step_m: float = 0.9) -> Array:
    """A voxel path with shortcuts: once over its corners, once more over points between."""
    if len(path) < 3:
        return path
    first = shortcut(m, rules, np.ascontiguousarray(corners(path)))
    if len(first) < 3:
        return first
    return corners(shortcut(m, rules, subdivide(first, step_m)))
