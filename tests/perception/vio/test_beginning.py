# SPDX-License-Identifier: Apache-2.0
"""The first state of a vehicle that is known to stand for a moment."""

import numpy as np
import pytest

from skyhaul.errors import SensorDataError
from skyhaul.geometry.quaternion import quat_exp, quat_rotate, quat_to_R
from skyhaul.perception.vio.api import BG, CameraRig, P, StartPose, TrackFrame, V
from skyhaul.perception.vio.beginning import Beginning, begin
from skyhaul.perception.vio.imu import ImuNoise
from skyhaul.perception.vio.intake import Intake
from skyhaul.sensors.api import ImuReading

RIG = CameraRig(np.eye(3)[None], np.zeros((1, 3)))
BIAS = np.array([2e-3, -1e-3, 3e-3])
NOTHING = (np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 2)))


def intake(now_us, lift_us=10**9, bias=BIAS, gyro_scale=1.0):
    """A body at 500 Hz that stands, then rises with 2 m/s^2; frames every 50 ms up to now."""
    t = np.arange(1_000, now_us + 2_000, 2_000)
    rng, n = np.random.default_rng(0), len(t)
    gyro = gyro_scale * (bias + 5e-3 * rng.normal(size=(n, 3)))
    accel = np.array([0.0, 0.0, 9.80665]) + 0.04 * rng.normal(size=(n, 3))
    accel[t > lift_us, 2] += 2.0
    out = Intake(3.0)
    for stamp in range(0, now_us + 1, 50_000):
        new = (t <= stamp + 2_000) & (t > (out.imu.stamp_us[-1] if len(out.imu.stamp_us) else -1))
        imu = ImuReading(t[new], gyro[new], accel[new])
        out = out.take(imu, TrackFrame(stamp, *NOTHING))
    return out


def first(intake, start):
    return begin(Beginning(), intake, start, RIG, ImuNoise(), 1e-3)


def test_a_tenth_of_a_second_is_enough():
    start = StartPose(np.array([1.0, 2.0, 3.0]), 0.5, stands_until_us=100_000)
    assert first(intake(50_000), start) is None
    state, covariance = first(intake(100_000), start)
    np.testing.assert_allclose(state.gyro_bias, BIAS, atol=2e-3)
    np.testing.assert_array_equal(state.p_WI, start.p_WI)
    assert np.sqrt(np.diag(covariance))[BG].max() < 0.01


def test_what_comes_after_it_moves_the_state_and_its_covariance():
    start = StartPose(stands_until_us=100_000)
    before, P_before = first(intake(100_000, lift_us=100_000), start)
    state, covariance = first(intake(150_000, lift_us=100_000), start)
    np.testing.assert_allclose(state.v_WI, [0.0, 0.0, 0.1], atol=0.01)
    np.testing.assert_allclose(state.p_WI - before.p_WI, [0, 0, 0.0025], atol=5e-4)
    # A speed that is known to 5 cm/s makes the place less certain within 50 ms.
    assert np.trace(covariance[P, P]) > 3.0 * np.trace(P_before[P, P])
    assert np.trace(covariance[V, V]) > np.trace(P_before[V, V])


def test_a_surveyed_attitude_begins_in_motion():
    """At rest at time 0, then 2 m/s^2 along its own z axis, which leans by 0.3 rad."""
    q_WI = quat_exp(np.array([0.3, 0.0, 0.0]))
    start = StartPose(np.array([1.0, 2.0, 3.0]), q_WI=q_WI)
    state, covariance = first(intake(100_000, lift_us=0, bias=np.zeros(3)), start)
    a = quat_rotate(q_WI, np.array([0.0, 0.0, 9.80665 + 2.0])) - [0.0, 0.0, 9.80665]
    np.testing.assert_allclose(state.v_WI, 0.1 * a, atol=5e-3)
    np.testing.assert_allclose(state.p_WI, start.p_WI + 0.005 * a, atol=5e-4)
    np.testing.assert_allclose(quat_to_R(state.q_WI), quat_to_R(q_WI), atol=1e-3)
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert first(intake(0), start) is None  # no samples yet


def test_an_imu_whose_samples_are_nonsense_is_refused():
    start = StartPose(stands_until_us=100_000)
    with pytest.raises(SensorDataError, match="gyroscope reads"):
        first(intake(100_000, bias=np.full(3, 1.0), gyro_scale=57.3), start)


def test_without_samples_there_is_no_state():
    start = StartPose(stands_until_us=100_000)
    empty = Intake(3.0)
    for stamp in (0, 100_000):
        none = ImuReading(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
        empty = empty.take(none, TrackFrame(stamp, *NOTHING))
    assert first(empty, start) is None
