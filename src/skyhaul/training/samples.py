# SPDX-License-Identifier: Apache-2.0
"""Streams as the network takes them in training: graph, inputs, cells, labels."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skyhaul.perception.events.api import Float32
from skyhaul.perception.events.graph import EVALUATED, GraphParams, event_graph, spiral
from skyhaul.perception.events.lens import EventLens, event_lens
from skyhaul.perception.events.surface import ACROSS, DIRECTION, POLARITY
from skyhaul.training.kernels import Index
from skyhaul.training.scenes import LabelledStream
from skyhaul.types import IntArray


@dataclass(frozen=True, eq=False)
class Sample:
    """Events in order of time, and the edges between them."""

    inputs: Float32  # (k, INPUTS)
    mean_edge: Float32  # (k, EDGE)
    first: IntArray  # (k + 1,) row of each event's first edge
    source: Index  # (e,)
    offset: Index  # (e,)
    runs: NDArray[np.bool_]  # (k,) evaluated
    cell: IntArray  # (k,)
    period: IntArray  # (k,)
    label: NDArray[np.int8]  # (k,)

    def __len__(self) -> int:
        return len(self.label)

    def part(self, a: int, b: int) -> "Sample":
        """Events a to b; of events before a nothing is known but that they were there."""
        edges = slice(self.first[a], self.first[b])
        return Sample(
            self.inputs[a:b], self.mean_edge[a:b], self.first[a : b + 1] - self.first[a],
            np.maximum(self.source[edges] - np.int32(a), np.int32(-1)), self.offset[edges],
            self.runs[a:b], self.cell[a:b], self.period[a:b], self.label[a:b],
        )  # fmt: skip

    def mirrored(self, radius_px: int, rng: np.random.Generator) -> "Sample":
        """Seen in one of eight mirrors, drawn, and perhaps with light and dark exchanged.

        The operator knows no direction and no polarity beforehand; what is learned from one view
        holds in all of them.
        """
        sign_x, sign_y, sign_p = rng.choice(np.array([-1.0, 1.0], np.float32), 3)
        swap = rng.random() < 0.5
        inputs, edge = self.inputs.copy(), self.mean_edge.copy()
        inputs[:, POLARITY] *= sign_p
        inputs[:, DIRECTION] *= (sign_x, sign_y)
        inputs[:, ACROSS] *= sign_x * sign_y * (-1.0 if swap else 1.0)
        edge[:, :2] *= (sign_x, sign_y)
        if swap:
            inputs[:, DIRECTION] = inputs[:, DIRECTION][:, ::-1]
            edge[:, :2] = edge[:, 1::-1]
        offsets = spiral(radius_px)
        seen = offsets * np.array([sign_x, sign_y], np.int32)
        seen = seen[:, ::-1] if swap else seen
        row = {tuple(o): k for k, o in enumerate(offsets.tolist())}
        to = np.array([row[tuple(o)] for o in seen.tolist()], self.offset.dtype)
        return replace(self, inputs=inputs, mean_edge=edge, offset=to[self.offset])


_LENSES: dict[str, EventLens] = {}


def lens_of(stream: LabelledStream) -> EventLens:
    """The tables of a stream's camera."""
    key = repr(stream.model)
    if key not in _LENSES:
        if len(_LENSES) > 8:
            _LENSES.clear()
        _LENSES[key] = event_lens(stream.model)
    return _LENSES[key]


def sample(stream: LabelledStream, graph: GraphParams, cell_px: int, period_us: int) -> Sample:
    """A stream with its graph."""
    events, lens = stream.events, lens_of(stream)
    g = event_graph(graph, lens, events, stream.turn_C, stream.v_WC_C)
    k = len(events.t_us)
    first = np.searchsorted(g.target, np.arange(k + 1)).astype(np.int64)
    share = 1.0 / np.maximum(np.diff(first), 1)
    mean = [share * np.bincount(g.target, g.edge[:, c], minlength=k) for c in range(4)]
    columns = -(-lens.width // cell_px)
    cell = (events.y // cell_px).astype(np.int64) * columns + events.x // cell_px
    return Sample(
        g.inputs, np.stack(mean, 1).astype(np.float32), first, g.source.astype(np.int32),
        g.offset.astype(np.int32), g.status == EVALUATED, cell, events.t_us // period_us,
        stream.label.astype(np.int8),
    )  # fmt: skip
