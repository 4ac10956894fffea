# SPDX-License-Identifier: Apache-2.0
"""Flights whose motion the event cameras of training scenes make: flown once, on truth."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skyhaul.comms.api import Envelope
from skyhaul.mapping.api import WorldMap
from skyhaul.mission.api import Outcome, Replan, Solve, Tick, Trigger
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import INTERRUPTED, fly
from skyhaul.mission.replay import TrackRecorder
from skyhaul.planning.api import Reference
from skyhaul.sensors.truth_track import TruthTrack, load_track
from skyhaul.types import IntArray, TimeUs
from skyhaul.world.load import load_config

TRAINING_FLIGHTS = ("hover", "circle", "circle-fast", "gust", "paper", "forest")
HELD_OUT_FLIGHTS = ("figure8", "window")
"""No scene of training is seen from one of these."""


@dataclass(frozen=True, eq=False)
class Flight:
    """A flight with nothing that moves but the team."""

    config: RunConfig
    track: TruthTrack

    def airborne(self, least_m: float = 0.7) -> IntArray:
        """Rows in which every vehicle is alive and this high [m]."""
        high = np.all((self.track.p_WB[:, :, 2] > least_m) & self.track.alive, axis=1)
        rows: IntArray = np.flatnonzero(high)
        return rows


class _Nothing:
    """A recorder that keeps nothing."""

    def tick(self, tick: Tick) -> None: ...

    def trigger(self, trigger: Trigger) -> None: ...

    def replan(self, replan: Replan) -> None: ...

    def reference(self, stamp_us: TimeUs, reference: Reference) -> None: ...

    def solve(self, solve: Solve) -> None: ...

    def map(self, world_map: WorldMap) -> None: ...

    def message(self, envelope: Envelope[object]) -> None: ...

    def close(self, outcome: Outcome) -> None: ...


def flight(name: str, seed: int, folder: Path) -> Flight:
    """A shipped scenario without its movers, flown on truth; kept in a folder for the next time."""
    config = load_config(RunConfig, name)
    still = tuple(o for o in config.world.obstacles if o.motion.kind == "static")
    config = replace(config, world=replace(config.world, obstacles=still))
    path = folder / f"{name}-{seed}.npz"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        recorder = TrackRecorder(_Nothing())
        if fly(config, seed, recorder).reason == INTERRUPTED:
            raise KeyboardInterrupt  # half a flight is not kept for the next time
        recorder.save(path)
    return Flight(config, load_track(path))
