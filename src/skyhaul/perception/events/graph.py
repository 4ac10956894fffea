# SPDX-License-Identifier: Apache-2.0
"""The event graph: each event is a node, edges run from older events to newer ones only.

A new event at a pixel is joined with the newest events of the pixels around it, nearest pixels
first, inside radius r and window T, at most K of them. Every pixel keeps its Q newest events.
What an edge carries is what the camera's own rotation does not explain of the way from j to i:

    d_ij = u_i - u_j - A_i (turn_i - turn_j)
    e_ij = (d_ij / r, (t_i - t_j) / T, p_i p_j)

A node starts with what its edges tell of its motion (`surface`): the slope of the surface of newest
times around it, and how well it goes with the camera's own velocity.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit, njit_inner
from skyhaul.params import Params
from skyhaul.perception.events.api import Float32
from skyhaul.perception.events.lens import EventLens
from skyhaul.perception.events.surface import (
    INPUTS,
    Surface,
    fitted_plane,
    no_surface,
    node_inputs,
)
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
    window_us: int = 100_000
    """Window T: older events are no neighbours [us]."""
    max_neighbours: int = 16
    """K."""
    per_pixel: int = 1
    """Q: newest events that a pixel remembers."""
    min_neighbours: int = 2
    """Insertion skip: an event with fewer is a node but is not evaluated; 0 evaluates all."""
    refractory_us: int = 500
    """Insertion skip: an event so soon after one of its polarity at its pixel is no node [us]."""

    def __post_init__(self) -> None:
        for name in ("radius_px", "window_us", "max_neighbours", "per_pixel"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be >= 1, got {getattr(self, name)}")
        if min(self.min_neighbours, self.refractory_us) < 0:
            raise ValueError("min_neighbours and refractory_us must be >= 0")


class GraphRules(NamedTuple):
    """The parameters for the kernels."""

    offsets: NDArray[np.int32]  # (o, 2) dx, dy of the neighbourhood, nearest first
    radius: int
    window_us: int
    max_neighbours: int
    min_neighbours: int
    refractory_us: int


class GraphMemory(NamedTuple):
    """Nodes that pixels remember; moved on in place.

    The image has a margin of r pixels in which nothing fires. Pixel (x, y) is entry
    m = (y + r) (width + 2 r) + x + r, its nodes are the rows m Q to m Q + Q - 1.
    """

    newest: IntArray  # (pixels,) row of each pixel's newest node
    t_us: IntArray  # (rows,) far in the past without a node
    p: Float32  # (rows,)
    turn_C: Array  # (rows, 3) [rad]
    since_us: IntArray  # (rows,) from when on the pixel has fired without a pause of T
    steps: IntArray  # (o,) from a pixel's entry to that of each offset
    total: IntArray  # (1,) events so far


class Neighbours(NamedTuple):
    """Of the event in hand, one row per edge; overwritten by each event."""

    node: IntArray  # (K,) rows in the memory
    offset: IntArray  # (K,) which offset
    edge: Array  # (K, EDGE) e_ij
    mean_edge: Float32  # (EDGE,) mean of e_ij; 0 without neighbours
    surface: Surface
    inputs: Float32  # (INPUTS,) what the node starts with


class EventGraph(NamedTuple):
    """The graph of a whole stream, for training and as the oracle's input."""

    status: NDArray[np.int8]  # (k,)
    inputs: Float32  # (k, INPUTS) 0 for refractory events
    source: IntArray  # (e,) older event of each edge, index in the stream
    target: IntArray  # (e,) in order
    offset: IntArray  # (e,)
    edge: Array  # (e, EDGE)
    same_as: IntArray  # (k,) refractory events: the event that stands for it, else -1


class Stream(NamedTuple):
    """Events of one camera and how it moved, as the kernels take them."""

    t_us: IntArray  # (k,)
    x: NDArray[np.int16]
    y: NDArray[np.int16]
    p: NDArray[np.int8]
    turn_C: Array  # (k, 3) [rad]
    v_WC_C: Array  # (k, 3) [m/s]
    turn_flow: Float32  # of the lens
    move_flow: Float32


NEVER = -(2**62)


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
        params.radius_px,
        params.window_us,
        params.max_neighbours,
        params.min_neighbours,
        params.refractory_us,
    )


