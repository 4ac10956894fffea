# SPDX-License-Identifier: Apache-2.0
"""Which samples of an IMU are believed, and where some are missing."""

import numpy as np
import pytest

from skyhaul.perception.vio.imu import BLIND_RAD_S, ImuNoise
from skyhaul.perception.vio.screening import blind_s2
from skyhaul.sensors.api import ImuReading


def steady(k=201, step_us=5_000):
    """An IMU that stands."""
    stamps = step_us * np.arange(k)
    return ImuReading(stamps, np.zeros((k, 3)), np.tile([0.0, 0.0, 9.8], (k, 1)))


def without(imu, first_us, last_us):
    """Its samples but those between two times."""
    kept = (imu.stamp_us <= first_us) | (imu.stamp_us >= last_us)
    return ImuReading(imu.stamp_us[kept], imu.gyro_I[kept], imu.accel_I[kept])


def test_a_gap_counts_the_same_however_it_is_cut():
    imu = without(steady(), 500_000, 700_000)
    parts = [blind_s2(imu, a, a + 50_000) for a in range(400_000, 800_000, 50_000)]
    assert sum(parts) == pytest.approx(0.2**2)
    assert parts[:2] == [0.0, 0.0]


def test_silence_since_the_last_sample_is_a_gap():
    assert blind_s2(steady(11), 50_000, 62_000) == 0.0
    assert blind_s2(steady(11), 50_000, 150_000) == pytest.approx(0.1**2)


def test_an_unknown_rate_has_turned_by_as_much_as_it_lasted():
    """The variance grows with the square of time, also while nobody knows how long it will last."""
    noise, variance = ImuNoise(gyro_rad_s_rthz=1e-9), 0.0
    for end_us in range(550_000, 750_000, 50_000):
        so_far = without(steady(101), 500_000, 1_000_001)
        wide = noise.through_gaps(so_far, end_us - 50_000, end_us)
        variance += wide.gyro_rad_s_rthz**2 * 0.05
        lasted_s = (end_us - 500_000) / 1e6
        assert np.sqrt(variance) == pytest.approx(BLIND_RAD_S * lasted_s)
