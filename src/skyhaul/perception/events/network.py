# SPDX-License-Identifier: Apache-2.0
"""The event network, evaluated event by event: each new node once, no older one ever again.

Edges run from older to newer events only, so that a node's features never change after its
event: what `batch.evaluate` finds for a whole stream is found here one event at a time.

Source:    Paper, asynchronous graph network: convolution and recursive update; Schaefer, Gehrig
    and Scaramuzza, "AEGNN" (CVPR 2022) for the asynchronous evaluation of event graphs.
Deviation: The paper prints two rules that differ and drops the term in e_ij; here is one
    operator on a causal graph (PAPER_NOTES 51, 52); see
    `test_asynchronous_is_batch_on_a_real_stream`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit
from skyhaul.perception.events.api import Float32
from skyhaul.perception.events.graph import (
    EDGE,
    EVALUATED,
    REFRACTORY,
    GraphMemory,
    GraphRules,
    Neighbours,
    insert,
)
from skyhaul.perception.events.weights import WIDTH, PackedWeights
from skyhaul.types import Array, IntArray

# mypy: disable-error-code="no-any-return"

LONELY_COUNT, REFRACTORY_COUNT, EDGES, MULTIPLY_ADDS, UPDATES, PRUNES, EVENTS = range(7)
"""Layout of `NetworkMemory.work`."""

_NO_PERIOD = -(2**62)


class PoolMemory(NamedTuple):
    """Maxima of the features over each cell's events; moved on in place."""

    now: Float32  # (rows, cols, C) maximum of the cell's pooling period
    before: Float32  # (rows, cols, C) of the period before
    context: Float32  # (rows, cols, C) z of the maximum
    objectness: Float32  # (rows, cols)
    period: IntArray  # (rows, cols) which period `now` is of


class NetworkMemory(NamedTuple):
    """All that the network keeps; moved on in place."""

    graph: GraphMemory
    found: Neighbours
    features: Float32  # (capacity, L * C) inputs of every layer, of each node
    score: Float32  # (capacity,) p_mover of each node
    pool: PoolMemory
    work: IntArray  # (7,)
    scratch: Float32  # (2, max(L, 2) * C) sums over neighbours; a layer's input and output


class PoolRules(NamedTuple):
    """How cells pool."""

    cell_px: int
    period_us: int
    prune: bool  # evaluate a cell's layers only where its maximum changed


