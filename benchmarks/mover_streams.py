# SPDX-License-Identifier: Apache-2.0
"""Event streams of all vehicles along flights on truth, kept on disk: made once, read often."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.mission.replay import open_replay
from skyhaul.sensors.api import EventReading, ImuReading
from skyhaul.sensors.truth_track import TrackWriter, TruthTrack, load_track
from skyhaul.types import IntArray
from skyhaul.world.load import load_config


class TruthRecorder:
    """A recorder that keeps the true states only."""

    def __init__(self) -> None:
        self.writer = TrackWriter()

    def tick(self, tick: Any) -> None:  # noqa: ANN401
        """Every step of the plant."""
        self.writer.add(tick.truth)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return lambda *_, **__: None


@dataclass(frozen=True, eq=False)
class Stream:
    """What one vehicle's event camera and gyro delivered in a flight."""

    events: EventReading
    label: IntArray  # (k,) object behind each event, see `sensors.truth_api`
    imu: ImuReading


@dataclass(frozen=True, eq=False)
class FlightStreams:
    """A flight and what its event cameras saw."""

    config: RunConfig
    seed: int
    truth: TruthTrack
    vehicles: tuple[Stream, ...]


def config_of(scenario: str) -> RunConfig:
    """A scenario whose vehicles carry an event camera and no other."""
    config = load_config(RunConfig, scenario)
    rig = replace(config.sensors.rig, cameras=())
    return replace(config, sensors=replace(config.sensors, rig=rig))


def streams(scenario: str, seed: int, folder: Path) -> FlightStreams:
    """Fly and simulate the event cameras, or take from the folder what is there already."""
    folder.mkdir(parents=True, exist_ok=True)
    config = config_of(scenario)
    path = folder / f"{scenario}-{seed}.truth.npz"
    if not path.exists():
        recorder = TruthRecorder()
        fly(load_config(RunConfig, scenario), seed, recorder)
        recorder.writer.track().save(path)
    vehicles = []
    for i in range(config.team.count):
        kept = folder / f"{scenario}-{seed}.vehicle{i}.npz"
        if not kept.exists():
            _simulate(config, seed, path, i, kept)
        vehicles.append(_load(kept))
    return FlightStreams(config, seed, load_track(path), tuple(vehicles))


def _simulate(config: RunConfig, seed: int, track: Path, vehicle: int, to: Path) -> None:
    """Simulate the sensors of one vehicle and keep events, labels and angular rates."""
    parts: dict[str, list[Any]] = {k: [] for k in ("t", "x", "y", "p", "label", "imu_t", "gyro")}
    for reading, beside in open_replay(config, seed, track).readings(vehicle):
        parts["imu_t"].append(reading.imu.stamp_us)
        parts["gyro"].append(reading.imu.gyro_I)
        if reading.events is not None and beside.labels is not None:
            e = reading.events
            columns = (e.t_us, e.x, e.y, e.p, beside.labels.object_id)
            for name, column in zip(("t", "x", "y", "p", "label"), columns, strict=True):
                parts[name].append(column)
    part = to.with_name(to.name + ".part")
    with part.open("wb") as file:
        np.savez_compressed(file, **{k: np.concatenate(v) for k, v in parts.items()})
    part.replace(to)


def _load(path: Path) -> Stream:
    with np.load(path) as f:
        events = EventReading(f["t"], f["x"], f["y"], f["p"])
        imu = ImuReading(f["imu_t"], f["gyro"], np.zeros_like(f["gyro"]))
        return Stream(events, f["label"], imu)
