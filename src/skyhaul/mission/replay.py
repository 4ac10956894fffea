# SPDX-License-Identifier: Apache-2.0
"""Sensors after a flight: the truth is kept while flying, readings are made from it later."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyhaul.comms.api import Envelope
from skyhaul.geometry.quaternion import R_to_quat, quat_mul, quat_rotate
from skyhaul.mapping.api import WorldMap
from skyhaul.mission.api import Outcome, Recorder, Replan, Solve, Tick, Trigger
from skyhaul.mission.config import RunConfig
from skyhaul.planning.api import Reference
from skyhaul.sensors.api import PayloadReading, VehicleReading
from skyhaul.sensors.truth_api import SensorTruth
from skyhaul.sensors.truth_track import TrackWriter, TruthTrack, load_track
from skyhaul.types import Array, IntArray, TimeUs


class TrackRecorder:
    """Keeps the truth of every step, and passes everything on to another recorder."""

    def __init__(self, inner: Recorder) -> None:
        self._inner = inner
        self._writer = TrackWriter()

    def save(self, path: Path) -> None:
        """Write the truth so far to a file; it is whole or not there.

        Raises:
            FileError: When nothing has been recorded, or the file cannot be written.
        """
        self._writer.track().save(path)

    def track(self) -> TruthTrack:
        """The truth so far."""
        return self._writer.track()

    def tick(self, tick: Tick) -> None:
        """Every plant step."""
        self._writer.add(tick.truth)
        self._inner.tick(tick)

    def trigger(self, trigger: Trigger) -> None:
        """Something fired."""
        self._inner.trigger(trigger)

    def replan(self, replan: Replan) -> None:
        """A reference was planned, accepted or not."""
        self._inner.replan(replan)

    def reference(self, stamp_us: TimeUs, reference: Reference) -> None:
        """A reference came into force."""
        self._inner.reference(stamp_us, reference)

    def solve(self, solve: Solve) -> None:
        """A control plan was solved."""
        self._inner.solve(solve)

    def map(self, world_map: WorldMap) -> None:
        """M(t) changed."""
        self._inner.map(world_map)

    def message(self, envelope: Envelope[object]) -> None:
        """A message went over the bus."""
        self._inner.message(envelope)

    def close(self, outcome: Outcome) -> None:
        """The flight is over, or was interrupted; called exactly once."""
        self._inner.close(outcome)


@dataclass(frozen=True, eq=False)
class ImuTruth:
    """True motion of an IMU at every step of a flight."""

    t_us: IntArray  # (m,)
    p_WI: Array  # (m, 3) [m]
    q_WI: Array  # (m, 4)
    v_WI: Array  # (m, 3) [m/s]


@dataclass(frozen=True, eq=False)
class Replay:
    """A flight whose sensors can be simulated; None stands for the load."""

    config: RunConfig
    seed: int
    track: TruthTrack

    def readings(self, vehicle: int) -> Iterator[tuple[VehicleReading, SensorTruth]]:
        """What a vehicle's sensors deliver at each step, and what they do not tell."""
        config = self.config
        suite = config.sensors.vehicle_suite(config.team, config.world, vehicle)
        memory = suite.init(self.seed)
        end_us = int(self.track.t_us[-1])
        for truth in self.track.truths():
            last = truth.stamp_us == end_us
            memory, reading, beside = suite.step(memory, truth, last=last)
            yield reading, beside

    def payload_readings(self) -> Iterator[tuple[PayloadReading, SensorTruth]]:
        """What the load's sensors deliver at each step, and what they do not tell."""
        suite = self.config.sensors.payload_suite()
        memory = suite.init(self.seed)
        for truth in self.track.truths():
            memory, reading = suite.step(memory, truth)
            yield reading, SensorTruth(None, memory.bias[0])

    def imu_truth(self, vehicle: int | None) -> ImuTruth:
        """True motion of the IMU of a vehicle or of the load."""
        track, sensors = self.track, self.config.sensors
        if vehicle is None:
            imu = sensors.payload_imu.calibration()
            p, q, v, w = track.p_WL, track.q_WL, track.v_WL, track.w_WL_L
        else:
            imu = sensors.imu.calibration()
            p, q = track.p_WB[:, vehicle], track.q_WB[:, vehicle]
            v, w = track.v_WB[:, vehicle], track.w_WB_B[:, vehicle]
        return ImuTruth(
            t_us=track.t_us,
            p_WI=p + quat_rotate(q, imu.p_BI),
            q_WI=quat_mul(q, R_to_quat(imu.R_BI)),
            v_WI=v + quat_rotate(q, np.cross(w, imu.p_BI)),
        )


def open_replay(config: RunConfig, seed: int, path: Path) -> Replay:
    """A flight from the file of its track.

    Raises:
        FileError: When it is missing or not a track.
    """
    return Replay(config, seed, load_track(path))