def graph_memory(params: GraphParams, width: int, height: int) -> GraphMemory:
    """Memory without a node."""
    r, depth = params.radius_px, params.per_pixel
    pixels = (width + 2 * r) * (height + 2 * r)
    offsets = spiral(r).astype(np.int64)
    return GraphMemory(
        newest=depth * np.arange(pixels, dtype=np.int64),
        t_us=np.full(pixels * depth, NEVER),
        p=np.zeros(pixels * depth, np.float32),
        turn_C=np.zeros((pixels * depth, 3)),
        since_us=np.zeros(pixels * depth, np.int64),
        steps=offsets[:, 1] * (width + 2 * r) + offsets[:, 0],
        total=np.zeros(1, np.int64),
    )


def no_neighbours(params: GraphParams) -> Neighbours:
    """Room for the neighbours of one event."""
    k = params.max_neighbours
    return Neighbours(
        node=np.zeros(k, np.int64),
        offset=np.zeros(k, np.int64),
        edge=np.zeros((k, EDGE)),
        mean_edge=np.zeros(EDGE, np.float32),
        surface=no_surface(k),
        inputs=np.zeros(INPUTS, np.float32),
    )


def stream_of(lens: EventLens, events: EventReading, turn_C: Array, v_WC_C: Array | None) -> Stream:
    """Events as the kernels take them; None: the camera does not move but turn."""
    v = np.zeros((len(events.t_us), 3)) if v_WC_C is None else v_WC_C
    return Stream(events.t_us, events.x, events.y, events.p, turn_C, v, lens.turn_flow,
                  lens.move_flow)  # fmt: skip


def event_graph(
    params: GraphParams,
    lens: EventLens,
    events: EventReading,
    turn_C: Array,
    v_WC_C: Array | None = None,
) -> EventGraph:
    """The graph of a whole stream, by the kernel that the asynchronous network uses."""
    k = len(events.t_us)
    status, same_as = np.empty(k, np.int8), np.full(k, -1)
    inputs = np.zeros((k, INPUTS), np.float32)
    ends = np.empty((k * params.max_neighbours, 3), np.int32)
    edge = np.empty((k * params.max_neighbours, EDGE), np.float32)
    n = _edges(
        stream_of(lens, events, turn_C, v_WC_C), graph_rules(params),
        graph_memory(params, lens.width, lens.height), no_neighbours(params),
        status, inputs, ends, edge, same_as,
    )  # fmt: skip
    source, target, offset = ends[:n].T.astype(np.int64)
    return EventGraph(status, inputs, source, target, offset, edge[:n].astype(np.float64), same_as)


@njit_inner
def insert(
    i: int, stream: Stream, rules: GraphRules, memory: GraphMemory, out: Neighbours
) -> tuple[int, int, int]:
    """Join event i to the graph: its status, its number of neighbours, its row in the memory.

    A refractory event gets no row of its own but that of the node before it at its pixel.
    Neighbours, edges and inputs are written to `out`. The row may be that of a neighbour, the
    oldest node of the same pixel: whoever keeps more of nodes reads the neighbours' first.
    """
    t, p = stream.t_us[i], np.float32(stream.p[i])
    x, y = int(stream.x[i]), int(stream.y[i])
    width = stream.turn_flow.shape[1] + 2 * rules.radius
    entry = (y + rules.radius) * width + x + rules.radius
    memory.total[0] += 1
    before = memory.newest[entry]
    if t - memory.t_us[before] < rules.refractory_us and memory.p[before] == p:
        return REFRACTORY, 0, before
    n = _find(t, entry, rules, memory, out)
    _carry(n, i, x, y, before, p, stream, rules, memory, out)
    depth = memory.t_us.shape[0] // memory.newest.shape[0]
    row = entry * depth + (before + 1 - entry * depth) % depth
    goes_on = t - memory.t_us[before] < rules.window_us
    memory.since_us[row] = memory.since_us[before] if goes_on else t
    memory.newest[entry] = row
    memory.t_us[row] = t
    memory.p[row] = p
    for c in range(3):
        memory.turn_C[row, c] = stream.turn_C[i, c]
    return LONELY if n < rules.min_neighbours else EVALUATED, n, row


