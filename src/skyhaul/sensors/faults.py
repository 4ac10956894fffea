# SPDX-License-Identifier: Apache-2.0
"""Sensor faults that a scenario scripts: parameters, and what each does to a reading."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skyhaul.params import Params
from skyhaul.sensors.api import CameraFrame, ImuReading
from skyhaul.sensors.streams import Source, stream
from skyhaul.types import US_PER_S, Mask, TimeUs

Carrier = int | Literal["payload"]
"""A vehicle, 0-based, or the load."""


@dataclass(frozen=True, kw_only=True)
class DroppedFrames(Params):
    """Images of a camera get lost."""

    kind: Literal["dropped-frames"] = "dropped-frames"
    vehicle: int
    """Which vehicle, 0-based."""
    camera: str
    """Name of the camera in the rig."""
    start_s: float
    """When it begins [s]."""
    duration_s: float
    """How long it lasts [s]."""
    share: float = 1.0
    """Share of the images that get lost, 0..1."""

    def __post_init__(self) -> None:
        _check_interval(self.start_s, self.duration_s)
        if not 0.0 < self.share <= 1.0:
            raise ValueError(f"share must lie in (0, 1], got {self.share}")


@dataclass(frozen=True, kw_only=True)
class FrozenCamera(Params):
    """A camera delivers the last image from before the fault again and again, freshly stamped."""

    kind: Literal["frozen-camera"] = "frozen-camera"
    vehicle: int
    """Which vehicle, 0-based."""
    camera: str
    """Name of the camera in the rig."""
    start_s: float
    """When it begins [s]."""
    duration_s: float
    """How long it lasts [s]."""

    def __post_init__(self) -> None:
        _check_interval(self.start_s, self.duration_s)


@dataclass(frozen=True, kw_only=True)
class ClockOffset(Params):
    """The clock of a vehicle's cameras runs away from the true time; nobody is told.

    Stamps of a camera increase strictly and are never negative: a frame whose stamp is not after
    that of the last one delivered is dropped, as when the clock is set back.
    """

    kind: Literal["clock-offset"] = "clock-offset"
    vehicle: int
    """Which vehicle, 0-based."""
    camera: str | None = None
    """Name of the camera in the rig; default: all of them."""
    start_s: float = 0.0
    """When it begins [s]."""
    offset_us: int = 0
    """The stamps are ahead by this from then on [us]."""
    drift_ppm: float = 0.0
    """The offset grows by this many microseconds a second [us/s]."""

    def __post_init__(self) -> None:
        if not self.start_s >= 0.0:
            raise ValueError(f"start_s must be >= 0, got {self.start_s}")
        if self.offset_us == 0 and self.drift_ppm == 0.0:
            raise ValueError("offset_us and drift_ppm are both 0: give at least one of them")


@dataclass(frozen=True, kw_only=True)
class ImuGap(Params):
    """An IMU delivers nothing."""

    kind: Literal["imu-gap"] = "imu-gap"
    vehicle: Carrier
    """Which vehicle, 0-based, or `payload`."""
    start_s: float
    """When it begins [s]."""
    duration_s: float
    """How long it lasts [s]."""

    def __post_init__(self) -> None:
        _check_interval(self.start_s, self.duration_s)


@dataclass(frozen=True, kw_only=True)
class ImuSaturation(Params):
    """An IMU's range shrinks, as if set wrongly: larger readings are cut off."""

    kind: Literal["imu-saturation"] = "imu-saturation"
    vehicle: Carrier
    """Which vehicle, 0-based, or `payload`."""
    start_s: float
    """When it begins [s]."""
    duration_s: float
    """How long it lasts [s]."""
    gyro_range_radps: float = 1.0
    """Largest rate that is measured meanwhile [rad/s]."""
    accel_range_mps2: float = 12.0
    """Largest specific force that is measured meanwhile [m/s^2]."""

    def __post_init__(self) -> None:
        _check_interval(self.start_s, self.duration_s)
        for name in ("gyro_range_radps", "accel_range_mps2"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class EventBurst(Params):
    """A lamp flickers in an event camera's view: ON and OFF events from a region in turn."""

    kind: Literal["event-burst"] = "event-burst"
    vehicle: int
    """Which vehicle, 0-based."""
    start_s: float
    """When it begins [s]."""
    duration_s: float
    """How long it lasts [s]."""
    rate_hz: float = 50_000.0
    """Events a second, in all [1/s]."""
    flicker_hz: float = 100.0
    """Each period has a half of ON and a half of OFF events [Hz]."""
    region_px: tuple[int, int, int, int] | None = None
    """First column and row, columns and rows [px]; default: the whole image."""

    def __post_init__(self) -> None:
        _check_interval(self.start_s, self.duration_s)
        for name in ("rate_hz", "flicker_hz"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        r = self.region_px
        if r is not None and not (r[0] >= 0 and r[1] >= 0 and r[2] > 0 and r[3] > 0):
            raise ValueError(f"region_px must be x >= 0, y >= 0, columns > 0, rows > 0, got {r}")


SensorFault = DroppedFrames | FrozenCamera | ClockOffset | ImuGap | ImuSaturation | EventBurst


def check_faults(
    faults: Sequence[SensorFault],
    n: int,
    cameras: Sequence[str],
    event_size_px: tuple[int, int] | None,
) -> None:
    """Refuse faults of what does not exist.

    Args:
        faults: Those of the scenario.
        n: Number of vehicles.
        cameras: Names of the cameras of a vehicle.
        event_size_px: Columns and rows of its event camera; None without one.

    Raises:
        ValueError: With one sentence that begins with the key at fault.
    """
    for i, fault in enumerate(faults):
        key = f"sensors.faults[{i}]"
        if fault.vehicle != "payload" and not 0 <= fault.vehicle < n:
            more = " or payload" if isinstance(fault, ImuGap | ImuSaturation) else ""
            raise ValueError(
                f"{key}.vehicle: there is no vehicle {fault.vehicle}; allowed: 0 to {n - 1}{more}"
            )
        camera = getattr(fault, "camera", None)
        if camera is not None and camera not in cameras:
            names = ", ".join(cameras) or "none, the rig has no camera"
            raise ValueError(f"{key}.camera: there is no camera {camera!r}; allowed: {names}")
        if isinstance(fault, EventBurst):
            _check_region(key, fault, event_size_px)


def _check_region(key: str, fault: EventBurst, size_px: tuple[int, int] | None) -> None:
    if size_px is None:
        raise ValueError(f"{key}.kind: event-burst needs an event camera, the rig has none")
    x, y, columns, rows = fault.region_px or (0, 0, *size_px)
    if x + columns > size_px[0] or y + rows > size_px[1]:
        raise ValueError(
            f"{key}.region_px: must lie in the image of {size_px[0]} x {size_px[1]} px, "
            f"got {fault.region_px}"
        )


def is_on(fault: SensorFault, t_us: TimeUs) -> bool:
    """Whether a fault acts at a time; a clock's never ends."""
    begin = round(fault.start_s * US_PER_S)
    if isinstance(fault, ClockOffset):
        return t_us >= begin
    return begin <= t_us < begin + round(fault.duration_s * US_PER_S)


def is_lost(fault: DroppedFrames, seed: int, body: int, index: int, stamp_us: TimeUs) -> bool:
    """Whether an image of the fault's time is lost; the dice are those of (fault, stamp)."""
    if fault.share == 1.0:
        return True
    rng = stream(seed, body, Source.FAULTS, index, stamp_us)
    return bool(rng.random() < fault.share)


def shifted(fault: ClockOffset, frame: CameraFrame) -> CameraFrame:
    """The frame as stamped by a clock that runs away."""
    since_us = frame.stamp_us - round(fault.start_s * US_PER_S)
    ahead = fault.offset_us + round(since_us * fault.drift_ppm * 1e-6)
    return replace(frame, stamp_us=frame.stamp_us + ahead)


def spoilt(fault: ImuSaturation | ImuGap, reading: ImuReading, on: Mask) -> ImuReading:
    """What is left of samples of which some, (k,), are measured while a fault acts."""
    if isinstance(fault, ImuGap):
        keep = ~on
        return ImuReading(reading.stamp_us[keep], reading.gyro_I[keep], reading.accel_I[keep])
    w, f, at = fault.gyro_range_radps, fault.accel_range_mps2, on[:, None]
    gyro = np.where(at, np.clip(reading.gyro_I, -w, w), reading.gyro_I)
    accel = np.where(at, np.clip(reading.accel_I, -f, f), reading.accel_I)
    return ImuReading(reading.stamp_us, gyro, accel)


def _check_interval(start_s: float, duration_s: float) -> None:
    if not start_s >= 0.0:
        raise ValueError(f"start_s must be >= 0, got {start_s}")
    if not duration_s > 0.0:
        raise ValueError(f"duration_s must be > 0, got {duration_s}")
