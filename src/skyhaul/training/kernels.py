# SPDX-License-Identifier: Apache-2.0
"""The two operations of the event network that frameworks have no fast form of, with gradients."""

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit
from skyhaul.perception.events.api import Float32
from skyhaul.types import IntArray

Index = NDArray[np.int32]


@njit
def mean_of_neighbours(
    h: Float32, scale: Float32, first: IntArray, source: Index, offset: Index, out: Float32
) -> None:
    """Mean over a node's edges of scale[offset] * h[source], (k, C).

    Args:
        h: Features of the nodes, (k, C).
        scale: Of each offset, (o, C).
        first: Edges of node i are rows first[i] to first[i + 1], (k + 1,).
        source: Node at the old end of each edge; negative: none that counts, (e,).
        offset: Of each edge, (e,).
        out: Result, 0 without edges, (k, C).
    """
    for i in range(out.shape[0]):
        share = np.float32(1.0) / np.float32(max(first[i + 1] - first[i], 1))
        for c in range(out.shape[1]):
            out[i, c] = np.float32(0.0)
        for e in range(first[i], first[i + 1]):
            j, o = source[e], offset[e]
            if j >= 0:
                for c in range(out.shape[1]):
                    out[i, c] += scale[o, c] * h[j, c]
        for c in range(out.shape[1]):
            out[i, c] *= share


@njit
def mean_of_neighbours_back(
    g: Float32, h: Float32, scale: Float32, first: IntArray, source: Index, offset: Index,
    g_h: Float32, g_scale: Float32,
) -> None:  # fmt: skip
    """Adds the gradients of `mean_of_neighbours` for h and scale, given that of its result."""
    for i in range(g.shape[0]):
        share = np.float32(1.0) / np.float32(max(first[i + 1] - first[i], 1))
        for e in range(first[i], first[i + 1]):
            j, o = source[e], offset[e]
            if j >= 0:
                for c in range(g.shape[1]):
                    v = share * g[i, c]
                    g_h[j, c] += scale[o, c] * v
                    g_scale[o, c] += h[j, c] * v


@njit
def running_argmax(
    h: Float32, runs: NDArray[np.bool_], cell: IntArray, period: IntArray, out: IntArray
) -> None:
    """Which event of a cell, in this period so far or the one before, is largest, (k, C).

    `out` is k where no feature is above 0, and for events that do not run.
    """
    k, width, cells = h.shape[0], h.shape[1], 1 + np.max(cell)
    now, before = np.full((cells, width), k), np.full((cells, width), k)
    last = np.full(cells, -9)
    for i in range(k):
        for c in range(width):
            out[i, c] = k
        if not runs[i]:
            continue
        z = cell[i]
        if period[i] != last[z]:
            for c in range(width):
                before[z, c] = now[z, c] if period[i] - last[z] == 1 else k
                now[z, c] = k
            last[z] = period[i]
        for c in range(width):
            j, b = now[z, c], before[z, c]
            top = h[j, c] if j < k else np.float32(0.0)
            if h[i, c] > top:
                now[z, c], j, top = i, i, h[i, c]
            out[i, c] = b if b < k and h[b, c] > top else j