@njit_inner
def _find(t: int, entry: int, rules: GraphRules, memory: GraphMemory, out: Neighbours) -> int:
    """Neighbours of a new event, nearest pixels first, newest first in a pixel: how many."""
    depth = memory.t_us.shape[0] // memory.newest.shape[0]
    oldest, most, n = t - rules.window_us, rules.max_neighbours, 0
    for k in range(memory.steps.shape[0]):
        other = entry + memory.steps[k]
        node = memory.newest[other] if depth > 1 else other
        for _ in range(depth):
            if memory.t_us[node] < oldest:
                break
            out.node[n] = node
            out.offset[n] = k
            n += 1
            if n == most:
                return n
            node = node - 1 if node > other * depth else node + depth - 1
    return n


@njit_inner
def _carry(
    n: int, i: int, x: int, y: int, before: int, p: np.float32, stream: Stream,
    rules: GraphRules, memory: GraphMemory, out: Neighbours,
) -> None:  # fmt: skip
    """Edges to the neighbours, their mean, and what the node starts with."""
    flow = stream.turn_flow
    a00, a01, a02 = flow[y, x, 0, 0], flow[y, x, 0, 1], flow[y, x, 0, 2]
    a10, a11, a12 = flow[y, x, 1, 0], flow[y, x, 1, 1], flow[y, x, 1, 2]
    t, inverse_r, inverse_T = stream.t_us[i], 1.0 / rules.radius, 1.0 / rules.window_us
    q0, q1, q2 = stream.turn_C[i, 0], stream.turn_C[i, 1], stream.turn_C[i, 2]
    m0, m1, m2, m3, last, same, active = 0.0, 0.0, 0.0, 0.0, -1, 0, 0.0
    surface = out.surface
    for m in range(n):
        row, k = out.node[m], out.offset[m]
        s0 = q0 - memory.turn_C[row, 0]
        s1 = q1 - memory.turn_C[row, 1]
        s2 = q2 - memory.turn_C[row, 2]
        dx, dy = -np.float64(rules.offsets[k, 0]), -np.float64(rules.offsets[k, 1])
        turned0 = a00 * s0 + a01 * s1 + a02 * s2
        turned1 = a10 * s0 + a11 * s1 + a12 * s2
        age, pp = np.float64(t - memory.t_us[row]), np.float64(p * memory.p[row])
        active += np.float64(t - memory.since_us[row])
        out.edge[m, 0] = inverse_r * (dx - turned0)
        out.edge[m, 1] = inverse_r * (dy - turned1)
        out.edge[m, 2], out.edge[m, 3] = inverse_T * age, pp
        m0 += dx - turned0
        m1 += dy - turned1
        m2 += age
        m3 += pp
        if pp > 0.0 and k != last:  # the newest of its pixel
            surface.dx[same], surface.dy[same], surface.dt[same] = dx, dy, 1e-6 * age
            surface.turned[same, 0], surface.turned[same, 1] = turned0, turned1
            same += 1
        last = k
    share = 1.0 / max(n, 1)
    out.mean_edge[0] = inverse_r * share * m0
    out.mean_edge[1] = inverse_r * share * m1
    out.mean_edge[2] = inverse_T * share * m2
    out.mean_edge[3] = share * m3
    w0, w1 = 0.0, 0.0
    for c in range(3):
        w0 += stream.move_flow[y, x, 0, c] * stream.v_WC_C[i, c]
        w1 += stream.move_flow[y, x, 1, c] * stream.v_WC_C[i, c]
    pause = min(inverse_T * np.float64(t - memory.t_us[before]), 1.0)
    node_inputs(p, n, same, fitted_plane(same, surface), w0, w1, pause, 1e-6 * share * active,
                out.inputs)  # fmt: skip


@njit
def _edges(
    stream: Stream, rules: GraphRules, memory: GraphMemory, found: Neighbours,
    status: NDArray[np.int8], inputs: Float32, ends: NDArray[np.int32], edge: Float32,
    same_as: IntArray,
) -> int:  # fmt: skip
    e, event = 0, np.full(memory.t_us.shape[0], -1)
    for i in range(stream.t_us.shape[0]):
        kind, n, row = insert(i, stream, rules, memory, found)
        status[i] = kind
        if kind == REFRACTORY:
            same_as[i] = event[row]
            continue
        for c in range(INPUTS):
            inputs[i, c] = found.inputs[c]
        for m in range(n):
            ends[e, 1], ends[e, 2] = i, found.offset[m]
            ends[e, 0] = event[found.node[m]]
            for c in range(EDGE):
                edge[e, c] = found.edge[m, c]
            e += 1
        event[row] = i
    return e
