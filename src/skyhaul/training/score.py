# SPDX-License-Identifier: Apache-2.0
"""How well a classifier of events tells movers: per event, and per object and 50 ms."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyhaul.perception.events.api import MOVER_AT, EventClassifier, Float32, Work
from skyhaul.perception.obstacles.clusters import ClusterRules
from skyhaul.sensors.api import EventReading
from skyhaul.training.samples import lens_of
from skyhaul.training.scenes import MOVES, TEAM, LabelledStream

STEP_US = 10_000
BIN_US = 50_000
VISIBLE_PX = 12
"""A mover that fires in fewer pixels in a bin is not asked for."""


@dataclass(frozen=True)
class Count:
    """Hits and misses, of events or of objects; they add up."""

    hits: int = 0
    called: int = 0
    wanted: int = 0

    def __add__(self, other: "Count") -> "Count":
        return Count(self.hits + other.hits, self.called + other.called, self.wanted + other.wanted)

    @property
    def precision(self) -> float:
        """Share of what was called that is right."""
        return self.hits / max(self.called, 1)

    @property
    def recall(self) -> float:
        """Share of what was wanted that was called."""
        return self.hits / max(self.wanted, 1)

    @property
    def f1(self) -> float:
        """Harmonic mean of both."""
        p, r = self.precision, self.recall
        return 2.0 * p * r / max(p + r, 1e-12)


@dataclass(frozen=True)
class Score:
    """Of one or several streams; precision and recall of objects come from different units."""

    events: Count = Count()
    clusters: Count = Count()  # hits: mostly a mover's; `wanted` unused
    objects: Count = Count()  # hits: movers found; `called` unused
    false_calls: int = 0
    standing: int = 0

    def __add__(self, other: "Score") -> "Score":
        return Score(
            self.events + other.events, self.clusters + other.clusters,
            self.objects + other.objects, self.false_calls + other.false_calls,
            self.standing + other.standing,
        )  # fmt: skip

    @property
    def false_share(self) -> float:
        """Share of the events of what stands that are called a mover's."""
        return self.false_calls / max(self.standing, 1)

    @property
    def object_f1(self) -> float:
        """From the precision of clusters and the recall of objects."""
        p, r = self.clusters.precision, self.objects.recall
        return 2.0 * p * r / max(p + r, 1e-12)


def classified(classifier: EventClassifier[Any], stream: LabelledStream) -> tuple[Float32, Work]:
    """Probabilities of all events of a stream, read in steps of 10 ms."""
    events, memory = stream.events, classifier.init(lens_of(stream))
    ends = np.arange(events.t_us[0] + STEP_US, events.t_us[-1] + STEP_US + 1, STEP_US)
    cuts, out = [0, *np.searchsorted(events.t_us, ends).tolist()], []
    for a, b in pairwise(cuts):
        part = EventReading(events.t_us[a:b], events.x[a:b], events.y[a:b], events.p[a:b])
        memory, scores = classifier.step(memory, part, stream.turn_C[a:b], stream.v_WC_C[a:b])
        out.append(scores.p_mover)
    return np.concatenate(out), classifier.work(memory)


def score(stream: LabelledStream, p_mover: Float32, threshold: float = MOVER_AT) -> Score:
    """Counts of one stream; the team's own events count neither way."""
    counts = stream.label != TEAM
    moves, called = (stream.label == MOVES) & counts, (p_mover >= threshold) & counts
    events = Count(int((moves & called).sum()), int(called.sum()), int(moves.sum()))
    clusters, objects = _objects(stream, moves, called)
    standing = int((counts & ~moves).sum())
    return Score(events, clusters, objects, events.called - events.hits, standing)


def _objects(
    stream: LabelledStream, moves: NDArray[np.bool_], called: NDArray[np.bool_]
) -> tuple[Count, Count]:
    """Clusters of called events in each 50 ms, and movers of which at least half was called."""
    rules, lens, e = ClusterRules(), lens_of(stream), stream.events
    bins = (e.t_us - e.t_us[0]) // BIN_US
    right = found = clusters = wanted = 0
    for name in np.unique(bins):
        here = bins == name
        picked = np.flatnonzero(here & called)
        cluster = rules.labels(
            lens, EventReading(e.t_us[picked], e.x[picked], e.y[picked], e.p[picked])
        )
        size = np.bincount(cluster)
        share = np.bincount(cluster, moves[picked]) / np.maximum(size, 1)
        real = size >= rules.min_events
        real[:1] = False
        clusters += int(real.sum())
        right += int((real & (share >= 0.5)).sum())
        mine = np.flatnonzero(here & moves)
        for owner in np.unique(stream.object_id[mine]):
            its = mine[stream.object_id[mine] == owner]
            pixels = np.unique(e.y[its].astype(np.int64) * lens.width + e.x[its])
            if len(pixels) >= VISIBLE_PX:
                wanted += 1
                found += int(2 * called[its].sum() >= len(its))
    return Count(right, clusters, 0), Count(found, 0, wanted)
