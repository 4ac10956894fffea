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

from skyhaul.jit import njit, njit_inner
from skyhaul.perception.events.api import Float32
from skyhaul.perception.events.graph import (
    EDGE,
    EVALUATED,
    REFRACTORY,
    GraphMemory,
    GraphRules,
    Neighbours,
    Stream,
    insert,
)
from skyhaul.perception.events.surface import INPUTS, PLANE_EDGE, PLANE_NODE
from skyhaul.perception.events.weights import STACK, WIDTH, PackedWeights
from skyhaul.types import IntArray

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
    features: Float32  # (rows, L * C) inputs of every layer, of each node
    score: Float32  # (rows,) p_mover of each node
    pool: PoolMemory
    work: IntArray  # (7,)
    scratch: Float32  # (3, L * C) means over neighbours; a layer's output; the node's row
    stacked: Float32  # (STACK,) what a layer multiplies; ends with 1 and zeros


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
    stream: Stream, rules: GraphRules, pooling: PoolRules, weights: PackedWeights,
    memory: NetworkMemory, p_mover: Float32,
) -> None:  # fmt: skip
    """Take events in one by one and write the probability of each."""
    work, acc, node = memory.work, memory.scratch[1], memory.scratch[2]
    for i in range(stream.t_us.shape[0]):
        work[EVENTS] += 1
        kind, n, row = insert(i, stream, rules, memory.graph, memory.found)
        if kind == REFRACTORY:
            work[REFRACTORY_COUNT] += 1
            p_mover[i] = memory.score[row]
            continue
        work[EDGES] += n
        work[MULTIPLY_ADDS] += PLANE_NODE + n * PLANE_EDGE
        for c in range(INPUTS):
            node[c] = memory.found.inputs[c]
        if kind == EVALUATED:
            _layers(n, weights, memory)
            cy, cx = stream.y[i] // pooling.cell_px, stream.x[i] // pooling.cell_px
            _pool(acc, cy, cx, stream.t_us[i] // pooling.period_us, pooling.prune, weights, memory)
            logit = weights.output_bias[1]
            for c in range(WIDTH):
                context = memory.pool.context[cy, cx, c]
                logit += acc[c] * weights.outputs[1, c] + context * weights.outputs[2, c]
            memory.score[row] = _sigmoid(logit)
            work[MULTIPLY_ADDS] += 2 * WIDTH
        else:
            work[LONELY_COUNT] += 1
            for c in range(WIDTH, node.shape[0]):
                node[c] = np.float32(0.0)
            memory.score[row] = np.float32(0.0)
        for c in range(node.shape[0]):
            memory.features[row, c] = node[c]
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


@njit_inner
def _layers(n: int, weights: PackedWeights, memory: NetworkMemory) -> None:
    """All layers of one node: inputs of layers 1.. to scratch[2], the last output to scratch[1]."""
    count, tables = weights.stack.shape[0], weights.table.shape[0] > 0
    sums, acc, node = memory.scratch[0], memory.scratch[1], memory.scratch[2]
    z = memory.stacked
    share = np.float32(1.0) / np.float32(max(n, 1))
    macs = count * (WIDTH + EDGE) * WIDTH
    for c in range(EDGE):
        z[2 * WIDTH + c] = memory.found.mean_edge[c]
    if tables:
        macs += count * n * WIDTH * WIDTH
    else:
        _scaled_sums(n, share, weights.scale, memory, sums)
        macs += count * (n + WIDTH) * WIDTH
    for layer in range(count):
        first = layer * WIDTH
        for c in range(WIDTH):
            acc[c] = np.float32(0.0)
            z[c] = node[first + c]
            z[WIDTH + c] = sums[first + c]
        if tables:
            for m in range(n):
                _add_table(memory.features, memory.found.node[m], first, weights.table, layer,
                           memory.found.offset[m], acc)  # fmt: skip
            for c in range(WIDTH):
                acc[c] *= share
        _add_stack(z, weights.stack, layer, acc)
        for c in range(WIDTH):
            acc[c] = max(acc[c], np.float32(0.0))
        if layer > 0:
            for c in range(WIDTH):
                acc[c] += node[first + c]
        if layer + 1 < count:
            for c in range(WIDTH):
                node[first + WIDTH + c] = acc[c]
    memory.work[MULTIPLY_ADDS] += macs


@njit_inner
def _scaled_sums(
    n: int, share: np.float32, scale: Float32, memory: NetworkMemory, sums: Float32
) -> None:
    """Mean over neighbours of scale[offset] * h_j, for the inputs of all layers at once."""
    width = scale.shape[1]
    for c in range(width):
        sums[c] = np.float32(0.0)
    for m in range(n):
        j, o = memory.found.node[m], memory.found.offset[m]
        for c in range(width):
            sums[c] += scale[o, c] * memory.features[j, c]
    for c in range(width):
        sums[c] *= share


@njit_inner
def _add_stack(z: Float32, stack: Float32, layer: int, acc: Float32) -> None:
    """Add z @ stack[layer] to acc, eight rows at a time."""
    for a in range(0, STACK, 8):
        z0, z1, z2, z3 = z[a], z[a + 1], z[a + 2], z[a + 3]
        z4, z5, z6, z7 = z[a + 4], z[a + 5], z[a + 6], z[a + 7]
        for c in range(WIDTH):
            acc[c] += (
                z0 * stack[layer, a, c] + z1 * stack[layer, a + 1, c]
                + z2 * stack[layer, a + 2, c] + z3 * stack[layer, a + 3, c]
                + z4 * stack[layer, a + 4, c] + z5 * stack[layer, a + 5, c]
                + z6 * stack[layer, a + 6, c] + z7 * stack[layer, a + 7, c]
            )  # fmt: skip


@njit_inner
def _add_table(
    features: Float32, row: int, first: int, table: Float32, layer: int, offset: int, acc: Float32
) -> None:
    """Add a neighbour's inputs of a layer, times its entry of the table, to acc."""
    for a in range(0, WIDTH, 8):
        f = first + a
        z0, z1, z2, z3 = (
            features[row, f], features[row, f + 1], features[row, f + 2], features[row, f + 3]
        )  # fmt: skip
        z4, z5, z6, z7 = (
            features[row, f + 4], features[row, f + 5], features[row, f + 6], features[row, f + 7]
        )  # fmt: skip
        for c in range(WIDTH):
            acc[c] += (
                z0 * table[layer, offset, a, c] + z1 * table[layer, offset, a + 1, c]
                + z2 * table[layer, offset, a + 2, c] + z3 * table[layer, offset, a + 3, c]
                + z4 * table[layer, offset, a + 4, c] + z5 * table[layer, offset, a + 5, c]
                + z6 * table[layer, offset, a + 6, c] + z7 * table[layer, offset, a + 7, c]
            )  # fmt: skip


@njit_inner
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


@njit_inner
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


@njit_inner
def _dot(a: Float32, b: Float32) -> np.float32:
    total = np.float32(0.0)
    for c in range(WIDTH):
        total += a[c] * b[c]
    return total


@njit_inner
def _sigmoid(z: np.float32) -> np.float32:
    return np.float32(1.0 / (1.0 + np.exp(-z)))
