# SPDX-License-Identifier: Apache-2.0
"""A recorded flight as the estimators take it: IMU, rig and tracks in order of time."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from skyhaul.geometry.camera import CameraArrays
from skyhaul.perception.vio.api import CameraRig, TrackFrame
from skyhaul.perception.vio.front_end import Followed
from skyhaul.perception.vio.imu import NO_SAMPLES
from skyhaul.sensors.api import ImuReading
from skyhaul.types import TimeUs

Views = tuple[Followed | None, ...]
"""What the front end follows in each camera."""


@dataclass(frozen=True, eq=False)
class Images:
    """A recording's images, followed: for what needs more than tracks."""

    lenses: tuple[CameraArrays, ...]  # of the cameras
    frames: Callable[[], Iterator[tuple[TrackFrame, Views]]]
    """As `Recording.frames`, and what is followed in each camera then."""


@dataclass(frozen=True, eq=False)
class Recording:
    """IMU, rig and tracks of one vehicle."""

    rig: CameraRig
    imu: ImuReading
    frames: Callable[[], Iterator[TrackFrame]]
    """Yields the tracks of one frame after the other, from the beginning."""
    sigma: float  # standard deviation of a track in the normalised image, per axis
    epoch_ns: int  # time of stamp 0 by the clock of the recording [ns]
    images: Images | None = None  # None: there are only tracks

    def readings(self) -> Iterator[tuple[ImuReading, TrackFrame]]:
        """Each frame with the IMU samples since the frame before."""
        none: Views = ()
        pairs = ((frame, none) for frame in self.frames())
        return ((imu, frame) for imu, frame, _ in self._with_imu(pairs))

    def views(self) -> Iterator[tuple[ImuReading, TrackFrame, Views]]:
        """The same with the images; only where there are some."""
        assert self.images is not None, "asked for before"
        return self._with_imu(self.images.frames())

    def _with_imu(
        self, frames: Iterator[tuple[TrackFrame, Views]]
    ) -> Iterator[tuple[ImuReading, TrackFrame, Views]]:
        """Samples go with the first frame that is not older than they are.

        With it goes the one sample behind it, so that rate and force are known on both sides of
        its stamp.
        """
        done = 0
        for frame, views in frames:
            until = min(len(self.imu.stamp_us), 1 + int(_after(self.imu, frame.stamp_us)))
            until = max(until, done)
            yield part(self.imu, done, until), frame, views
            done = until


def part(imu: ImuReading, first: int, last: int) -> ImuReading:
    """Samples first to last - 1."""
    if first >= last:
        return NO_SAMPLES
    return ImuReading(imu.stamp_us[first:last], imu.gyro_I[first:last], imu.accel_I[first:last])


def _after(imu: ImuReading, stamp_us: TimeUs) -> int:
    return int(np.searchsorted(imu.stamp_us, stamp_us, side="left"))
