# SPDX-License-Identifier: Apache-2.0
"""Voxels and how likely something stands in each: log-odds of hits and of rays that pass.

A frame changes a voxel once at most, by a hit if enough points lie in it, else by a miss if a ray
passes: l <- clamp(l + l_hit) or clamp(l + l_miss). A ray ends before its point by some standard
deviations of the depth, so that noise does not carve the surface it comes from. A voxel is
occupied from `occupied_above` on and until `free_below`; what no ray has reached is unknown.

A voxel that was once surely free is *open*, whatever comes later: what stands in open space has
come there. Only many hits without a ray that passes close it again.

Source:
    Hornung et al., OctoMap (2013), for clamped log-odds and hits before misses; Amanatides and
    Woo (1987) for the traversal.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit
from skyhaul.params import Params
from skyhaul.types import Array, IntArray, Mask

# mypy: disable-error-code="no-any-return"

Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]
Int16 = NDArray[np.int16]


@dataclass(frozen=True, kw_only=True)
class EvidenceRules(Params):
    """Log-odds of a voxel."""

    hit: float = 0.85
    """What a hit adds: a probability of 0.7."""
    miss: float = -0.4
    """What a ray that passes adds: 0.4."""
    least: float = -2.4
    """Nothing is surer to be free ..."""
    most: float = 3.5
    """... nor to be occupied: 0.97."""
    occupied_above: float = 1.2
    """Voxels become occupied here: two hits ..."""
    free_below: float = 0.0
    """... and free again here."""
    sure_below: float = -1.5
    """A voxel is surely free from here on, after four rays that passed: it becomes open."""
    close_hits: int = 25
    """Hits in a row that close an open voxel."""
    least_points: int = 2
    """Points of a frame in a voxel that make a hit."""
    short_sigmas: float = 2.5
    """Rays end so many standard deviations of the depth before their point ..."""
    short_m: float = 0.1
    """... and at least this much [m]."""

    def __post_init__(self) -> None:
        if not self.miss < 0.0 < self.hit:
            raise ValueError(f"miss must be < 0 < hit, got {self.miss} and {self.hit}")
        if not self.least < self.sure_below < self.free_below < self.occupied_above < self.most:
            raise ValueError(
                "least < sure_below < free_below < occupied_above < most is needed, got "
                f"{self.least}, {self.sure_below}, {self.free_below}, {self.occupied_above}, "
                f"{self.most}"
            )


class Evidence(NamedTuple):
    """All voxels; changed in place by the kernels."""

    p_WO: Array  # (3,) centre of voxel (0, 0, 0) [m]
    voxel: float  # [m]
    log_odds: Float32  # (nx, ny, nz)
    known: Mask  # (nx, ny, nz) some ray or point was there
    open: Mask  # (nx, ny, nz) was surely free
    streak: Int16  # (nx, ny, nz) hits since a ray passed
    occupied: Mask  # (nx, ny, nz)
    hit_frame: Int32  # (nx, ny, nz) frame whose points are counted
    hits: Int16  # (nx, ny, nz) its points so far
    miss_frame: Int32  # (nx, ny, nz) last frame that passed
    changed: IntArray  # (2, 3) range of voxels that became occupied or free; empty: first >= last


def empty_evidence(p_WO: Array, voxel_m: float, cells: IntArray) -> Evidence:
    """Nothing is known yet."""
    n = tuple(int(c) for c in cells)
    return Evidence(
        p_WO=p_WO,
        voxel=voxel_m,
        log_odds=np.zeros(n, np.float32),
        known=np.zeros(n, np.bool_),
        open=np.zeros(n, np.bool_),
        streak=np.zeros(n, np.int16),
        occupied=np.zeros(n, np.bool_),
        hit_frame=np.full(n, -1, np.int32),
        hits=np.zeros(n, np.int16),
        miss_frame=np.full(n, -1, np.int32),
        changed=np.array([n, (0, 0, 0)], dtype=np.int64),
    )


def forget_changes(e: Evidence) -> None:
    """Start to note changes anew; in place."""
    e.changed[0] = e.log_odds.shape
    e.changed[1] = 0


def take_hits(rules: EvidenceRules, e: Evidence, frame: int, points_W: Array) -> None:
    """Count the points of a frame, (k, 3) [m]; in place."""
    limits = (rules.hit, rules.most, rules.occupied_above)
    _take_hits(e, frame, points_W, rules.least_points, limits, rules.close_hits)


def take_misses(rules: EvidenceRules, e: Evidence, frame: int, p_WC: Array, ends_W: Array) -> None:
    """Let rays from the camera (3,) to where each ends, (k, 3) [m], pass; in place.

    Call it after the hits of the same frame.
    """
    limits = (rules.miss, rules.least, rules.free_below, rules.sure_below)
    _take_misses(e, frame, p_WC, ends_W, rules.least_points, limits)


def in_open(e: Evidence, points_W: Array) -> Mask:
    """Which points, (k, 3) [m], lie in open space: their voxel and its six neighbours."""
    return _in_open(e, points_W)


def clear_ball(rules: EvidenceRules, e: Evidence, p_WP: Array, radius_m: float) -> None:
    """Make what is occupied inside a ball unsure, not surely free; in place."""
    _clear_ball(e, p_WP, radius_m, rules.free_below)


@njit
def ray_is_blocked(e: Evidence, p_WC: Array, dir_W: Array, reach_m: float) -> bool:
    """Whether a ray from the camera (3,) passes an occupied voxel, or one beside it, within reach.

    Args:
        e: The voxels.
        p_WC: Where the ray begins, (3,) [m].
        dir_W: Its direction, (3,), unit.
        reach_m: How far it goes [m].
    """
    n, steps = e.occupied.shape, int(reach_m / (0.5 * e.voxel))
    for s in range(steps):
        t = 0.5 * e.voxel * s
        i, j, k = _cell(e, p_WC[0] + t * dir_W[0], p_WC[1] + t * dir_W[1], p_WC[2] + t * dir_W[2])
        if i < 1 or j < 1 or k < 1 or i + 1 >= n[0] or j + 1 >= n[1] or k + 1 >= n[2]:
            continue
        for a in range(-1, 2):
            for b in range(-1, 2):
                for c in range(-1, 2):
                    if e.occupied[i + a, j + b, k + c]:
                        return True
    return False


@njit
def _cell(e: Evidence, x: float, y: float, z: float) -> tuple[int, int, int]:
    """Voxel of a point; the first entry is -1 outside."""
    i = math.floor((x - e.p_WO[0]) / e.voxel + 0.5)
    j = math.floor((y - e.p_WO[1]) / e.voxel + 0.5)
    k = math.floor((z - e.p_WO[2]) / e.voxel + 0.5)
    n = e.log_odds.shape
    if 0 <= i < n[0] and 0 <= j < n[1] and 0 <= k < n[2]:
        return i, j, k
    return -1, 0, 0


@njit
def _note(e: Evidence, i: int, j: int, k: int) -> None:
    """Widen the range of what changed."""
    c = e.changed
    c[0, 0], c[1, 0] = min(c[0, 0], i), max(c[1, 0], i + 1)
    c[0, 1], c[1, 1] = min(c[0, 1], j), max(c[1, 1], j + 1)
    c[0, 2], c[1, 2] = min(c[0, 2], k), max(c[1, 2], k + 1)


@njit
def _take_hits(
    e: Evidence, frame: int, points: Array, least: int, limits: tuple[float, float, float],
    close: int,
) -> None:  # fmt: skip
    hit, most, occupied = limits
    for a in range(points.shape[0]):
        i, j, k = _cell(e, points[a, 0], points[a, 1], points[a, 2])
        if i < 0:
            continue
        if e.hit_frame[i, j, k] != frame:
            e.hit_frame[i, j, k], e.hits[i, j, k] = frame, 0
        if e.hits[i, j, k] >= least:
            continue
        e.hits[i, j, k] += 1
        if e.hits[i, j, k] == least:
            e.known[i, j, k] = True
            e.log_odds[i, j, k] = min(e.log_odds[i, j, k] + hit, most)
            e.streak[i, j, k] += 1
            if e.streak[i, j, k] >= close:
                e.open[i, j, k], e.streak[i, j, k] = False, 0
            if e.log_odds[i, j, k] >= occupied and not e.occupied[i, j, k]:
                e.occupied[i, j, k] = True
                _note(e, i, j, k)


@njit
def _take_misses(
    e: Evidence, frame: int, p_WC: Array, ends: Array, least: int,
    limits: tuple[float, float, float, float],
) -> None:  # fmt: skip
    """Amanatides and Woo: from voxel to voxel, by the nearest of the three next faces."""
    n = e.log_odds.shape
    cell, step = np.empty(3, np.int64), np.empty(3, np.int64)
    t_next, t_step = np.empty(3), np.empty(3)
    for a in range(ends.shape[0]):
        for c in range(3):
            x = (p_WC[c] - e.p_WO[c]) / e.voxel + 0.5
            d = (ends[a, c] - p_WC[c]) / e.voxel
            cell[c] = math.floor(x)
            step[c] = 1 if d > 0.0 else -1
            t_step[c] = abs(1.0 / d) if d != 0.0 else math.inf
            edge = cell[c] + 1.0 - x if d > 0.0 else x - cell[c]
            t_next[c] = edge * t_step[c] if d != 0.0 else math.inf
        while True:
            inside = 0 <= cell[0] < n[0] and 0 <= cell[1] < n[1] and 0 <= cell[2] < n[2]
            if inside:
                _pass(e, frame, cell[0], cell[1], cell[2], least, limits)
            axis = 0 if t_next[0] <= t_next[1] else 1
            axis = axis if t_next[axis] <= t_next[2] else 2
            if t_next[axis] > 1.0:
                break
            cell[axis] += step[axis]
            t_next[axis] += t_step[axis]


@njit
def _pass(
    e: Evidence, frame: int, i: int, j: int, k: int, least: int,
    limits: tuple[float, float, float, float],
) -> None:  # fmt: skip
    """One ray in one voxel."""
    if e.miss_frame[i, j, k] == frame:
        return
    e.miss_frame[i, j, k] = frame
    if e.hit_frame[i, j, k] == frame and e.hits[i, j, k] >= least:
        return
    miss, lowest, free, sure = limits
    e.known[i, j, k] = True
    e.streak[i, j, k] = 0
    e.log_odds[i, j, k] = max(e.log_odds[i, j, k] + miss, lowest)
    if e.log_odds[i, j, k] <= sure:
        e.open[i, j, k] = True
    if e.log_odds[i, j, k] < free and e.occupied[i, j, k]:
        e.occupied[i, j, k] = False
        _note(e, i, j, k)


@njit
def _in_open(e: Evidence, points: Array) -> Mask:
    out = np.zeros(points.shape[0], np.bool_)
    n, o = e.open.shape, e.open
    for a in range(points.shape[0]):
        i, j, k = _cell(e, points[a, 0], points[a, 1], points[a, 2])
        if i <= 0 or j <= 0 or k <= 0 or i + 1 >= n[0] or j + 1 >= n[1] or k + 1 >= n[2]:
            continue
        sides = o[i - 1, j, k] and o[i + 1, j, k] and o[i, j - 1, k] and o[i, j + 1, k]
        out[a] = sides and o[i, j, k] and o[i, j, k - 1] and o[i, j, k + 1]
    return out


@njit
def _clear_ball(e: Evidence, p: Array, radius: float, free: float) -> None:
    n, first, last = e.log_odds.shape, np.empty(3, np.int64), np.empty(3, np.int64)
    for c in range(3):
        first[c] = max(0, math.floor((p[c] - radius - e.p_WO[c]) / e.voxel + 0.5))
        last[c] = min(n[c] - 1, math.floor((p[c] + radius - e.p_WO[c]) / e.voxel + 0.5))
    for i in range(first[0], last[0] + 1):
        for j in range(first[1], last[1] + 1):
            for k in range(first[2], last[2] + 1):
                x = e.p_WO[0] + e.voxel * i - p[0]
                y = e.p_WO[1] + e.voxel * j - p[1]
                z = e.p_WO[2] + e.voxel * k - p[2]
                if x * x + y * y + z * z > radius * radius:
                    continue
                e.log_odds[i, j, k] = min(e.log_odds[i, j, k], free)
                if e.occupied[i, j, k]:
                    e.occupied[i, j, k] = False
                    _note(e, i, j, k)
