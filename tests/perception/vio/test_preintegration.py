# SPDX-License-Identifier: Apache-2.0
import os
from pathlib import Path

import gtsam
import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_conj, quat_log, quat_mul, quat_normalize
from skyhaul.geometry.so3 import so3_log
from skyhaul.perception.vio.api import NavState
from skyhaul.perception.vio.factors import imu_parameters
from skyhaul.perception.vio.imu import ImuNoise, advance, segments, since
from skyhaul.perception.vio.preintegration import preintegrate
from skyhaul.perception.vio.propagation import right_jacobian
from skyhaul.sensors.api import ImuReading

NOISE = ImuNoise()
DATA = Path(os.environ.get("SKYHAUL_DATA", Path(__file__).parents[4] / "shared" / "data"))


@pytest.fixture
def samples():
    t = np.arange(1000)[:, None] / 1000.0
    gyro = np.hstack([np.sin(3 * t), 0.5 * np.cos(2 * t), 0.3 + 0.0 * t])
    accel = np.hstack([np.cos(4 * t), np.sin(t), 9.81 + 0.5 * np.sin(5 * t)])
    return np.hstack([np.full((1000, 1), 1e-3), gyro, accel])


@pytest.fixture
def state():
    q = quat_normalize(np.array([0.8, 0.1, -0.4, 0.3]))
    bias = np.array([[0.01, -0.02, 0.03], [0.1, -0.1, 0.05]])
    return NavState(np.array([1.0, 2.0, 3.0]), q, np.array([0.5, -0.4, 0.3]), *bias)


def test_prediction_is_the_propagated_state(samples, state):
    sums = preintegrate(samples, state.gyro_bias, state.accel_bias, NOISE.densities())
    predicted, moved = sums.predict(state), advance(state, samples, NOISE.densities())[0]
    np.testing.assert_allclose(predicted.p_WI, moved.p_WI, atol=1e-12)
    np.testing.assert_allclose(predicted.v_WI, moved.v_WI, atol=1e-12)
    np.testing.assert_allclose(predicted.q_WI, moved.q_WI, atol=1e-12)


def test_other_biases_need_no_new_integration(samples, state):
    gyro_bias, accel_bias = state.gyro_bias, state.accel_bias
    sums = preintegrate(samples, gyro_bias, accel_bias, NOISE.densities())
    d = 1e-3 * np.array([[1.0, -2.0, 1.5], [3.0, 1.0, -2.0]])
    anew = preintegrate(samples, gyro_bias + d[0], accel_bias + d[1], NOISE.densities())
    R_ij, dv, dp = sums.corrected(gyro_bias + d[0], accel_bias + d[1])
    np.testing.assert_allclose(R_ij, anew.R_ij, atol=5e-6)
    np.testing.assert_allclose(dv, anew.dv, atol=5e-5)
    np.testing.assert_allclose(dp, anew.dp, atol=2e-5)
    assert np.linalg.norm(dv - sums.dv) > 5e-3


def test_sums_and_covariance_are_those_of_gtsam(samples, state):
    sums = preintegrate(samples, state.gyro_bias, state.accel_bias, NOISE.densities())
    bias = gtsam.imuBias.ConstantBias(state.accel_bias, state.gyro_bias)
    theirs = gtsam.PreintegratedCombinedMeasurements(imu_parameters(NOISE), bias)
    for row in samples:
        theirs.integrateMeasurement(row[4:], row[1:4], row[0])
    # GTSAM turns each force by the attitude before its sample: 1 ms of turn apart.
    np.testing.assert_allclose(sums.R_ij, theirs.deltaRij().matrix(), atol=1e-5)
    np.testing.assert_allclose(sums.dv, theirs.deltaVij(), atol=1.5e-2)
    np.testing.assert_allclose(sums.dp, theirs.deltaPij(), atol=1e-2)
    ours, layout = sums.covariance, np.r_[3:6, 0:3, 6:9]  # GTSAM: turn, place, speed
    # Its turn is a rotation vector; ours is an error on the right of R_ij.
    to_right = np.eye(9)
    jacobian = np.empty((3, 3))
    right_jacobian(so3_log(sums.R_ij), jacobian)
    to_right[:3, :3] = jacobian
    expected = to_right @ theirs.preintMeasCov()[:9, :9] @ to_right.T
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        ours[np.ix_(layout, layout)] / np.outer(sigma, sigma),
        expected / np.outer(sigma, sigma),
        atol=0.03,
    )


@pytest.mark.skipif(not (DATA / "euroc").is_dir(), reason=f"no recordings in {DATA}")
def test_one_second_of_a_real_imu_stays_close_to_the_truth():
    imu_rows = np.loadtxt(
        DATA / "euroc" / "V1_02_medium_imu.csv", delimiter=",", skiprows=1, max_rows=4000
    )
    rows = np.loadtxt(
        DATA / "euroc" / "V1_02_medium_truth.csv", delimiter=",", skiprows=1, max_rows=3500
    )
    imu = ImuReading(_us(imu_rows[:, 0]), imu_rows[:, 1:4].copy(), imu_rows[:, 4:7].copy())
    errors = []
    for a, b in zip(rows[:-200:100], rows[200::100], strict=True):
        start = NavState(a[1:4], quat_normalize(a[4:8]), a[8:11], a[11:14], a[14:17])
        first, last = int(_us(a[:1])[0]), int(_us(b[:1])[0])
        end, _, Q = advance(start, segments(since(imu, first), first, last), NOISE.densities())
        turn = quat_log(quat_mul(quat_conj(b[4:8]), end.q_WI))
        errors.append([np.linalg.norm(e) for e in (end.p_WI - b[1:4], end.v_WI - b[8:11], turn)])
        assert np.all(np.linalg.eigvalsh(Q) >= -1e-15)
    p_m, v_mps, turn_rad = np.median(errors, axis=0)
    assert p_m <= 0.03
    assert v_mps <= 0.05
    assert np.degrees(turn_rad) <= 0.15


def _us(time_ns):
    return ((np.asarray(time_ns) - 1403715523912143104) / 1000).astype(np.int64)
