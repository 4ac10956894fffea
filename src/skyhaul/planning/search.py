# SPDX-License-Identifier: Apache-2.0
"""The A* kernel: 26 neighbours, no corner cutting, a cost band, tubes at the time of passage."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit
from skyhaul.mapping.api import FieldArray, LayerArrays, MapArrays
from skyhaul.mapping.clearance import room_clearance, tube_clearance
from skyhaul.types import Array, IntArray

# mypy: disable-error-code="no-any-return"

FOUND, NO_PATH, OUT_OF_BUDGET = 0, 1, 2
_PARENT, _CLOSED, _FREE, _BLOCKED = 31, 32, 64, 128
"""Bits of a voxel's mark: step that reached it (1 + index), and what is known of it."""
_ALL = (1 << 27) - 1
"""Bits of 27 free voxels."""


class SearchRules(NamedTuple):
    """What the search obeys."""

    clearance: float  # free: at least this [m]
    band: float  # clearances below clearance + band cost more [m]
    weight: float  # factor of the cost at the inner edge of the band, minus 1
    octile: bool  # heuristic; else Euclidean
    informed: bool  # False: no heuristic at all
    budget: int  # voxels to expand
    tubes: bool  # whether tracks count
    start: float  # when the load is at the start, after the map's stamp [s]
    speed: float  # of the load along the path [m/s]


class Workspace(NamedTuple):
    """Zeroed scratch of one search; pages that the search does not touch cost nothing."""

    mark: NDArray[np.uint8]  # (cells,)
    cost: Array  # (cells,) cost so far [voxels]
    way: Array  # (cells,) length so far [voxels]; only with tubes
    step: IntArray  # (26, 3)
    length: Array  # (26,)
    need: IntArray  # (26,) bits, see `_bit`, of the voxels of the block that a step spans
    follow: IntArray  # (27, 27) steps worth taking after a step (1 + index; 0: none), -1 ends


def _bit(i: int, j: int, k: int) -> int:
    """Bit of a voxel, -1..1 along each axis, among the 27 around one."""
    return 1 << ((i + 1) * 9 + (j + 1) * 3 + k + 1)


def _block(d: tuple[int, int, int]) -> int:
    """Bits of the voxels of the block that a step spans: a step that cuts no corner needs all."""
    i, j, k = ({0, c} for c in d)
    return sum(_bit(a, b, c) for a in i for b in j for c in k)


def _follow(step: list[tuple[int, int, int]]) -> IntArray:
    """Rows of `Workspace.follow`: after a step, the steps that have only parts of it.

    In open space every other voxel is reached as soon without this one (the natural neighbours
    of jump point search, Harabor and Grastien 2011).
    """
    out = np.full((27, 27), -1, dtype=np.int64)
    out[0, :26] = np.arange(26)
    for a, d in enumerate(step):
        parts = [
            s for s, e in enumerate(step) if all(y in (0, x) for x, y in zip(d, e, strict=True))
        ]
        out[1 + a, : len(parts)] = parts
    return out


def _steps() -> list[tuple[int, int, int]]:
    """The 26 steps, straight ones first."""
    out = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if i or j or k]
    return sorted(out, key=lambda d: abs(d[0]) + abs(d[1]) + abs(d[2]))


_STEP = np.array(_steps(), dtype=np.int64)
_LENGTH = np.sqrt((_STEP**2).sum(axis=1).astype(np.float64))
_NEED = np.array([_block(d) for d in _steps()], dtype=np.int64)
_FOLLOW = _follow(_steps())


def workspace(cells: int, tubes: bool) -> Workspace:
    """Scratch for a layer with so many voxels."""
    way = np.zeros(cells if tubes else 1)
    mark, cost = np.zeros(cells, np.uint8), np.zeros(cells)
    return Workspace(mark, cost, way, _STEP, _LENGTH, _NEED, _FOLLOW)


