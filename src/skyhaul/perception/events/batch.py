# SPDX-License-Identifier: Apache-2.0
"""The event network, evaluated for a whole stream at once: layer by layer over all nodes.

The same operator as `network`, in double precision: what training differentiates and what tests
hold the asynchronous evaluation against.
"""

from typing import NamedTuple

import numpy as np

from skyhaul.perception.events.graph import EVALUATED, LONELY, REFRACTORY, EventGraph
from skyhaul.perception.events.lens import EventLens
from skyhaul.perception.events.weights import WIDTH, Head, Layer, NetworkWeights
from skyhaul.sensors.api import EventReading
from skyhaul.types import Array, IntArray, TimeUs


class BatchResult(NamedTuple):
    """What the network finds for a stream."""

    features: Array  # (k, C) output of the last layer; 0 for events that are not evaluated
    p_mover: Array  # (k,)
    objectness: Array  # (rows, cols) at the stamp


def evaluate(
    weights: NetworkWeights, lens: EventLens, events: EventReading, graph: EventGraph,
    stamp_us: TimeUs,
) -> BatchResult:  # fmt: skip
    """All events of a stream from its first one, cells at a stamp not before its last."""
    runs = graph.status == EVALUATED
    h = graph.inputs.astype(np.float64)
    for i, layer in enumerate(weights.layers):
        h = np.where(runs[:, None], convolve(layer, h, graph, residual=i > 0), 0.0)
    rows, cols = -(-lens.height // weights.cell_px), -(-lens.width // weights.cell_px)
    cell = (events.y // weights.cell_px).astype(np.int64) * cols + events.x // weights.cell_px
    period = events.t_us // weights.period_us
    p_mover = np.zeros(len(runs))
    last = np.zeros((rows * cols, WIDTH))
    for which in np.unique(cell[runs]):
        mine = np.flatnonzero(runs & (cell == which))
        running, last[which] = running_maximum(h[mine], period[mine], stamp_us // weights.period_us)
        z = _context(weights.head, running)
        head = weights.head
        logit = h[mine] @ head.event + z @ head.context + head.event_bias[0]
        p_mover[mine] = _sigmoid(logit)
    late = np.flatnonzero(graph.status == REFRACTORY)
    p_mover[late] = p_mover[graph.same_as[late]]
    logit = _context(weights.head, last) @ weights.head.objectness
    objectness = _sigmoid(logit + weights.head.objectness_bias[0])
    return BatchResult(h, p_mover, objectness.reshape(rows, cols))


def convolve(layer: Layer, h: Array, graph: EventGraph, *, residual: bool) -> Array:
    """One layer for all nodes: (k, inputs) -> (k, C)."""
    k = len(h)
    message = graph.edge @ layer.edge
    if layer.table is not None:
        for o in range(len(layer.table)):
            edges = graph.offset == o
            message[edges] += h[graph.source[edges]] @ layer.table[o]
    if layer.mix is not None and layer.scale is not None:
        message += (layer.scale[graph.offset] * h[graph.source]) @ layer.mix
    degree = np.bincount(graph.target, minlength=k)
    total = np.zeros((k, WIDTH))
    np.add.at(total, graph.target, message)
    mean = total / np.maximum(degree, 1)[:, None]
    new: Array = np.maximum(h @ layer.root + mean + layer.bias, 0.0)
    return h + new if residual else new


def running_maximum(h: Array, period: IntArray, stamp_period: int) -> tuple[Array, Array]:
    """Maximum over a cell's events of this period so far and the whole period before.

    Args:
        h: Features of the cell's events in order of time, (k, C).
        period: Pooling period of each, (k,).
        stamp_period: The period of the time at which the second result holds.

    Returns:
        The maximum after each event, (k, C), and at the stamp, (C,); 0 where there is none.
    """
    running, tops = np.empty_like(h), {}
    for which in np.unique(period):
        mine = period == which
        grown = np.maximum.accumulate(h[mine], axis=0)
        tops[which] = grown[-1]
        running[mine] = np.maximum(grown, tops.get(which - 1, 0.0))
    none = np.zeros(h.shape[1])
    at_stamp = np.maximum(tops.get(stamp_period, none), tops.get(stamp_period - 1, none))
    return running, at_stamp


def counts(graph: EventGraph) -> tuple[int, int]:
    """Lonely and refractory events of a graph."""
    return int(np.sum(graph.status == LONELY)), int(np.sum(graph.status == REFRACTORY))


def _context(head: Head, maximum: Array) -> Array:
    z: Array = np.maximum(maximum @ head.cell + head.cell_bias, 0.0)
    return z


def _sigmoid(z: Array) -> Array:
    p: Array = 1.0 / (1.0 + np.exp(-z))
    return p
