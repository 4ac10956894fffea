# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.so3 import euler_to_R, euler_zyx, so3_exp
from skyhaul.perception.vio.api import BA, BG, R, StartPose, TrackFrame, V
from skyhaul.perception.vio.standing import Standing, flow, level, stands, static_start
from skyhaul.sensors.api import ImuReading

UP = np.array([0.0, 0.0, 9.81])


def frames(speed=0.0, n=20, tracks=12, noise=0.0, movers=0):
    """Frames 50 ms apart whose tracks move at a speed of the normalised image per second."""
    rng = np.random.default_rng(0)
    at = rng.uniform(-0.5, 0.5, (tracks, 2))
    out = []
    for k in range(n):
        shift = np.full((tracks, 2), 0.05 * k * speed)
        shift[:movers] += 0.05 * k * 0.2
        xy = at + shift + noise * rng.normal(size=(tracks, 2))
        order = rng.permutation(tracks)
        ids, camera = order.astype(np.int64), np.zeros(tracks, dtype=np.int64)
        out.append(TrackFrame(50_000 * k, ids, camera, xy[order]))
    return out


def imu(gyro_std=0.0, accel_std=0.0, R_WI=None, gyro=(0.0, 0.0, 0.0), bias=(0.0, 0.0, 0.0)):
    rng, R_WI = np.random.default_rng(1), np.eye(3) if R_WI is None else R_WI
    stamps = 5_000 * np.arange(200)
    gyro_I = np.array(gyro) + gyro_std * rng.normal(size=(200, 3))
    accel_I = R_WI.T @ UP + np.array(bias) + accel_std * rng.normal(size=(200, 3))
    return ImuReading(stamps, gyro_I, accel_I)


def test_shaking_does_not_hide_that_the_tracks_stand():
    assert stands(Standing(), frames(noise=2e-3), imu(0.1, 2.0), 0.5)


def test_outliers_do_not_hide_it_either():
    assert stands(Standing(), frames(noise=1e-3, movers=5), imu(0.1, 2.0), 0.5)


def test_slow_motion_is_no_standing_however_quiet_the_imu():
    assert not stands(Standing(), frames(speed=0.02), imu(), 0.5)


def test_who_turns_round_does_not_stand():
    """Where it was a second ago it is a second later: the means of the halves agree."""
    f = frames(n=41)
    away = [0.02 * (1e-6 * x.stamp_us - 1.0) ** 2 * np.array([1.0, 0.0]) for x in f]
    turning = [
        TrackFrame(x.stamp_us, x.track_id, x.camera, x.xy + d) for x, d in zip(f, away, strict=True)
    ]
    assert np.max(flow([turning[:20], turning[21:]])[0]) < 1e-9
    assert not stands(Standing(), turning, imu(), 2.0)
    assert stands(Standing(), f, imu(), 2.0)


def test_a_camera_whose_tracks_move_is_not_outvoted_by_one_that_sees_far():
    near = frames(speed=0.02, tracks=8)
    both = [
        TrackFrame(
            a.stamp_us,
            np.concatenate([a.track_id, 100 + b.track_id]),
            np.concatenate([a.camera, b.camera + 1]),
            np.concatenate([a.xy, b.xy]),
        )
        for a, b in zip(near, frames(tracks=40), strict=True)
    ]
    assert not stands(Standing(), both, imu(), 0.5)


@pytest.mark.parametrize(("speed", "at_rest"), [(0.0, True), (0.02, False)])
def test_cameras_that_take_turns_tell_too(speed, at_rest):
    turns = []
    for k, f in enumerate(frames(speed=speed, noise=1e-3, n=41)):
        camera = np.full(len(f.xy), k % 2)
        ids = f.track_id + 100 * camera
        turns.append(TrackFrame(f.stamp_us, ids, camera, f.xy, silent=(1 - k % 2,)))
    assert stands(Standing(), turns, imu(0.1, 2.0), 1.0) == at_rest


def test_frames_must_reach_back_over_the_window():
    assert not stands(Standing(), frames(n=8), imu(), 0.5)