@njit
def voxel_clearance(m: MapArrays, layer: LayerArrays, i: int, j: int, k: int) -> float:
    """Clearance to what stands, the load at a voxel's centre [m]."""
    x = layer.origin[0] + layer.voxel * i
    y = layer.origin[1] + layer.voxel * j
    z = layer.origin[2] + layer.voxel * k
    return min(float(layer.clearance[i, j, k]), room_clearance(m, x, y, z))


@njit
def _is_free(
    m: MapArrays, layer: LayerArrays, rules: SearchRules, i: int, j: int, k: int, scratch: Array
) -> bool:
    """Whether a voxel is clear of what stands and, with tubes, of them at the start's time."""
    if voxel_clearance(m, layer, i, j, k) < rules.clearance:
        return False
    return not (rules.tubes and _in_tube(m, layer, rules, i, j, k, 0.0, scratch))


@njit
def nearest_free(
    m: MapArrays, layer: LayerArrays, rules: SearchRules, p: Array, reach: int, cell: IntArray
) -> bool:
    """The free voxel nearest to a point; False when there is none within `reach` voxels.

    `cell`, (3,), holds the voxel of the point and receives the one found. With tubes, free means
    free of them at the start's time too.
    """
    n = layer.clearance.shape
    scratch = np.empty(3)
    if _is_free(m, layer, rules, cell[0], cell[1], cell[2], scratch):
        return True
    best, bi, bj, bk = math.inf, -1, -1, -1
    for i in range(max(0, cell[0] - reach), min(n[0], cell[0] + reach + 1)):
        for j in range(max(0, cell[1] - reach), min(n[1], cell[1] + reach + 1)):
            for k in range(max(0, cell[2] - reach), min(n[2], cell[2] + reach + 1)):
                x = layer.origin[0] + layer.voxel * i
                y = layer.origin[1] + layer.voxel * j
                z = layer.origin[2] + layer.voxel * k
                d = (x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2
                if d >= best or not _is_free(m, layer, rules, i, j, k, scratch):
                    continue
                best, bi, bj, bk = d, i, j, k
    if bi < 0:
        return False
    cell[0], cell[1], cell[2] = bi, bj, bk
    return True


@njit
def heuristic(dx: float, dy: float, dz: float, octile: bool) -> float:
    """A lower bound of the way over so many voxels along each axis [voxels]."""
    dx, dy, dz = abs(dx), abs(dy), abs(dz)
    if not octile:
        return math.sqrt(dx * dx + dy * dy + dz * dz)
    low, high = min(dx, min(dy, dz)), max(dx, max(dy, dz))
    middle = dx + dy + dz - low - high
    return (math.sqrt(3.0) - math.sqrt(2.0)) * low + (math.sqrt(2.0) - 1.0) * middle + high


@njit
def search(
    m: MapArrays,
    layer: LayerArrays,
    start: IntArray,
    goal: IntArray,
    rules: SearchRules,
    w: Workspace,
) -> tuple[int, int]:
    """Status and number of voxels expanded; the path is in `w.mark`, see `trace`.

    Without tubes, where all voxels around cost the same, only natural neighbours are looked at:
    it saves half of the time and changes no cost. The heuristic is inflated by 1e-9 so that, of
    two equal voxels, the one nearer to the goal goes first; the path is the shortest but for
    that share.
    """
    shape = layer.clearance.shape
    n1, n2 = shape[1], shape[2]
    keys, cells, scratch = np.empty(4096), np.empty(4096, np.int64), np.empty(3)
    field, mark_of, cost_of = layer.clearance.ravel(), w.mark, w.cost
    room = _room_cells(m, layer, rules.clearance)
    goal_index = (goal[0] * n1 + goal[1]) * n2 + goal[2]
    first = (start[0] * n1 + start[1]) * n2 + start[2]
    w.mark[first] |= _FREE
    count, expanded = _push(keys, cells, 0, 0.0, first), 0
    while count > 0:
        cell, count = _pop(keys, cells, count)
        if cell == goal_index:
            return FOUND, expanded
        if mark_of[cell] & _CLOSED:
            continue
        if expanded == rules.budget:
            return OUT_OF_BUDGET, expanded
        mark_of[cell] |= _CLOSED
        expanded += 1
        if count + 26 > len(keys):
            keys, cells = np.append(keys, np.empty(count)), np.append(cells, cells)
        i, j, k = cell // (n1 * n2), (cell // n2) % n1, cell % n2
        free, is_open = _look_around(field, shape, room, rules, i, j, k, mark_of)
        here = cost_of[cell]
        row = w.follow[mark_of[cell] & _PARENT if is_open and not rules.tubes else 0]
        for q in range(26):
            s = row[q]
            if s < 0:
                break
            if free & w.need[s] != w.need[s]:
                continue
            di, dj, dk = w.step[s, 0], w.step[s, 1], w.step[s, 2]
            near = cell + (di * n1 + dj) * n2 + dk
            mark = mark_of[near]
            if mark & _CLOSED or (mark & _PARENT and here + w.length[s] >= cost_of[near]):
                continue
            cost = here + w.length[s] * price(float(field[near]), rules)
            if mark & _PARENT and cost >= cost_of[near]:
                continue
            if rules.tubes:
                way = w.way[cell] + w.length[s]
                if _in_tube(m, layer, rules, i + di, j + dj, k + dk, way, scratch):
                    continue
                w.way[near] = way
            cost_of[near] = cost
            mark_of[near] = (mark & ~_PARENT) | (s + 1)
            di, dj, dk = goal[0] - i - di, goal[1] - j - dj, goal[2] - k - dk
            ahead = heuristic(di, dj, dk, rules.octile) if rules.informed else 0.0
            count = _push(keys, cells, count, cost + ahead * (1.0 + 1e-9), near)
    return NO_PATH, expanded


@njit
def trace(layer: LayerArrays, start: IntArray, goal: IntArray, w: Workspace) -> Array:
    """Centres of the voxels from start to goal after a search, (n, 3) [m]."""
    n1, n2 = layer.clearance.shape[1], layer.clearance.shape[2]
    i, j, k, n = goal[0], goal[1], goal[2], 1
    back = np.empty((64, 3))
    _center(layer, i, j, k, back[0])
    while not (i == start[0] and j == start[1] and k == start[2]):
        s = (w.mark[(i * n1 + j) * n2 + k] & _PARENT) - 1
        i, j, k = i - w.step[s, 0], j - w.step[s, 1], k - w.step[s, 2]
        if n == len(back):
            more = np.empty((2 * n, 3))
            more[:n] = back
            back = more
        _center(layer, i, j, k, back[n])
        n += 1
    return back[:n][::-1].copy()


@njit
def _center(layer: LayerArrays, i: int, j: int, k: int, out: Array) -> None:
    """Centre of a voxel, (3,) [m]."""
    out[0] = layer.origin[0] + layer.voxel * i
    out[1] = layer.origin[1] + layer.voxel * j
    out[2] = layer.origin[2] + layer.voxel * k


@njit
def _room_cells(m: MapArrays, layer: LayerArrays, clearance: float) -> IntArray:
    """Voxels inside the room, (11,): first and last i, j, k; lowest k over the floor; the column.

    Entry 4, the first k, is 0 and counts in the exempt column, i and j from 7 to 10; entry 6
    counts elsewhere.
    """
    out = np.empty(11, np.int64)
    for axis in range(3):
        below = m.shape[2] if axis == 2 else m.shape[0]
        above = m.shape[1] if axis == 2 else m.shape[0]
        low = (m.room_min[axis] + below + clearance - layer.origin[axis]) / layer.voxel
        high = (m.room_max[axis] - above - clearance - layer.origin[axis]) / layer.voxel
        n = layer.clearance.shape[axis]
        out[2 * axis] = math.ceil(min(max(low - 1e-9, 0.0), 1.0 * n))
        out[2 * axis + 1] = math.floor(max(min(high + 1e-9, n - 1.0), -1.0))
    out[6], out[4] = out[4], 0
    out[7:11] = (1, 0, 1, 0)
    if m.exempt[2] <= 0.0:
        return out
    reach = m.exempt[2] / math.sqrt(2.0)  # the square inside the column
    for axis in range(2):
        low = (m.exempt[axis] - reach - layer.origin[axis]) / layer.voxel
        high = (m.exempt[axis] + reach - layer.origin[axis]) / layer.voxel
        out[7 + 2 * axis], out[8 + 2 * axis] = math.ceil(low), math.floor(high)
    return out


@njit
def _in_room(room: IntArray, i: int, j: int, k: int) -> bool:
    """Whether a voxel keeps clear of walls, ceiling and, outside the exempt column, the floor."""
    if i < room[0] or i > room[1] or j < room[2] or j > room[3] or k < room[4] or k > room[5]:
        return False
    return k >= room[6] or (room[7] <= i <= room[8] and room[9] <= j <= room[10])


@njit
def _look_around(
    field: FieldArray,
    shape: tuple[int, int, int],
    room: IntArray,
    rules: SearchRules,
    i: int,
    j: int,
    k: int,
    mark: NDArray[np.uint8],
) -> tuple[int, bool]:
    """Bits of the free ones among the 27 voxels around one, and whether all cost the same.

    Whether a voxel is free stays in its mark.
    """
    n0, n1, n2 = shape
    free, bit = 0, 1
    even = rules.clearance + (rules.band if rules.weight > 0.0 else 0.0)
    lowest = np.float32(math.inf)
    rim = i == 0 or j == 0 or k == 0 or i == n0 - 1 or j == n1 - 1 or k == n2 - 1
    for a in range(i - 1, i + 2):
        for b in range(j - 1, j + 2):
            for c in range(k - 1, k + 2):
                if rim and (a < 0 or b < 0 or c < 0 or a >= n0 or b >= n1 or c >= n2):
                    bit <<= 1
                    continue
                index = (a * n1 + b) * n2 + c
                known = mark[index] & (_FREE | _BLOCKED)
                if known == 0:
                    known = _BLOCKED
                    if field[index] >= rules.clearance and _in_room(room, a, b, c):
                        known = _FREE
                    mark[index] |= known
                if known == _FREE:
                    free |= bit
                    lowest = min(lowest, field[index])
                bit <<= 1
    return free, bool(free == _ALL and lowest >= even)


@njit
def price(clearance: float, rules: SearchRules) -> float:
    """Cost per length at a clearance: 1, rising quadratically through the band."""
    into = rules.clearance + rules.band - clearance
    if into <= 0.0 or rules.weight == 0.0:
        return 1.0
    share = min(into / rules.band, 1.0)
    return 1.0 + rules.weight * share * share


@njit
def _in_tube(
    m: MapArrays,
    layer: LayerArrays,
    rules: SearchRules,
    i: int,
    j: int,
    k: int,
    way: float,
    scratch: Array,
) -> bool:
    """Whether a tube covers a voxel when the load passes it."""
    t = rules.start + way * layer.voxel / rules.speed
    x = layer.origin[0] + layer.voxel * i
    y = layer.origin[1] + layer.voxel * j
    z = layer.origin[2] + layer.voxel * k
    return tube_clearance(m, x, y, z, t, rules.clearance, scratch) < rules.clearance


@njit
def _push(keys: Array, cells: IntArray, count: int, key: float, cell: int) -> int:
    """Add a voxel to the binary heap; the new count."""
    at = count
    while at > 0:
        up = (at - 1) >> 1
        if keys[up] <= key:
            break
        keys[at], cells[at] = keys[up], cells[up]
        at = up
    keys[at], cells[at] = key, cell
    return count + 1


@njit
def _pop(keys: Array, cells: IntArray, count: int) -> tuple[int, int]:
    """Take the voxel with the smallest key out of the heap: it and the new count."""
    top = cells[0]
    count -= 1
    key, cell = keys[count], cells[count]
    at = 0
    while True:
        down = 2 * at + 1
        if down >= count:
            break
        if down + 1 < count and keys[down + 1] < keys[down]:
            down += 1
        if keys[down] >= key:
            break
        keys[at], cells[at] = keys[down], cells[down]
        at = down
    keys[at], cells[at] = key, cell
    return top, count
