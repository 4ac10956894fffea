# SPDX-License-Identifier: Apache-2.0
"""A recorded flight as the estimators take it: IMU, rig and tracks in order of time."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from skyhaul.perception.vio.api import CameraRig, TrackFrame
from skyhaul.perception.vio.imu import NO_SAMPLES
from skyhaul.sensors.api import ImuReading
from skyhaul.types import TimeUs


@dataclass(frozen=True, eq=False)
class Recording:
    """IMU, rig and tracks of one vehicle."""

    rig: CameraRig
    imu: ImuReading
    frames: Callable[[], Iterator[TrackFrame]]
    """Yields the tracks of one frame after the other, from the beginning."""
    sigma: float  # standard deviation of a track in the normalised image, per axis
    epoch_ns: int  # time of stamp 0 by the clock of the recording [ns]

    def readings(self) -> Iterator[tuple[ImuReading, TrackFrame]]:
        """Each frame with the IMU samples since the frame before.

        Samples go with the first frame that is not older than they are, and with it the one sample
        behind it, so that rate and force are known on both sides of its stamp.
        """
        done = 0
        for frame in self.frames():
            until = min(len(self.imu.stamp_us), 1 + int(_after(self.imu, frame.stamp_us)))
            until = max(until, done)
            yield part(self.imu, done, until), frame
            done = until


def part(imu: ImuReading, first: int, last: int) -> ImuReading:
    """Samples first to last - 1."""
    if first >= last:
        return NO_SAMPLES
    return ImuReading(imu.stamp_us[first:last], imu.gyro_I[first:last], imu.accel_I[first:last])


def _after(imu: ImuReading, stamp_us: TimeUs) -> int:
    return int(np.searchsorted(imu.stamp_us, stamp_us, side="left"))
