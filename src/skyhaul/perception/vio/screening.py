# SPDX-License-Identifier: Apache-2.0
"""Which samples of an IMU are believed, and where some are missing."""

import numpy as np

from skyhaul.sensors.api import ImuReading
from skyhaul.types import US_PER_S, TimeUs

GAP_PERIODS = 3.0
"""Samples farther apart than so many usual periods leave a gap."""
MOST_RAD_S, MOST_MPS2 = 70.0, 640.0
"""The widest ranges on sale, 4000 deg/s and 64 g: no sample is beyond them."""


def believable(imu: ImuReading) -> ImuReading:
    """Samples that an IMU can measure; the others are as good as missing."""
    fine = np.all(np.abs(imu.gyro_I) <= MOST_RAD_S, axis=1)  # false for nan
    fine &= np.all(np.abs(imu.accel_I) <= MOST_MPS2, axis=1)
    if fine.all():
        return imu
    return ImuReading(imu.stamp_us[fine], imu.gyro_I[fine], imu.accel_I[fine])


def blind_s2(imu: ImuReading, from_us: TimeUs, to_us: TimeUs) -> float:
    """Sum of b^2 - a^2 over gaps of which an interval covers a to b [s^2]; see `through_gaps`.

    A gap is where neighbouring samples, or the last one and the end, lie farther apart than
    `GAP_PERIODS` usual periods; a and b count from its beginning.
    """
    have = imu.stamp_us
    if len(have) < 3:
        return 0.0
    usual = float(np.median(np.diff(have)))
    begin, end = have, np.append(have[1:], max(int(have[-1]), to_us))
    a = (np.maximum(begin, from_us) - begin) / US_PER_S
    b = (np.minimum(end, to_us) - begin) / US_PER_S
    gap = (end - begin > GAP_PERIODS * usual) & (b > a)
    return float(np.sum(b[gap] ** 2 - a[gap] ** 2))
