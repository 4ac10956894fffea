# SPDX-License-Identifier: Apache-2.0
"""A vehicle with two cameras and an event camera, and what they delivered."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from skyhaul.geometry.camera import Equidistant, RadTan
from skyhaul.geometry.so3 import euler_to_R
from skyhaul.sensors.api import (
    CameraCalibration,
    CameraFrame,
    EventReading,
    ImuReading,
    LoadCellReading,
    RigCalibration,
    VehicleCalibration,
    VehicleReading,
)
from skyhaul.sensors.imu import Imu
from skyhaul.sensors.truth_api import EventLabels, SensorTruth

WIDE = RadTan(
    size_px=(32, 24), focal_px=(20.5, 20.25), center_px=(15.5, 11.75),
    distortion=(-0.28, 0.07, 0.0002, -0.0001),
)  # fmt: skip
FISH = Equidistant(
    size_px=(16, 12), focal_px=(6.0, 6.1), center_px=(7.5, 5.5), distortion=(-0.02, 0.003, 0.0, 0.0)
)


def known_vehicle() -> VehicleCalibration:
    imu = Imu(p_BI_m=(0.02, -0.01, 0.03), rotation_deg=(2.0, -3.0, 40.0), clock_offset_us=250)
    front = CameraCalibration(
        "front left", WIDE, np.array([0.05, 0.04, 0.01]), euler_to_R(np.array([1.0, 0.4, -0.7])),
        10.0,
    )  # fmt: skip
    rear = CameraCalibration(
        "rear", WIDE, np.array([-0.05, 0.0, 0.0]), euler_to_R(np.array([-0.3, 1.1, 2.0])), 10.0
    )
    fish = CameraCalibration(
        "events", FISH, np.array([0.06, 0.0, 0.02]), euler_to_R(np.array([0.3, -1.2, 0.5])), 0.0
    )
    return VehicleCalibration(imu.calibration(), RigCalibration((front, rear), fish), 100.0)


@dataclass
class Made:
    """A recording made by hand, and everything in it."""

    known: VehicleCalibration
    readings: list[tuple[VehicleReading, SensorTruth]] = field(default_factory=list)

    def frames(self, camera: int) -> list[CameraFrame]:
        return [f for r, _ in self.readings for f in r.frames if f.camera == camera]

    def imu(self, name: str) -> np.ndarray:
        return np.concatenate([getattr(r.imu, name) for r, _ in self.readings])

    def events(self, name: str) -> np.ndarray:
        seen = [r.events for r, _ in self.readings if r.events is not None]
        return np.concatenate([getattr(e, name) for e in seen])

    def labels(self) -> np.ndarray:
        return np.concatenate([s.labels.object_id for _, s in self.readings if s.labels])

    def tensions(self) -> np.ndarray:
        return np.concatenate([r.load_cell.tension for r, _ in self.readings if r.load_cell])


def make_readings(steps: int = 120) -> Made:
    rng, made = np.random.default_rng(8), Made(known_vehicle())
    for k in range(steps):
        t_us = 2_000 * k
        frames, events, labels, cell = (), None, None, None
        if k % 50 == 0:
            frames = tuple(
                CameraFrame(t_us, c, rng.integers(0, 256, (24, 32), dtype=np.uint8))
                for c in range(2)
            )
        if k % 5 == 0:
            n = int(rng.integers(0, 40))
            t = np.sort(rng.integers(t_us - 10_000, t_us, n)) if k else np.empty(0, np.int64)
            n = len(t)
            events = EventReading(
                t.astype(np.int64), rng.integers(0, 16, n).astype(np.int16),
                rng.integers(0, 12, n).astype(np.int16), rng.choice([-1, 1], n).astype(np.int8),
            )  # fmt: skip
            labels = EventLabels(rng.integers(-2, 9, n).astype(np.int16))
            cell = LoadCellReading(np.array([t_us]), rng.normal(size=1))
        imu = ImuReading(
            np.array([t_us - 1_000 + 250]) if k else np.empty(0, np.int64),
            rng.normal(size=(min(k, 1), 3)), rng.normal(size=(min(k, 1), 3)),
        )  # fmt: skip
        beside = SensorTruth(labels, rng.normal(size=6))
        made.readings.append((VehicleReading(t_us, 0, imu, frames, events, cell), beside))
    return made


@pytest.fixture(scope="module")
def made() -> Made:
    return make_readings()
