# SPDX-License-Identifier: Apache-2.0
"""`kind: network`: the event network as a classifier of events."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.events.api import EventScores, Work
from skyhaul.perception.events.graph import (
    EDGE,
    GraphParams,
    GraphRules,
    graph_memory,
    graph_rules,
    no_neighbours,
    stream_of,
)
from skyhaul.perception.events.lens import EventLens
from skyhaul.perception.events.network import (
    EDGES,
    EVENTS,
    LONELY_COUNT,
    MULTIPLY_ADDS,
    PRUNES,
    REFRACTORY_COUNT,
    UPDATES,
    NetworkMemory,
    PoolRules,
    cells_at,
    pool_memory,
    run_events,
)
from skyhaul.perception.events.weights import (
    SHIPPED,
    STACK,
    WIDTH,
    NetworkWeights,
    PackedWeights,
    load_weights,
    packed,
)
from skyhaul.sensors.api import EventReading
from skyhaul.types import Array


@dataclass(frozen=True, kw_only=True)
class NetworkParams(Params):
    """Which weights, and what is skipped."""

    kind: Literal["network"] = "network"
    weights: str | None = None
    """Weights file (.npz); None: the one that comes with the package."""
    min_neighbours: int | None = None
    """Insertion skip, instead of the weights' own; 0 evaluates every node."""
    refractory_us: int | None = None
    """Insertion skip, instead of the weights' own; 0 inserts every event [us]."""
    prune: bool = True
    """Evaluate a cell's layers only after its maximum has changed; the result is the same."""

    def build(self) -> "EventNetwork":
        """Read the weights."""
        weights = load_weights(SHIPPED if self.weights is None else Path(self.weights))
        skip = {k: v for k in ("min_neighbours", "refractory_us")
                if (v := getattr(self, k)) is not None}  # fmt: skip
        graph: GraphParams = replace(weights.graph, **skip)
        return EventNetwork(replace(weights, graph=graph), prune=self.prune)


@dataclass(frozen=True, eq=False)
class LensAndMemory:
    """The camera, and the network's memory of its events."""

    lens: EventLens
    network: NetworkMemory


@dataclass(frozen=True, eq=False)
class EventNetwork:
    """Implements `EventClassifier`."""

    weights: NetworkWeights
    prune: bool = True

    @cached_property
    def _packed(self) -> PackedWeights:
        return packed(self.weights)

    @cached_property
    def _rules(self) -> tuple[GraphRules, PoolRules]:
        pooling = PoolRules(self.weights.cell_px, self.weights.period_us, self.prune)
        return graph_rules(self.weights.graph), pooling

    def init(self, lens: EventLens) -> LensAndMemory:
        """See `EventClassifier.init`."""
        graph, row = self.weights.graph, len(self.weights.layers) * WIDTH
        nodes = graph_memory(graph, lens.width, lens.height)
        rows = len(nodes.t_us)
        network = NetworkMemory(
            graph=nodes,
            found=no_neighbours(graph),
            features=np.full((rows, row), 0.0, np.float32),  # touched now, not at each first event
            score=np.zeros(rows, np.float32),
            pool=pool_memory(lens.width, lens.height, self.weights.cell_px),
            work=np.zeros(7, np.int64),
            scratch=np.zeros((3, row), np.float32),
            stacked=np.eye(1, STACK, 2 * WIDTH + EDGE, dtype=np.float32)[0],
        )
        return LensAndMemory(lens, network)

    def step(
        self,
        memory: LensAndMemory,
        events: EventReading,
        turn_C: Array,
        v_WC_C: Array | None = None,
    ) -> tuple[LensAndMemory, EventScores]:
        """See `EventClassifier.step`."""
        rules, pooling = self._rules
        lens, network = memory.lens, memory.network
        p_mover = np.empty(len(events.t_us), np.float32)
        stream = stream_of(lens, events, turn_C, v_WC_C)
        run_events(stream, rules, pooling, self._packed, network, p_mover)
        newest = int(events.t_us[-1]) if len(events.t_us) else _newest_us(network)
        cells = np.empty(network.pool.objectness.shape, np.float32)
        cells_at(newest, pooling, self._packed, network, cells)
        return memory, EventScores(newest, p_mover, cells, self.weights.cell_px)

    def work(self, memory: LensAndMemory) -> Work:
        """See `EventClassifier.work`."""
        done = [int(v) for v in memory.network.work]
        return Work(
            events=done[EVENTS],
            lonely=done[LONELY_COUNT],
            refractory=done[REFRACTORY_COUNT],
            edges=done[EDGES],
            multiply_adds=done[MULTIPLY_ADDS],
            pool_updates=done[UPDATES],
            pool_prunes=done[PRUNES],
        )


def _newest_us(network: NetworkMemory) -> int:
    """Time of the newest node, 0 without one."""
    return max(int(network.graph.t_us.max()), 0)
