# SPDX-License-Identifier: Apache-2.0
"""Which samples of an IMU are believed, and where some are missing."""

import numpy as np
import pytest

from skyhaul.perception.vio.imu import BLIND_RAD_S, ImuNoise
from skyhaul.perception.vio.screening import blind_s2, without_false
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


def spoilt(imu, at, gyro=(0.0, 0.0, 0.0), accel=(0.0, 0.0, 0.0)):
    """The same with something added to a sample, or to some."""
    rate, force = imu.gyro_I.copy(), imu.accel_I.copy()
    rate[at] += gyro
    force[at] += accel
    return ImuReading(imu.stamp_us, rate, force)


def shaking(size_rad_s, size_mps2, seed=0):
    """An IMU at 500 Hz that shakes."""
    rng, imu = np.random.default_rng(seed), steady(200, 2_000)
    gyro, accel = (size * rng.normal(size=(200, 3)) for size in (size_rad_s, size_mps2))
    return ImuReading(imu.stamp_us, imu.gyro_I + gyro, imu.accel_I + accel)


@pytest.mark.parametrize("off", [{"gyro": (0.0, -2.0, 0.0)}, {"accel": (50.0, 0.0, 0.0)}])
@pytest.mark.parametrize("at", [1, 50, 198])
def test_a_sample_that_stands_out_from_its_neighbours_is_false(at, off):
    imu = spoilt(shaking(0.02, 1.0), at, **off)
    fine, waiting = without_false(imu)
    assert set(imu.stamp_us) - set(fine.stamp_us) == {2_000 * at}
    assert not len(waiting.stamp_us)


@pytest.mark.parametrize("off", [{"gyro": (0.0, -2.0, 0.0)}, {"accel": (50.0, 0.0, 0.0)}])
def test_the_newest_sample_waits_for_the_next_one(off):
    imu = spoilt(shaking(0.02, 1.0), 199, **off)
    fine, waiting = without_false(imu)
    assert fine.stamp_us[-1] == 396_000
    np.testing.assert_array_equal(waiting.stamp_us, [398_000])


@pytest.mark.parametrize("last", [2, 20])
def test_what_stays_is_motion(last):
    imu = spoilt(shaking(0.02, 1.0), slice(100, 100 + last), (0.0, 5.0, 0.0), (40.0, 0.0, 0.0))
    assert len(without_false(imu)[0].stamp_us) == 200


def test_rotors_that_shake_and_turn_a_vehicle_as_fast_as_they_can_are_believed():
    for seed in range(10):
        shaken = shaking(1.0, 20.0, seed)
        assert len(without_false(shaken)[0].stamp_us) >= 199
    t = 0.002 * np.arange(200)
    turn = np.outer(6.0 * np.sin(2 * np.pi * 8.0 * t), [1.0, 0.5, 0.0])  # 300 rad/s^2
    push = np.outer(20.0 * np.sign(np.sin(2 * np.pi * 30.0 * t)), [0.0, 0.0, 1.0])
    assert (
        len(without_false(spoilt(steady(200, 2_000), slice(None), turn, push))[0].stamp_us) == 200
    )


def test_after_a_gap_any_sample_is_believed_that_the_next_one_bears_out():
    imu = spoilt(without(steady(), 500_000, 600_000), slice(101, None), (9.0, 0.0, 0.0), (0, 0, 9))
    assert len(without_false(imu)[0].stamp_us) == len(imu.stamp_us)


def test_nonsense_in_time_is_left_to_others():
    for imu in (steady(1), steady(0), ImuReading(*(a[::-1] for a in vars(steady()).values()))):
        assert without_false(imu)[0] is imu
