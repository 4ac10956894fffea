# SPDX-License-Identifier: Apache-2.0
"""The event graph: each event is a node, edges run from older events to newer ones only.

A new event at a pixel is joined with the newest events of the pixels around it, nearest pixels
first, inside radius r and window T, at most K of them. Every pixel keeps its Q newest events, the
nodes live in a circular store. What an edge carries is what the camera's own rotation does not
explain of the way from j to i:

    e_ij = ((u_i - u_j - A_i (turn_i - turn_j)) / r, (t_i - t_j) / T, p_i p_j)
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit
from skyhaul.params import Params
from skyhaul.perception.events.api import Float32
from skyhaul.perception.events.lens import EventLens
from skyhaul.sensors.api import EventReading
from skyhaul.types import Array, IntArray

# mypy: disable-error-code="no-any-return"

EVALUATED, LONELY, REFRACTORY = 0, 1, 2
"""What became of an event."""

EDGE = 4
"""Entries of an edge's attribute."""


@dataclass(frozen=True, kw_only=True)
class GraphParams(Params):
    """Which events are joined, and which are skipped."""

    radius_px: int = 3
    """Radius r of the neighbourhood [px]."""
    window_us: int = 20_000
    """Window T: older events are no neighbours [us]."""
    max_neighbours: int = 16
    """K."""
    per_pixel: int = 4
    """Q: newest events that a pixel remembers."""
    capacity: int = 32_768
    """Newest events that are remembered in all; a power of two."""
    min_neighbours: int = 2
    """Insertion skip: an event with fewer is a node but is not evaluated; 0 evaluates all."""
    refractory_us: int = 500
    """Insertion skip: an event so soon after one of its polarity at its pixel is no node [us]."""

    def __post_init__(self) -> None:
        for name in ("radius_px", "window_us", "max_neighbours", "per_pixel", "capacity"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be >= 1, got {getattr(self, name)}")
        if self.capacity & (self.capacity - 1):
            raise ValueError(f"capacity must be a power of two, got {self.capacity}")
        if min(self.min_neighbours, self.refractory_us) < 0:
            raise ValueError("min_neighbours and refractory_us must be >= 0")


class GraphRules(NamedTuple):
    """The parameters for the kernels."""

    offsets: NDArray[np.int32]  # (o, 2) dx, dy of the neighbourhood, nearest first
    radius: float
    window_us: int
    max_neighbours: int
    capacity: int
    min_neighbours: int
    refractory_us: int


class GraphMemory(NamedTuple):
    """Nodes so far; moved on in place."""

    newest_us: IntArray  # (height, width) newest node of each pixel
    ring: IntArray  # (height, width, Q) its newest nodes
    fired: IntArray  # (height, width) how many it ever had
    t_us: IntArray  # (capacity,)
    p: NDArray[np.int8]  # (capacity,)
    turn_C: Array  # (capacity, 3)
    event: IntArray  # (capacity,) index of the node's event in the stream
    total: IntArray  # (2,) nodes and events so far


class Neighbours(NamedTuple):
    """Of the event in hand, one row per edge; overwritten by each event."""

    node: IntArray  # (K,) rows in the store
    offset: IntArray  # (K,) which offset
    mean_edge: Float32  # (EDGE,) mean of e_ij; 0 without neighbours


class EventGraph(NamedTuple):
    """The graph of a whole stream, for training and as the oracle's input."""

    status: NDArray[np.int8]  # (k,)
    source: IntArray  # (e,) older event of each edge, index in the stream
    target: IntArray  # (e,)
    offset: IntArray  # (e,)
    edge: Array  # (e, EDGE)
    same_as: IntArray  # (k,) refractory events: the event that stands for it, else -1


_NEVER = -(2**62)


def spiral(radius_px: int) -> NDArray[np.int32]:
    """Offsets (dx, dy) inside a radius, nearest first, ties by angle: (o, 2)."""
    span = range(-radius_px, radius_px + 1)
    disc = [(dx, dy) for dx in span for dy in span if dx * dx + dy * dy <= radius_px**2]
    disc.sort(key=lambda d: (d[0] ** 2 + d[1] ** 2, np.arctan2(d[1], d[0])))
    return np.array(disc, np.int32)


def graph_rules(params: GraphParams) -> GraphRules:
    """Parameters as the kernels take them."""
    return GraphRules(
        spiral(params.radius_px),
        float(params.radius_px),
        params.window_us,
        params.max_neighbours,
        params.capacity,
        params.min_neighbours,
        params.refractory_us,
    )


def graph_memory(params: GraphParams, width: int, height: int) -> GraphMemory:
    """Memory without a node."""
    n = params.capacity
    return GraphMemory(
        newest_us=np.full((height, width), _NEVER),
        ring=np.full((height, width, params.per_pixel), -1, np.int64),
        fired=np.zeros((height, width), np.int64),
        t_us=np.zeros(n, np.int64),
        p=np.zeros(n, np.int8),
        turn_C=np.zeros((n, 3)),
        event=np.zeros(n, np.int64),
        total=np.zeros(2, np.int64),
    )


def no_neighbours(params: GraphParams) -> Neighbours:
    """Room for the neighbours of one event."""
    k = params.max_neighbours
    return Neighbours(np.zeros(k, np.int64), np.zeros(k, np.int64), np.zeros(EDGE, np.float32))


def event_graph(
    params: GraphParams, lens: EventLens, events: EventReading, turn_C: Array
) -> EventGraph:
    """The graph of a whole stream, by the kernel that the asynchronous network uses."""
    k = len(events.t_us)
    room = (
        np.empty(k, np.int8),
        np.empty((k * params.max_neighbours, 3), np.int64),
        np.empty((k * params.max_neighbours, EDGE)),
        np.full(k, -1),
    )
    memory = graph_memory(params, lens.width, lens.height)
    rules = graph_rules(params)
    n = _edges(events.t_us, events.x, events.y, events.p, turn_C, lens.turn_flow, rules, memory,
               no_neighbours(params), *room)  # fmt: skip
    status, ends, edge, same_as = room
    source, target, offset = ends[:n].T.copy()
    return EventGraph(status, source, target, offset, edge[:n], same_as)


@njit
def insert(
    t: int, x: int, y: int, p: int, turn: Array, flow: Float32, rules: GraphRules,
    memory: GraphMemory, out: Neighbours,
) -> tuple[int, int, int]:  # fmt: skip
    """Join one event to the graph: its status, its number of neighbours, its row in the store.

    A refractory event gets no row of its own but that of the node before it at its pixel.
    Neighbours and mean edge are written to `out`.
    """
    memory.total[1] += 1
    mask, total = rules.capacity - 1, memory.total[0]
    turns = memory.fired[y, x]
    depth = memory.ring.shape[2]
    if turns > 0 and t - memory.newest_us[y, x] < rules.refractory_us:
        before = memory.ring[y, x, (turns - 1) % depth]
        if total - before <= mask and memory.p[before & mask] == p:
            return REFRACTORY, 0, before & mask
    n = _find(t, x, y, rules, memory, out)
    _mean_edge(n, t, p, turn, flow[y, x], rules, memory, out)
    row = total & mask
    memory.t_us[row] = t
    memory.p[row] = p
    for c in range(3):
        memory.turn_C[row, c] = turn[c]
    memory.event[row] = memory.total[1] - 1
    memory.ring[y, x, turns % depth] = total
    memory.fired[y, x] = turns + 1
    memory.newest_us[y, x] = t
    memory.total[0] = total + 1
    return LONELY if n < rules.min_neighbours else EVALUATED, n, row


@njit
def _find(t: int, x: int, y: int, rules: GraphRules, memory: GraphMemory, out: Neighbours) -> int:
    """Neighbours of a new event, nearest pixels first, newest first in a pixel: how many."""
    height, width, depth = memory.ring.shape
    mask, total = rules.capacity - 1, memory.total[0]
    oldest = t - rules.window_us
    n = 0
    for k in range(rules.offsets.shape[0]):
        u, v = x + rules.offsets[k, 0], y + rules.offsets[k, 1]
        if u < 0 or v < 0 or u >= width or v >= height or memory.newest_us[v, u] < oldest:
            continue
        turns = memory.fired[v, u]
        for q in range(min(depth, turns)):
            node = memory.ring[v, u, (turns - 1 - q) % depth]
            if total - node > mask or memory.t_us[node & mask] < oldest:
                break
            out.node[n] = node & mask
            out.offset[n] = k
            n += 1
            if n == rules.max_neighbours:
                return n
    return n


@njit
def _mean_edge(
    n: int, t: int, p: int, turn: Array, flow: Float32, rules: GraphRules,
    memory: GraphMemory, out: Neighbours,
) -> None:  # fmt: skip
    """Mean of e_ij over the neighbours."""
    dx, dy, dt, pp, a, b, c = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(n):
        row, k = out.node[m], out.offset[m]
        dx -= rules.offsets[k, 0]
        dy -= rules.offsets[k, 1]
        dt += t - memory.t_us[row]
        pp += p * memory.p[row]
        a += turn[0] - memory.turn_C[row, 0]
        b += turn[1] - memory.turn_C[row, 1]
        c += turn[2] - memory.turn_C[row, 2]
    share = 1.0 / max(n, 1)
    dx -= flow[0, 0] * a + flow[0, 1] * b + flow[0, 2] * c
    dy -= flow[1, 0] * a + flow[1, 1] * b + flow[1, 2] * c
    out.mean_edge[0] = share * dx / rules.radius
    out.mean_edge[1] = share * dy / rules.radius
    out.mean_edge[2] = share * dt / rules.window_us
    out.mean_edge[3] = share * pp


@njit
def _edges(
    t_us: IntArray, x: NDArray[np.int16], y: NDArray[np.int16], p: NDArray[np.int8],
    turn_C: Array, flow: Float32, rules: GraphRules, memory: GraphMemory, found: Neighbours,
    status: NDArray[np.int8], ends: IntArray, edge: Array, same_as: IntArray,
) -> int:  # fmt: skip
    e = 0
    for i in range(t_us.shape[0]):
        kind, n, row = insert(t_us[i], x[i], y[i], p[i], turn_C[i], flow, rules, memory, found)
        status[i] = kind
        if kind == REFRACTORY:
            same_as[i] = memory.event[row]
        for m in range(n):
            j, k = found.node[m], found.offset[m]
            ends[e, 0], ends[e, 1], ends[e, 2] = memory.event[j], i, k
            for c in range(2):
                turned = 0.0
                for d in range(3):
                    turned += flow[y[i], x[i], c, d] * (turn_C[i, d] - memory.turn_C[j, d])
                edge[e, c] = (-rules.offsets[k, c] - turned) / rules.radius
            edge[e, 2] = (t_us[i] - memory.t_us[j]) / rules.window_us
            edge[e, 3] = p[i] * memory.p[j]
            e += 1
    return e
