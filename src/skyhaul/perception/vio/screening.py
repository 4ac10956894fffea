# SPDX-License-Identifier: Apache-2.0
"""Which samples of an IMU are believed, and where some are missing."""

import numpy as np

from skyhaul.sensors.api import ImuReading
from skyhaul.types import US_PER_S, Array, IntArray, TimeUs

GAP_PERIODS = 3.0
"""Samples farther apart than so many usual periods leave a gap."""
MOST_RAD_S, MOST_MPS2 = 70.0, 640.0
"""The widest ranges on sale, 4000 deg/s and 64 g: no sample is beyond them."""

FALSE_RAD_S, FALSE_RAD_S2 = 0.3, 300.0
"""A rate that stands out from its neighbours by more is false. Rotors give a vehicle tens of
rad/s^2, at most 50 on flights of `paper`: several times what they and a tug of the cable can do
between two samples, and what they shake (0.25 rad/s in EuRoC's V1_02)."""
FALSE_MPS2 = 25.0
"""The same of a force: the whole range between no thrust and the most, 2.5 g; EuRoC's shakes by
8 m/s^2."""
ROUGH = 10.0
"""An IMU that shakes more is asked for this many times what its samples usually stand out by."""
NEIGHBOURS = 32
"""So many samples tell how much it shakes."""


def believable(imu: ImuReading) -> ImuReading:
    """Samples that an IMU can measure; the others are as good as missing."""
    fine = np.all(np.abs(imu.gyro_I) <= MOST_RAD_S, axis=1)  # false for nan
    fine &= np.all(np.abs(imu.accel_I) <= MOST_MPS2, axis=1)
    if fine.all():
        return imu
    return ImuReading(imu.stamp_us[fine], imu.gyro_I[fine], imu.accel_I[fine])


def without_false(imu: ImuReading) -> tuple[ImuReading, ImuReading]:
    """Samples without those that stand out from both their neighbours, and what must wait.

    What stays, and be it for two samples, is motion. The newest sample has no neighbour yet: where
    it differs from the one before by too much it waits for the next one.

    Args:
        imu: Samples in order of time.

    Returns:
        Those that stand; the newest one if it must wait.
    """
    dt_s = np.diff(imu.stamp_us) / US_PER_S
    if len(dt_s) < 1 or not np.all(dt_s > 0.0):
        return imu, _rows(imu, np.zeros(0, dtype=np.int64))
    gyro = _steps(imu.gyro_I, FALSE_RAD_S + FALSE_RAD_S2 * dt_s)
    accel = _steps(imu.accel_I, np.full(len(dt_s), FALSE_MPS2))
    steps = np.hstack([gyro, accel])
    out = np.any(steps[:-1] * steps[1:] < 0.0, axis=1)  # there and back
    fine = np.flatnonzero(np.concatenate([[True], ~out, [True]]))
    newest = len(dt_s)
    waits = bool(np.any(steps[-1])) and newest - 1 in fine
    return _rows(imu, fine[:-1] if waits else fine), _rows(imu, fine[-1:] if waits else fine[:0])


def _steps(values: Array, least: Array) -> Array:
    """Direction of each step between neighbours that is too large, else 0, (k - 1, 3).

    Args:
        values: (k, 3).
        least: Steps up to these are motion, (k - 1,).
    """
    steps = np.diff(values, axis=0)
    middle = 0.5 * np.abs(np.diff(steps[-NEIGHBOURS:], axis=0))  # off the mean of both neighbours
    usual = np.median(middle, axis=0) if len(middle) > 2 else np.zeros(3)
    large = np.abs(steps) > np.maximum(least[:, None], ROUGH * usual)
    return np.where(large, np.sign(steps), 0.0)


def _rows(imu: ImuReading, rows: IntArray) -> ImuReading:
    return ImuReading(imu.stamp_us[rows], imu.gyro_I[rows], imu.accel_I[rows])


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
