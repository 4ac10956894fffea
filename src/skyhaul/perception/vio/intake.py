# SPDX-License-Identifier: Apache-2.0
"""What has come in lately: samples and frames, in order, checked once."""

from dataclasses import dataclass, replace

import numpy as np

from skyhaul.errors import SensorDataError
from skyhaul.perception.vio.api import TrackFrame
from skyhaul.perception.vio.imu import NO_SAMPLES, join, since
from skyhaul.perception.vio.imu_check import check_imu
from skyhaul.perception.vio.screening import believable, without_false
from skyhaul.sensors.api import ImuReading
from skyhaul.types import US_PER_S, TimeUs

CHECK_S = 1.0
"""Length of the IMU data that is checked at the start [s]."""


@dataclass(frozen=True, eq=False)
class Intake:
    """Samples and frames of the last `keep_s` seconds."""

    keep_s: float
    imu: ImuReading = NO_SAMPLES
    frames: tuple[TrackFrame, ...] = ()
    checked: bool = False
    waiting: ImuReading = NO_SAMPLES  # the newest sample, until the next bears it out

    @property
    def now_us(self) -> TimeUs:
        """Stamp of the last frame."""
        return self.frames[-1].stamp_us

    def take(self, imu: ImuReading, tracks: TrackFrame) -> "Intake":
        """Add what came; false samples count as missing.

        Those that no IMU measures do so once the start is checked.

        Raises:
            SensorDataError: When time goes back, or when the first second is nonsense.
        """
        if self.frames and tracks.stamp_us <= self.now_us:
            raise SensorDataError(
                f"tracks: a frame at {tracks.stamp_us} us came after one at {self.now_us} us; "
                f"stamps must grow from frame to frame"
            )
        had = join(self.imu, self.waiting)
        have, new = had.stamp_us, imu.stamp_us
        if len(have) and len(new) and new[0] <= have[-1]:
            raise SensorDataError(
                f"IMU: a sample at {new[0]} us came after one at {have[-1]} us; "
                f"stamps must grow from sample to sample"
            )
        samples = join(had, believable(imu) if self.checked else imu)
        checked = self.checked
        oldest_us = tracks.stamp_us - round(self.keep_s * US_PER_S)
        frames = tuple(f for f in (*self.frames, tracks) if f.stamp_us >= oldest_us)
        span_s = (tracks.stamp_us - frames[0].stamp_us) / US_PER_S
        if not checked and (_span_s(samples) >= CHECK_S or span_s >= 1.5 * CHECK_S):
            check_imu(samples)
            checked = True
        imu, waiting = without_false(since(samples, oldest_us))
        return replace(self, imu=imu, waiting=waiting, frames=frames, checked=checked)


def _span_s(imu: ImuReading) -> float:
    return float(np.ptp(imu.stamp_us)) / US_PER_S if len(imu.stamp_us) else 0.0