def test_without_tracks_the_imu_decides():
    assert stands(Standing(), frames(tracks=2), imu(0.005, 0.05), 0.5)
    assert not stands(Standing(), frames(tracks=2), imu(0.005, 0.5), 0.5)
    assert not stands(Standing(), frames(tracks=2), imu(0.05, 0.05), 0.5)


def test_flow_is_the_motion_between_the_means():
    f = frames(speed=0.1)
    np.testing.assert_allclose(flow([f[:4], f[4:8]])[0], 0.1 * 0.2 * np.sqrt(2.0), atol=1e-12)
    assert flow([f[:2], []])[0].size == 0


@pytest.mark.parametrize("yaw", [0.0, 2.0, -3.0])
@pytest.mark.parametrize("tilt", [[0.0, 0.0], [0.3, -0.5], [3.1, 0.2], [0.0, 1.5]])
def test_level_sets_gravity_upright_and_the_heading(yaw, tilt):
    R_WI = euler_to_R(np.array([*tilt, 0.7]))
    found = level(R_WI.T @ UP, yaw)
    np.testing.assert_allclose(found @ (R_WI.T @ UP), UP, atol=1e-12)
    np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-12)
    heading = euler_zyx(found)[2] if abs(tilt[1]) < 1.0 else np.arctan2(found[1, 1], found[0, 1])
    assert np.cos(heading - yaw) == pytest.approx(1.0, abs=1e-9)


def test_level_also_turns_what_hangs_upside_down():
    np.testing.assert_allclose(level(-UP, 0.0) @ -UP, UP, atol=1e-12)


def test_static_start_finds_tilt_and_gyro_bias():
    R_WI = euler_to_R(np.array([0.2, -0.3, 0.9]))
    start = StartPose(np.array([1.0, 2.0, 3.0]), yaw_rad=0.9)
    state, P = static_start(Standing(), imu(0.01, 0.5, R_WI, gyro=(0.02, -0.03, 0.08)), start)
    np.testing.assert_allclose(quat_to_R(state.q_WI), R_WI, atol=0.01)
    np.testing.assert_allclose(state.gyro_bias, [0.02, -0.03, 0.08], atol=5e-3)
    np.testing.assert_array_equal(state.p_WI, start.p_WI)
    sigma = np.sqrt(np.diag(P))
    np.testing.assert_allclose(sigma[BG], 0.005, rtol=0.01)
    np.testing.assert_allclose(sigma[V], 0.05, rtol=0.01)
    assert np.linalg.eigvalsh(P).min() > 0.0


def test_bias_across_gravity_and_tilt_cannot_be_told_apart_and_the_covariance_says_so():
    state, P = static_start(Standing(), imu(bias=(0.05, 0.0, 0.03)), StartPose())
    # The upright part is seen; the level part went into the tilt, 0.1 m/s^2 over g uncertain.
    assert state.accel_bias[2] == pytest.approx(0.03, rel=0.25)
    assert abs(state.accel_bias[0]) < 1e-3
    sigma = np.sqrt(np.diag(P))
    assert sigma[R][1] == pytest.approx(np.hypot(0.1, 0.05) / 9.81, rel=0.02)
    # A tilt error t about y and a bias -g t along x leave the same force: correlation near 1.
    correlation = P[R, BA][1, 0] / (sigma[R][1] * sigma[BA][0])
    assert abs(correlation) > 0.85
    e = so3_exp(np.array([0.0, 0.01, 0.0])).T @ UP - UP
    assert np.sign(correlation) == -np.sign(e[0])


def test_heading_and_place_are_as_certain_as_the_start_pose():
    _, P = static_start(Standing(), imu(), StartPose(sigma_m=0.02, sigma_yaw_rad=0.05))
    np.testing.assert_allclose(np.sqrt(np.diag(P))[:3], 0.02)
    assert np.sqrt(P[R, R][2, 2]) == pytest.approx(0.05, rel=1e-3)


def test_thresholds_are_checked():
    with pytest.raises(ValueError, match="window_s must be > 0"):
        Standing(window_s=0.0)
    with pytest.raises(ValueError, match="share must lie between 0 and 1"):
        Standing(share=1.0)
