# SPDX-License-Identifier: Apache-2.0
"""Does an IMU's first second make sense?"""

import numpy as np

from skyhaul.errors import SensorDataError
from skyhaul.geometry.so3 import so3_exp
from skyhaul.sensors.api import ImuReading
from skyhaul.types import GRAVITY_MPS2, US_PER_S, Array

RATE_HZ = (50.0, 2000.0)
"""Rates of an IMU that we take."""
GAP_S = 0.1
"""A longer gap between samples is a fault."""
FORCE = (0.7, 1.4)
"""Mean specific force of the first second, in g."""
RATE_RAD_S = 20.0
"""A faster median turn is no flight, more likely degrees per second."""
COHERENCE = 0.75
"""Least length of the mean force in fixed axes, as a share of the mean length of the force."""


def check_imu(imu: ImuReading) -> None:
    """Refuse nonsense: bad order, rate, scale of the forces or of the turns.

    The gyroscope's scale shows in the force: turned into the axes of the first sample by the
    gyroscope, it stays near the vertical for a second; with rates in degrees it smears out.

    Raises:
        SensorDataError: When the samples are no IMU's.
    """
    if len(imu.stamp_us) < 2:
        raise SensorDataError(
            f"IMU: {len(imu.stamp_us)} samples in its first second; "
            f"{RATE_HZ[0]:g} to {RATE_HZ[1]:g} a second are needed"
        )
    _check_finite(imu)
    _check_times(imu.stamp_us / US_PER_S)
    force = np.linalg.norm(imu.accel_I, axis=1)
    share = float(np.linalg.norm(imu.accel_I.mean(axis=0))) / GRAVITY_MPS2
    if not FORCE[0] <= max(share, float(np.mean(force)) / GRAVITY_MPS2) <= FORCE[1]:
        raise SensorDataError(
            f"IMU: the accelerometer reads {share * GRAVITY_MPS2:.3g} m/s^2 on average, "
            f"{FORCE[0]:g} to {FORCE[1]:g} g = 9.81 m/s^2 is allowed; give specific force in m/s^2"
        )
    turn = float(np.median(np.linalg.norm(imu.gyro_I, axis=1)))
    if not turn <= RATE_RAD_S or not coherence(imu) >= COHERENCE:
        raise SensorDataError(
            f"IMU: the gyroscope reads {turn:.3g} rad/s (median) and contradicts the direction of "
            f"gravity in the accelerometer; give angular rates in rad/s, in the same axes"
        )


def coherence(imu: ImuReading) -> float:
    """Length of the mean force in axes that the gyroscope holds fixed, over its mean length."""
    R, turned = np.eye(3), [imu.accel_I[0]]
    dt_s = np.diff(imu.stamp_us) / US_PER_S
    for w, a, h in zip(imu.gyro_I[:-1], imu.accel_I[1:], dt_s, strict=True):
        R = R @ so3_exp(h * w)
        turned.append(R @ a)
    mean: Array = np.mean(turned, axis=0)
    return float(np.linalg.norm(mean) / np.mean(np.linalg.norm(imu.accel_I, axis=1)))


def _check_finite(imu: ImuReading) -> None:
    if not (np.all(np.isfinite(imu.gyro_I)) and np.all(np.isfinite(imu.accel_I))):
        raise SensorDataError("IMU: a sample is not finite; give numbers in every sample")


def _check_times(t_s: Array) -> None:
    dt_s = np.diff(t_s)
    if not np.all(dt_s > 0.0):
        raise SensorDataError(
            f"IMU: time goes from {t_s[np.argmin(dt_s)]:.6f} s by {dt_s.min():.6f} s; "
            f"stamps must grow from sample to sample"
        )
    rate_hz = 1.0 / float(np.median(dt_s))
    if not RATE_HZ[0] <= rate_hz <= RATE_HZ[1]:
        raise SensorDataError(
            f"IMU: {rate_hz:.3g} samples a second, {RATE_HZ[0]:g} to {RATE_HZ[1]:g} are allowed; "
            f"check the unit of its stamps"
        )
    if not np.all(dt_s <= GAP_S):
        raise SensorDataError(
            f"IMU: a gap of {dt_s.max():.3g} s between two samples, {GAP_S} s is allowed"
        )
