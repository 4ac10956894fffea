# SPDX-License-Identifier: Apache-2.0
"""The chain from events to tracks, run over kept streams as a flight would run it: causally."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from mover_streams import FlightStreams, Stream
from numpy.typing import NDArray

from skyhaul.perception.events.api import EventScores, Work
from skyhaul.perception.events.lens import EventLens
from skyhaul.perception.obstacles.api import TeamSight, VehicleSight
from skyhaul.perception.obstacles.from_events import EventObstacles, TeamWatch
from skyhaul.sensors.api import EventReading, ImuReading
from skyhaul.types import Array, IntArray, TimeUs

STEP_US = 10_000
CELL_PX = 16


@dataclass(frozen=True, eq=False)
class LabelClassifier:
    """An upper bound: calls movers' the events that a mover caused, by the label channel.

    Implements `EventClassifier` for the events of one kept stream.
    """

    size_px: tuple[int, int]
    key: IntArray  # (k,) of time and pixel, rising
    moves: NDArray[np.bool_]  # (k,)

    def init(self, lens: EventLens) -> int:
        """Events so far."""
        return 0

    def step(
        self, memory: int, events: EventReading, turn_C: Array, v_WC_C: Array | None = None
    ) -> tuple[int, EventScores]:
        """See `EventClassifier.step`."""
        at = np.searchsorted(self.key, keys_of(events, self.size_px))
        p = self.moves[np.minimum(at, len(self.key) - 1)].astype(np.float32)
        cells = np.zeros(
            (-(-self.size_px[1] // CELL_PX), -(-self.size_px[0] // CELL_PX)), np.float32
        )
        newest = int(events.t_us[-1]) if len(p) else 0
        return memory + len(p), EventScores(newest, p, cells, CELL_PX)

    def work(self, memory: int) -> Work:
        """See `EventClassifier.work`."""
        return Work(events=memory)


def keys_of(events: EventReading, size_px: tuple[int, int]) -> IntArray:
    """One number for time and pixel of each event."""
    w, h = size_px
    pixel = events.y.astype(np.int64) * w + events.x
    keys: IntArray = events.t_us * (w * h) + pixel
    return keys


def label_classifier(
    stream: Stream, size_px: tuple[int, int], movers: tuple[int, ...]
) -> LabelClassifier:
    """The classifier of one stream; `movers` are the labels that move."""
    key = keys_of(stream.events, size_px)
    order = np.argsort(key, kind="stable")
    return LabelClassifier(size_px, key[order], np.isin(stream.label, movers)[order])


def mover_labels(flight: FlightStreams) -> dict[int, int]:
    """Label of each mover's events -> row of the obstacle."""
    names = flight.config.sensors.label_names(flight.config.team, flight.config.world)
    first = min(n.id for n in names if n.id >= 0 and n.kind in ("static", "mover"))
    return {n.id: n.id - first for n in names if n.kind == "mover"}


def team_watch(flight: FlightStreams, params: EventObstacles, *, labels: bool) -> TeamWatch:
    """The estimator for a kept flight, with the label channel as its classifier or its own."""
    config = flight.config
    built = params.build(config.team, config.sensors.calibration())
    if not labels:
        return built
    mount = config.sensors.rig.event_camera
    assert mount is not None
    movers = tuple(mover_labels(flight))
    watches = tuple(
        replace(w, classifier=label_classifier(s, mount.model.size_px, movers))
        for w, s in zip(built.watches, flight.vehicles, strict=True)
    )
    return replace(built, watches=watches)


def sights(flight: FlightStreams, end_us: TimeUs | None = None) -> Iterator[tuple[int, TeamSight]]:
    """What the team has at each step, in order, with the row of the truth."""
    truth = flight.truth
    exact = np.zeros((6, 6))
    rows = np.flatnonzero(truth.t_us % STEP_US == 0)
    marks = [(np.searchsorted(s.events.t_us, truth.t_us[rows], side="right"),
              np.searchsorted(s.imu.stamp_us, truth.t_us[rows], side="right"))
             for s in flight.vehicles]  # fmt: skip
    for n, k in enumerate(rows[1:].tolist(), start=1):
        now = truth.truth(k)
        if end_us is not None and now.stamp_us > end_us:
            return
        vehicles = []
        for i, (s, (at, imu_at)) in enumerate(zip(flight.vehicles, marks, strict=True)):
            e, part = s.events, slice(at[n - 1], at[n])
            events = EventReading(e.t_us[part], e.x[part], e.y[part], e.p[part])
            part = slice(imu_at[n - 1], imu_at[n])
            imu = ImuReading(s.imu.stamp_us[part], s.imu.gyro_I[part], s.imu.accel_I[part])
            vehicles.append(VehicleSight(i, events, imu, exact))
        yield k, TeamSight(now.stamp_us, now.team, now.attached, tuple(vehicles))
