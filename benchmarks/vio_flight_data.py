# SPDX-License-Identifier: Apache-2.0
"""Flights as a vehicle's cameras and IMU saw them, kept in files: flown once, rendered once."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.mission.replay import ImuTruth, Replay, TrackRecorder, open_replay
from skyhaul.sensors.api import CameraFrame, ImuReading, VehicleReading
from skyhaul.types import Array, IntArray
from skyhaul.world.load import load_config


@dataclass(frozen=True)
class FlightJob:
    """Which flight: a scenario with overrides, a seed."""

    scenario: str
    seed: int
    overrides: tuple[str, ...] = ()
    case: str = ""
    """Name of the case, and of its files."""

    @property
    def name(self) -> str:
        """Begins the names of its files."""
        return f"{self.case or self.scenario}-{self.seed}"

    def config(self) -> RunConfig:
        """Its configuration."""
        return load_config(RunConfig, self.scenario, list(self.overrides))


class _Nobody:
    """A recorder that keeps nothing."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return lambda *_: None


def track_file(job: FlightJob, folder: Path) -> Path:
    """Where the truth of a flight is kept."""
    return folder / f"{job.name}-track.npz"


def fly_track(job: FlightJob, folder: Path) -> bool:
    """Fly it unless its file is there; whether it had to be flown."""
    path = track_file(job, folder)
    if path.is_file():
        return False
    recorder = TrackRecorder(_Nobody())
    fly(job.config(), job.seed, recorder)
    recorder.save(path)
    return True


def replay_of(job: FlightJob, folder: Path) -> Replay:
    """The flight, flown unless its file is there."""
    fly_track(job, folder)
    return open_replay(job.config(), job.seed, track_file(job, folder))


@dataclass(frozen=True, eq=False)
class Seen:
    """What one vehicle's cameras and IMU delivered, and its true motion."""

    imu: ImuReading
    stamp_us: IntArray  # (f,) of frames of single cameras, in order of time
    camera: IntArray  # (f,)
    images: np.ndarray[Any, np.dtype[np.uint8]]  # (f, height, width)
    truth: ImuTruth

    def readings(self) -> Iterator[VehicleReading]:
        """Each sample of the IMU with the images that were delivered since the one before."""
        done = 0
        for k, t_us in enumerate(self.imu.stamp_us.tolist()):
            frames = []
            while done < len(self.stamp_us) and self.stamp_us[done] <= t_us:
                image = self.images[done]
                frames.append(CameraFrame(int(self.stamp_us[done]), int(self.camera[done]), image))
                done += 1
            one = slice(k, k + 1)
            imu = ImuReading(self.imu.stamp_us[one], self.imu.gyro_I[one], self.imu.accel_I[one])
            yield VehicleReading(t_us, 0, imu, tuple(frames), None, None)


def seen_of(job: FlightJob, vehicle: int, folder: Path) -> Seen:
    """What a vehicle saw, rendered unless its file is there."""
    path = folder / f"{job.name}-vehicle{vehicle}.npz"
    if not path.is_file():
        _render(replay_of(job, folder), vehicle, path)
    with np.load(path) as data:
        d = {name: data[name] for name in data.files}
    imu = ImuReading(d["imu_us"], d["gyro"], d["accel"])
    truth = ImuTruth(d["t_us"], d["p"], d["q"], d["v"])
    return Seen(imu, d["frame_us"], d["camera"], d["images"], truth)


def _render(replay: Replay, vehicle: int, path: Path) -> None:
    imu_us, gyro, accel = [], [], []
    stamps, cameras, images = [], [], []
    for reading, _ in replay.readings(vehicle):
        imu_us.append(reading.imu.stamp_us)
        gyro.append(reading.imu.gyro_I)
        accel.append(reading.imu.accel_I)
        for frame in reading.frames:
            stamps.append(frame.stamp_us)
            cameras.append(frame.camera)
            images.append(frame.image)
    truth = replay.imu_truth(vehicle)
    part = path.with_suffix(".part.npz")
    np.savez(
        part,
        imu_us=np.concatenate(imu_us), gyro=np.concatenate(gyro), accel=np.concatenate(accel),
        frame_us=np.array(stamps), camera=np.array(cameras), images=np.array(images),
        t_us=truth.t_us, p=truth.p_WI, q=truth.q_WI, v=truth.v_WI,
    )  # fmt: skip
    part.replace(path)


def speed_at(truth: ImuTruth, t_us: IntArray) -> Array:
    """True velocity at times, (n, 3) [m/s]."""
    rows = np.searchsorted(truth.t_us, t_us)
    return truth.v_WI[np.minimum(rows, len(truth.t_us) - 1)]
