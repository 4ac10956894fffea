# SPDX-License-Identifier: Apache-2.0
"""The faults of one body's sensors, played on its readings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skyhaul.sensors.api import CameraFrame, EventReading, GreyImage, ImuReading, VehicleReading
from skyhaul.sensors.faults import (
    ClockOffset,
    DroppedFrames,
    EventBurst,
    FrozenCamera,
    ImuGap,
    ImuSaturation,
    SensorFault,
    is_lost,
    is_on,
    shifted,
    spoilt,
)
from skyhaul.sensors.flicker import Flicker, mixed
from skyhaul.sensors.streams import PAYLOAD_BODY
from skyhaul.sensors.truth_api import EventLabels
from skyhaul.types import TimeUs


@dataclass(frozen=True, eq=False)
class ScriptMemory:
    """What frozen cameras hold, and up to when frames and events were delivered."""

    seed: int
    held: dict[int, GreyImage]  # by camera
    stamp_us: dict[int, TimeUs]  # of the last frame delivered, by camera
    events_until_us: TimeUs


@dataclass(frozen=True, eq=False)
class FaultScript:
    """Faults of one body, each with its place in the scenario's list."""

    body: int
    faults: tuple[tuple[int, SensorFault], ...]
    cameras: tuple[str, ...]
    event_size_px: tuple[int, int] | None
    imu_ahead_us: TimeUs = 0
    """By which the clock of its IMU is ahead of true time [us]."""

    def init(self, seed: int) -> ScriptMemory:
        """Nothing has happened yet."""
        return ScriptMemory(seed, {}, {}, -1)

    def imu(self, reading: ImuReading) -> ImuReading:
        """What is left of an IMU's samples: each is spoilt by what acts when it is measured."""
        for _, fault in self.faults:
            if isinstance(fault, ImuSaturation | ImuGap):
                true_us = reading.stamp_us - self.imu_ahead_us
                on = np.array([is_on(fault, t) for t in true_us.tolist()], np.bool_)
                if on.any():
                    reading = spoilt(fault, reading, on)
        return reading

    def step(
        self, memory: ScriptMemory, reading: VehicleReading, labels: EventLabels | None
    ) -> tuple[ScriptMemory, VehicleReading, EventLabels | None]:
        """What is left of a vehicle's reading."""
        if not self.faults:
            return memory, reading, labels
        imu = self.imu(reading.imu)
        held, last, frames = dict(memory.held), dict(memory.stamp_us), []
        for frame in reading.frames:
            passed = self._frame(memory.seed, held, frame)
            # a clock set back: as a driver does, drop frames until it is past the last stamp
            if passed is not None and passed.stamp_us > last.get(frame.camera, -1):
                last[frame.camera] = passed.stamp_us
                frames.append(passed)
        memory = replace(memory, held=held, stamp_us=last)
        events = reading.events
        if events is not None and labels is not None:
            memory, events, labels = self._events(memory, reading.stamp_us, events, labels)
        out = replace(reading, imu=imu, frames=tuple(frames), events=events)
        return memory, out, labels

    def _frame(
        self, seed: int, held: dict[int, GreyImage], frame: CameraFrame
    ) -> CameraFrame | None:
        """A frame after all faults; None when it is lost. Notes what a frozen camera holds."""
        t_us, name = frame.stamp_us, self.cameras[frame.camera]
        mine = [
            (i, f)
            for i, f in self.faults
            if isinstance(f, DroppedFrames | FrozenCamera | ClockOffset)
            and f.camera in (None, name)
            and is_on(f, t_us)
        ]
        if any(isinstance(f, FrozenCamera) for _, f in mine):
            frame = replace(frame, image=held.setdefault(frame.camera, frame.image))
        else:
            held[frame.camera] = frame.image
        for i, f in mine:
            if isinstance(f, DroppedFrames) and is_lost(f, seed, self.body, i, t_us):
                return None
        for _, f in mine:
            if isinstance(f, ClockOffset):
                frame = shifted(f, frame)
        return frame

    def _events(
        self, memory: ScriptMemory, t_us: TimeUs, events: EventReading, labels: EventLabels
    ) -> tuple[ScriptMemory, EventReading, EventLabels]:
        for i, fault in self.faults:
            if isinstance(fault, EventBurst) and self.event_size_px is not None:
                lamp = Flicker(fault, i, self.event_size_px)
                extra = lamp.between(memory.seed, self.body, memory.events_until_us, t_us)
                events, labels = mixed(events, labels, extra)
        return replace(memory, events_until_us=t_us), events, labels


def script_of(
    faults: Sequence[SensorFault],
    body: int,
    cameras: Sequence[str],
    event_size_px: tuple[int, int] | None,
    imu_ahead_us: TimeUs,
) -> FaultScript:
    """The part of a scenario's faults that is about one body, `PAYLOAD_BODY` or 1 + vehicle."""
    carrier = "payload" if body == PAYLOAD_BODY else body - 1
    mine = tuple((i, f) for i, f in enumerate(faults) if f.vehicle == carrier)
    return FaultScript(body, mine, tuple(cameras), event_size_px, imu_ahead_us)
