# SPDX-License-Identifier: Apache-2.0
"""Flights with what the team's estimator gets of them, kept in a work folder.

A flight is flown on perfect estimates, its truth is kept; then the IMUs and the down cameras are
simulated and the tag is looked for in every down image. One file a flight; what is there is not
made again.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.mission.replay import TrackRecorder
from skyhaul.perception.team.api import TagSight
from skyhaul.perception.team.tag import tag_finder
from skyhaul.sensors.truth_track import TruthTrack, load_track
from skyhaul.types import Array, IntArray
from skyhaul.world.load import load_config

DOWN = "down"


class _Silent:
    """A recorder that keeps nothing."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return lambda *args: None


@dataclass(frozen=True, eq=False)
class Recording:
    """One flight: truth for scoring, readings for the estimator."""

    scenario: str
    seed: int
    config: RunConfig
    track: TruthTrack
    load_imu: Array  # (k, 7) delivery time [us], gyro, accelerometer; stamp is half a period before
    vehicle_imu: Array  # (m, n, 6) one sample a step from the second row on
    bias: Array  # (1 + n, 6) true biases of the load's and the vehicles' IMUs half way
    tag_us: IntArray  # (s,)
    tag_vehicle: IntArray  # (s,)
    tag_px: Array  # (s, 4, 2)
    frames: IntArray  # (n,) down images that were taken
    tag_cpu_s: float  # of the detector, all vehicles

    @property
    def name(self) -> str:
        """Scenario and seed."""
        return f"{self.scenario}_{self.seed}"


def down_only(config: RunConfig) -> RunConfig:
    """The same flight with the down camera alone."""
    rig = config.sensors.rig
    mounts = tuple(c for c in rig.cameras if c.name == DOWN)
    rig = replace(rig, cameras=mounts, event_camera=None)
    return replace(config, sensors=replace(config.sensors, rig=rig))


def record(scenario: str, seed: int, folder: Path, flown: Path | None = None) -> Recording:
    """A flight and its readings, from the folder where they are.

    Args:
        scenario: Its name.
        seed: Of the flight.
        folder: What is made stays there.
        flown: File of the truth of this flight, where it has been flown before.
    """
    config = down_only(load_config(RunConfig, scenario))
    folder.mkdir(parents=True, exist_ok=True)
    truth = flown or folder / f"{scenario}_{seed}_truth.npz"
    if not truth.is_file():
        recorder = TrackRecorder(_Silent())  # type: ignore[arg-type]
        print(scenario, seed, fly(config, seed, recorder).reason, flush=True)
        recorder.save(truth)
    file = folder / f"{scenario}_{seed}_readings.npz"
    track = load_track(truth)
    if not file.is_file():
        part = file.with_suffix(".part")
        with part.open("wb") as stream:
            np.savez(stream, **_readings(config, seed, track))
        part.replace(file)
    with np.load(file) as kept:
        columns = {name: kept[name] for name in kept.files}
    cpu = float(columns.pop("tag_cpu_s"))
    return Recording(scenario, seed, config, track, **columns, tag_cpu_s=cpu)


def _readings(config: RunConfig, seed: int, track: TruthTrack) -> dict[str, Any]:
    """Simulate the sensors over a track and look for the tag."""
    suite = config.sensors.team_suite(config.team, config.world)
    tag = config.sensors.tag(config.team)
    assert tag is not None
    finder, n = tag_finder(tag), config.team.count
    memory = suite.init(seed)
    last: list[TagSight | None] = [None] * n
    load, vehicles = [], np.zeros((len(track), n, 6))
    sights: list[tuple[int, int, Array]] = []
    frames, cpu, bias = np.zeros(n, np.int64), 0.0, np.zeros((1 + n, 6))
    for k, truth in enumerate(track.truths()):
        memory, payload, readings = suite.step(memory, truth)
        if k == len(track) // 2:
            bias = memory.imus.bias
        if len(payload.imu.stamp_us):
            row = np.concatenate([payload.imu.gyro_I[0], payload.imu.accel_I[0]])
            load.append([truth.stamp_us, *row])
        for i, reading in enumerate(readings):
            if len(reading.imu.stamp_us):
                vehicles[k, i, :3], vehicles[k, i, 3:] = (
                    reading.imu.gyro_I[0],
                    reading.imu.accel_I[0],
                )
            for frame in reading.frames:
                frames[i] += 1
                begin = time.process_time()
                last[i] = finder.find(frame, last[i])
                cpu += time.process_time() - begin
                if (seen := last[i]) is not None:
                    sights.append((seen.stamp_us, i, seen.corners_px))
    return {
        "load_imu": np.array(load),
        "vehicle_imu": vehicles,
        "bias": bias,
        "tag_us": np.array([s[0] for s in sights], np.int64),
        "tag_vehicle": np.array([s[1] for s in sights], np.int64),
        "tag_px": np.array([s[2] for s in sights]).reshape(-1, 4, 2),
        "frames": frames,
        "tag_cpu_s": np.array(cpu),
    }
