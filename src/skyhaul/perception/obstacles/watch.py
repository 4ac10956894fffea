# SPDX-License-Identifier: Apache-2.0
"""One event camera watched: events -> filter -> classifier -> clusters -> tracks in its image."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyhaul.params import Params
from skyhaul.perception.events.api import EventClassifier, EventScores, Work
from skyhaul.perception.events.lens import EventLens
from skyhaul.perception.events.noise_filter import KEPT, FilterMemory, NoiseFilter, chosen
from skyhaul.perception.obstacles.clusters import ClusterRules, Clusters
from skyhaul.perception.obstacles.image_tracks import ImageTracker, ImageTrackMemory, ImageTracks
from skyhaul.sensors.api import EventReading
from skyhaul.types import Array, TimeUs


@dataclass(frozen=True, kw_only=True)
class WatchParams(Params):
    """All but the classifier."""

    noise: NoiseFilter = field(default_factory=NoiseFilter)
    """What is dropped before the classifier."""
    clusters: ClusterRules = field(default_factory=ClusterRules)
    """How mover events are grouped."""
    tracker: ImageTracker = field(default_factory=ImageTracker)
    """How groups are followed."""


@dataclass(frozen=True, eq=False)
class WatchMemory:
    """Memories of all parts."""

    lens: EventLens
    noise: FilterMemory
    classifier: Any
    tracks: ImageTrackMemory


@dataclass(frozen=True, eq=False)
class Watched:
    """What one reading gave."""

    why: NDArray[np.int8]  # (k,) KEPT or the reason why an event was dropped
    kept: EventReading
    scores: EventScores  # of the kept ones
    clusters: Clusters
    tracks: ImageTracks


@dataclass(frozen=True, eq=False)
class CameraWatch:
    """Follows what moves in one event camera's image; readings of some 10 ms."""

    classifier: EventClassifier[Any]
    params: WatchParams = field(default_factory=WatchParams)

    def init(self, lens: EventLens) -> WatchMemory:
        """Memory before the first event."""
        return WatchMemory(
            lens,
            self.params.noise.init(lens.width, lens.height),
            self.classifier.init(lens),
            self.params.tracker.init(),
        )

    def step(
        self, memory: WatchMemory, stamp_us: TimeUs, events: EventReading, turn_C: Array
    ) -> tuple[WatchMemory, Watched]:
        """Take in the events up to a time; `turn_C` (k, 3) is the camera's turn at each [rad]."""
        noise, why = self.params.noise.step(memory.noise, events)
        keep = why == KEPT
        kept = chosen(events, keep)
        classifier, scores = self.classifier.step(memory.classifier, kept, turn_C[keep])
        movers = chosen(kept, scores.mover)
        clusters = self.params.clusters.find(memory.lens, movers, stamp_us)
        followed, tracks = self.params.tracker.step(memory.tracks, clusters)
        after = WatchMemory(memory.lens, noise, classifier, followed)
        return after, Watched(why, kept, scores, clusters, tracks)

    def work(self, memory: WatchMemory) -> Work:
        """What the classifier has done so far."""
        return self.classifier.work(memory.classifier)
