# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.errors import SensorDataError
from skyhaul.perception.vio.api import TrackFrame
from skyhaul.perception.vio.imu import (
    BLIND_MPS2,
    BLIND_RAD_S,
    ImuNoise,
    join,
    segments,
    since,
)
from skyhaul.perception.vio.imu_check import check_imu, coherence
from skyhaul.perception.vio.intake import Intake
from skyhaul.sensors.api import ImuReading


def ramp(k=11, step_us=5_000):
    """Rate and force that grow linearly with time."""
    stamps = step_us * np.arange(k)
    line = np.outer(stamps / 1e6, np.ones(3))
    return ImuReading(stamps, line, 2.0 * line)


def steady(seconds=1.2, rate_hz=200, gyro=(0.02, -0.01, 0.05), seed=0):
    """An IMU that stands, with noise."""
    rng = np.random.default_rng(seed)
    n = round(seconds * rate_hz)
    stamps = (np.arange(n) * 1_000_000) // rate_hz
    noise = 0.02 * rng.normal(size=(n, 6))
    return ImuReading(stamps, np.array(gyro) + noise[:, :3], [0.5, -0.3, 9.77] + noise[:, 3:])


def changed(imu, stamp_us=None, gyro=None, accel=None):
    return ImuReading(
        imu.stamp_us.copy() if stamp_us is None else stamp_us,
        imu.gyro_I.copy() if gyro is None else gyro,
        imu.accel_I.copy() if accel is None else accel,
    )


def test_segments_fill_the_interval_and_hold_the_mean_of_a_ramp():
    s = segments(ramp(), 2_500, 31_000)
    assert s[:, 0].sum() == pytest.approx(0.0285)
    # Integral of t over the interval: the trapezoids of a line are exact.
    assert s[:, 0] @ s[:, 1] == pytest.approx((0.031**2 - 0.0025**2) / 2.0)
    np.testing.assert_allclose(s[:, 4:], 2.0 * s[:, 1:4])


def test_behind_the_last_sample_its_value_holds():
    s = segments(ramp(3), 10_000, 30_000)
    np.testing.assert_allclose(s, [[0.02, *[0.01] * 3, *[0.02] * 3]])


def test_since_keeps_the_sample_before():
    np.testing.assert_array_equal(since(ramp(), 12_000).stamp_us[:2], [10_000, 15_000])
    np.testing.assert_array_equal(since(ramp(), -5).stamp_us, ramp().stamp_us)
    both = join(ramp(3), changed(ramp(3), stamp_us=ramp(3).stamp_us + 15_000))
    np.testing.assert_array_equal(both.stamp_us, 5_000 * np.arange(6))


def with_gap(first_us, last_us, k=201, step_us=5_000):
    imu = ramp(k, step_us)
    kept = (imu.stamp_us <= first_us) | (imu.stamp_us >= last_us)
    return ImuReading(imu.stamp_us[kept], imu.gyro_I[kept], imu.accel_I[kept])


def test_missing_samples_add_the_noise_of_an_unknown_turn():
    noise, imu = ImuNoise(), with_gap(500_000, 700_000)
    assert noise.through_gaps(ramp(201), 300_000, 900_000) == noise
    assert noise.through_gaps(imu, 100_000, 500_000) == noise
    wide = noise.through_gaps(imu, 300_000, 900_000)
    # Over the interval of 0.6 s: white noise turns by density sqrt(0.6 s), the gap by 1 rad/s 0.2 s
    assert wide.gyro_rad_s_rthz * np.sqrt(0.6) == pytest.approx(BLIND_RAD_S * 0.2, rel=1e-4)
    assert wide.accel_mps2_rthz * np.sqrt(0.6) == pytest.approx(BLIND_MPS2 * 0.2, rel=1e-4)


def test_noise_must_be_positive():
    with pytest.raises(ValueError, match="gyro_rad_s_rthz must be > 0"):
        ImuNoise(gyro_rad_s_rthz=0.0)


def test_a_sound_imu_passes():
    check_imu(steady())
    assert coherence(steady()) > 0.99


def test_a_fast_turn_passes_when_the_force_turns_with_it():
    t = np.arange(240) / 200.0
    turned = np.column_stack([9.81 * np.sin(2 * t), 0 * t, 9.81 * np.cos(2 * t)])
    check_imu(ImuReading((t * 1e6).astype(np.int64), np.tile([0, -2.0, 0], (240, 1)), turned))


