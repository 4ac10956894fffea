# SPDX-License-Identifier: Apache-2.0
"""Pieces of a depth image: pixels that hang together in the image and in depth."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit
from skyhaul.types import Array, IntArray, Mask

# mypy: disable-error-code="no-any-return"

Labels = NDArray[np.int32]


class Pieces(NamedTuple):
    """Of one depth image, on its grid of every n-th pixel."""

    label: Labels  # (rows, columns) number of the piece, -1: none
    size: IntArray  # (m,) pixels
    free: IntArray  # (m,) of them where nothing stands
    first: IntArray  # (m, 2) smallest row and column
    last: IntArray  # (m, 2) largest row and column
    mean: Array  # (m, 3) of the points [m]
    near: Array  # (m,) smallest depth along the optical axis [m]


@njit
def pieces_of(
    points: Array, z: Array, use: Mask, free: Mask, jump_m: float, jump_per_z2: float
) -> Pieces:
    """Join neighbours whose depths differ by no more than jump_m + jump_per_z2 z^2.

    Args:
        points: Of the grid, in any axes, (rows, columns, 3) [m].
        z: Their depths along the optical axis, (rows, columns) [m].
        use: Which of them count, (rows, columns).
        free: Which lie where nothing stands, (rows, columns).
        jump_m: Step of depth inside a piece [m].
        jump_per_z2: The same from noise, which grows with the square of the depth [1/m].
    """
    rows, columns = z.shape
    parent = np.full(rows * columns, -1, np.int32)
    for r in range(rows):
        for c in range(columns):
            if not use[r, c]:
                continue
            a = r * columns + c
            parent[a] = a
            limit = jump_m + jump_per_z2 * z[r, c] * z[r, c]
            if c > 0 and use[r, c - 1] and abs(z[r, c] - z[r, c - 1]) <= limit:
                _join(parent, a, a - 1)
            if r > 0 and use[r - 1, c] and abs(z[r, c] - z[r - 1, c]) <= limit:
                _join(parent, a, a - columns)
    number, m = np.full(rows * columns, -1, np.int32), 0
    label = np.full((rows, columns), -1, np.int32)
    for a in range(rows * columns):
        if parent[a] >= 0:
            root = _root(parent, a)
            if number[root] < 0:
                number[root] = m
                m += 1
            label[a // columns, a % columns] = number[root]
    out = Pieces(
        label, np.zeros(m, np.int64), np.zeros(m, np.int64),
        np.full((m, 2), 1 << 30, np.int64), np.full((m, 2), -1, np.int64),
        np.zeros((m, 3)), np.full(m, np.inf),
    )  # fmt: skip
    for r in range(rows):
        for c in range(columns):
            i = label[r, c]
            if i >= 0:
                _add(out, i, r, c, points[r, c], z[r, c], free[r, c])
    for i in range(m):
        for k in range(3):
            out.mean[i, k] /= out.size[i]
    return out


@njit
def _add(out: Pieces, i: int, r: int, c: int, point: Array, z: float, free: bool) -> None:
    out.size[i] += 1
    if free:
        out.free[i] += 1
    out.first[i, 0], out.last[i, 0] = min(out.first[i, 0], r), max(out.last[i, 0], r)
    out.first[i, 1], out.last[i, 1] = min(out.first[i, 1], c), max(out.last[i, 1], c)
    for k in range(3):
        out.mean[i, k] += point[k]
    out.near[i] = min(out.near[i], z)


@njit
def _root(parent: NDArray[np.int32], a: int) -> int:
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@njit
def _join(parent: NDArray[np.int32], a: int, b: int) -> None:
    ra, rb = _root(parent, a), _root(parent, b)
    if ra < rb:
        parent[rb] = ra
    elif rb < ra:
        parent[ra] = rb