def pool_memory(width: int, height: int, cell_px: int) -> PoolMemory:
    """Cells without an event."""
    rows, cols = -(-height // cell_px), -(-width // cell_px)
    return PoolMemory(
        now=np.zeros((rows, cols, WIDTH), np.float32),
        before=np.zeros((rows, cols, WIDTH), np.float32),
        context=np.zeros((rows, cols, WIDTH), np.float32),
        objectness=np.zeros((rows, cols), np.float32),
        period=np.full((rows, cols), _NO_PERIOD),
    )


@njit
def run_events(
    t_us: IntArray, x: NDArray[np.int16], y: NDArray[np.int16], p: NDArray[np.int8],
    turn_C: Array, flow: Float32, rules: GraphRules, pooling: PoolRules,
    weights: PackedWeights, memory: NetworkMemory, p_mover: Float32,
) -> None:  # fmt: skip
    """Take events in one by one and write the probability of each."""
    work = memory.work
    for i in range(t_us.shape[0]):
        work[EVENTS] += 1
        kind, n, row = insert(
            t_us[i], x[i], y[i], p[i], turn_C[i], flow, rules, memory.graph, memory.found
        )
        if kind == REFRACTORY:
            work[REFRACTORY_COUNT] += 1
            p_mover[i] = memory.score[row]
            continue
        work[EDGES] += n
        node = memory.features[row]
        node[:] = np.float32(0.0)
        node[0], node[1] = p[i], np.float32(1.0)
        if kind == EVALUATED:
            _layers(n, node, weights, memory)
            cy, cx = y[i] // pooling.cell_px, x[i] // pooling.cell_px
            h = memory.scratch[1, :WIDTH]
            _pool(h, cy, cx, t_us[i] // pooling.period_us, pooling.prune, weights, memory)
            memory.score[row] = _sigmoid(
                weights.output_bias[1]
                + _dot(h, weights.outputs[1])
                + _dot(memory.pool.context[cy, cx], weights.outputs[2])
            )
            work[MULTIPLY_ADDS] += 2 * WIDTH
        else:
            work[LONELY_COUNT] += 1
            memory.score[row] = np.float32(0.0)
        p_mover[i] = memory.score[row]


@njit
def cells_at(
    t_us: int, pooling: PoolRules, weights: PackedWeights, memory: NetworkMemory, out: Float32
) -> None:
    """Objectness of every cell at a time not before the newest event, into (rows, cols)."""
    pool, period = memory.pool, t_us // pooling.period_us
    context = np.empty(WIDTH, np.float32)
    zero = np.zeros(WIDTH, np.float32)
    empty = _cell_layers(zero, zero, weights, context)
    for cy in range(out.shape[0]):
        for cx in range(out.shape[1]):
            age = period - pool.period[cy, cx]
            if age == 0:
                out[cy, cx] = pool.objectness[cy, cx]
            elif age == 1:
                out[cy, cx] = _cell_layers(pool.now[cy, cx], zero, weights, context)
            else:
                out[cy, cx] = empty


@njit
def _layers(n: int, node: Float32, weights: PackedWeights, memory: NetworkMemory) -> None:
    """All layers of one node: inputs of layers 1.. into `node`, the last output to scratch[1]."""
    count, tables = weights.root.shape[0], weights.table.shape[0] > 0
    sums, acc = memory.scratch[0], memory.scratch[1]
    share = np.float32(1.0) / np.float32(max(n, 1))
    rows, macs = 4, 0
    if not tables:
        _scaled_sums(n, count * WIDTH, weights.scale, memory, sums)
        macs += n * count * WIDTH
    for layer in range(count):
        first = layer * WIDTH
        for c in range(WIDTH):
            acc[c] = np.float32(0.0)
        if tables:
            for m in range(n):
                other = memory.features[memory.found.node[m]]
                table = weights.table[layer, memory.found.offset[m]]
                _add_product(other, first, rows, table, acc)
            macs += n * rows * WIDTH
        else:
            _add_product(sums, first, rows, weights.mix[layer], acc)
            macs += rows * WIDTH
        for c in range(WIDTH):
            acc[c] = share * acc[c] + weights.bias[layer, c]
        _add_product(node, first, rows, weights.root[layer], acc)
        _add_product(memory.found.mean_edge, 0, EDGE, weights.edge[layer], acc)
        macs += (rows + EDGE) * WIDTH
        for c in range(WIDTH):
            acc[c] = max(acc[c], np.float32(0.0))
            if layer > 0:
                acc[c] += node[first + c]
            if layer + 1 < count:
                node[first + WIDTH + c] = acc[c]
        rows = WIDTH
    memory.work[MULTIPLY_ADDS] += macs


@njit
def _scaled_sums(n: int, width: int, scale: Float32, memory: NetworkMemory, sums: Float32) -> None:
    """Sum over neighbours of scale[offset] * h_j, for the inputs of all layers at once."""
    for c in range(width):
        sums[c] = np.float32(0.0)
    for m in range(n):
        other, by = memory.features[memory.found.node[m]], scale[memory.found.offset[m]]
        for c in range(width):
            sums[c] += by[c] * other[c]


@njit
def _add_product(z: Float32, first: int, rows: int, W: Float32, acc: Float32) -> None:
    """Add z[first : first + rows] @ W to acc; rows is a multiple of 4."""
    for a in range(0, rows, 4):
        z0, z1, z2, z3 = z[first + a], z[first + a + 1], z[first + a + 2], z[first + a + 3]
        for c in range(WIDTH):
            acc[c] += z0 * W[a, c] + z1 * W[a + 1, c] + z2 * W[a + 2, c] + z3 * W[a + 3, c]


@njit
def _pool(
    h: Float32, cy: int, cx: int, period: int, prune: bool, weights: PackedWeights,
    memory: NetworkMemory,
) -> None:  # fmt: skip
    """Take a node's features into its cell; evaluate the cell's layers if its maximum changed."""
    pool = memory.pool
    now, before = pool.now[cy, cx], pool.before[cy, cx]
    changed = not prune
    if period != pool.period[cy, cx]:
        follows = period - pool.period[cy, cx] == 1
        for c in range(WIDTH):
            before[c] = now[c] if follows else np.float32(0.0)
            now[c] = np.float32(0.0)
        pool.period[cy, cx] = period
        changed = True
    for c in range(WIDTH):
        if h[c] > now[c]:
            now[c] = h[c]
            changed = changed or h[c] > before[c]
    if not changed:
        memory.work[PRUNES] += 1
        return
    memory.work[UPDATES] += 1
    memory.work[MULTIPLY_ADDS] += (WIDTH + 1) * WIDTH
    pool.objectness[cy, cx] = _cell_layers(now, before, weights, pool.context[cy, cx])


@njit
def _cell_layers(
    now: Float32, before: Float32, weights: PackedWeights, context: Float32
) -> np.float32:
    """A cell's objectness; writes its z."""
    for c in range(WIDTH):
        context[c] = weights.cell_bias[c]
    for a in range(WIDTH):
        largest = max(now[a], before[a])
        for c in range(WIDTH):
            context[c] += largest * weights.cell[a, c]
    for c in range(WIDTH):
        context[c] = max(context[c], np.float32(0.0))
    return _sigmoid(weights.output_bias[0] + _dot(context, weights.outputs[0]))


@njit
def _dot(a: Float32, b: Float32) -> np.float32:
    total = np.float32(0.0)
    for c in range(WIDTH):
        total += a[c] * b[c]
    return total


@njit
def _sigmoid(z: np.float32) -> np.float32:
    return np.float32(1.0 / (1.0 + np.exp(-z)))