@pytest.mark.parametrize(
    ("imu", "message"),
    [
        (changed(steady(), accel=steady().accel_I / 9.81), "in m/s"),
        (changed(steady(), accel=0.0 * steady().accel_I), "accelerometer reads 0 m/s"),
        (changed(steady(), gyro=np.degrees(steady(gyro=(0.0, 0.08, 0.0)).gyro_I)), "in rad/s"),
        (changed(steady(), gyro=steady(gyro=(40.0, 0, 0)).gyro_I), "reads 40 rad/s"),
        (changed(steady(), stamp_us=steady().stamp_us[::-1].copy()), "stamps must grow"),
        (changed(steady(), stamp_us=steady().stamp_us // 1000), "2e\\+05 samples a second"),
        (changed(steady(), stamp_us=steady().stamp_us * 1000), "0.2 samples a second"),
        (steady(rate_hz=20), "20 samples a second"),
        (steady(seconds=0.005), "1 samples in its first second"),
        (changed(steady(), gyro=np.full((240, 3), np.nan)), "not finite"),
    ],
)
def test_nonsense_is_refused_in_one_sentence(imu, message):
    with pytest.raises(SensorDataError, match=message) as caught:
        check_imu(imu)
    assert "\n" not in str(caught.value)


def test_a_gap_is_refused():
    stamps = steady().stamp_us.copy()
    stamps[100:] += 300_000
    with pytest.raises(SensorDataError, match=r"a gap of 0\.305 s"):
        check_imu(changed(steady(), stamp_us=stamps))


def frame(stamp_us):
    return TrackFrame(
        stamp_us, np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    )


def test_intake_keeps_what_is_young_and_refuses_time_that_goes_back():
    intake, imu = Intake(1.1), steady(2.0)
    for k in range(20):
        part = slice(20 * k, 20 * (k + 1))
        samples = ImuReading(imu.stamp_us[part], imu.gyro_I[part], imu.accel_I[part])
        intake = intake.take(samples, frame(100_000 * (k + 1)))
    assert intake.checked
    assert intake.frames[0].stamp_us == 900_000
    assert intake.imu.stamp_us[0] == 900_000
    with pytest.raises(SensorDataError, match="frame at 2000000 us came after"):
        intake.take(
            ImuReading(*(a[:0] for a in (imu.stamp_us, imu.gyro_I, imu.accel_I))), frame(2_000_000)
        )
    with pytest.raises(SensorDataError, match="sample at 0 us came after"):
        intake.take(imu, frame(2_100_000))


def test_nonsense_is_refused_as_soon_as_a_second_is_there():
    imu = changed(steady(2.0), accel=steady(2.0).accel_I / 9.81)
    with pytest.raises(SensorDataError, match="accelerometer"):
        Intake(3.0).take(imu, frame(2_000_000))


def test_an_imu_that_stays_behind_the_frames_is_refused():
    imu = steady(2.0)
    slow = changed(imu, stamp_us=imu.stamp_us // 1000)
    intake = Intake(3.0).take(slow, frame(100_000))
    with pytest.raises(SensorDataError, match="samples a second"):
        intake.take(changed(slow, stamp_us=slow.stamp_us + 2_000), frame(2_000_000))


def test_an_error_of_scale_counts_with_the_turn_and_with_the_force_beyond_gravity():
    noise = ImuNoise(scale_error=0.01)

    def over(gyro, accel):
        return noise.over(np.array([[0.05, *gyro, *accel], [0.05, *gyro, *accel]]))

    g = [0.0, 0.0, 9.80665]
    np.testing.assert_allclose(over([0, 0, 0], g), noise.densities(), rtol=1e-3)
    turning, pushed = over([0.0, 2.0, 0.0], g), over([0, 0, 0], [0.0, 0.0, 12.0])
    assert turning[0] == pytest.approx(0.01 * 2.0 * np.sqrt(2.0), rel=1e-3)
    assert pushed[1] > 2.0 * noise.densities()[1]
    # What goes to and fro cancels.
    fro = np.array([[0.05, 0, 2.0, 0, *g], [0.05, 0, -2.0, 0, *g]])
    np.testing.assert_allclose(noise.over(fro), noise.densities(), rtol=1e-3)
