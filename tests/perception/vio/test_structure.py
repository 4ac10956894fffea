# SPDX-License-Identifier: Apache-2.0
"""Triangulation, structure from motion, alignment with the IMU, start in motion."""

from itertools import pairwise

import numpy as np
import pytest
from simulated_tracks import ACCEL_BIAS, GYRO_BIAS, Flight, motion, rig_of, simulate

from skyhaul.evaluation.trajectory_error import align
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.so3 import so3_exp, so3_log
from skyhaul.perception.vio.alignment import align_poses, gyro_bias_step
from skyhaul.perception.vio.api import StartPose
from skyhaul.perception.vio.imu import ImuNoise, segments
from skyhaul.perception.vio.intake import Intake
from skyhaul.perception.vio.moving_start import MovingStart, moving_start
from skyhaul.perception.vio.preintegration import preintegrate
from skyhaul.perception.vio.standing import Standing
from skyhaul.perception.vio.structure import build_structure, relative_pose, sighted
from skyhaul.perception.vio.triangulation import locate

FAST = Flight(still_s=0.0, duration_s=5.0, noise_px=0.0, seed=3)
QUIET = ImuNoise()


@pytest.fixture(scope="module")
def flown():
    return simulate(FAST)


def picked(flown, first=20, last=80, every=5):
    """Frames of the flight and their true poses."""
    rows = range(first, last + 1, every)
    frames = list(flown.recording.frames())
    R_WI = quat_to_R(flown.truth.q[list(rows)])
    return [sighted(frames[i], 0) for i in rows], R_WI, flown.truth.p[list(rows)], list(rows)


def test_bearings_that_meet_give_their_point():
    rng = np.random.default_rng(0)
    R_WC = so3_exp(0.1 * rng.normal(size=(5, 3)))
    p_WC, point = 0.5 * rng.normal(size=(5, 3)), np.array([0.3, -0.4, 4.0])
    c = np.einsum("kji,kj->ki", R_WC, point - p_WC)
    found = locate(R_WC, p_WC, c[:, :2] / c[:, 2:])
    np.testing.assert_allclose(found.p_WP, point, atol=1e-9)
    assert found.error < 1e-12
    assert found.depth_m == pytest.approx(c[:, 2].min())


def test_triangulation_is_least_squares_in_the_image():
    # Two-dimensional check: the point that SciPy finds for the same errors.
    from scipy.optimize import least_squares

    rng = np.random.default_rng(1)
    R_WC, p_WC = so3_exp(0.1 * rng.normal(size=(6, 3))), 0.5 * rng.normal(size=(6, 3))

    def images(x):
        c = np.einsum("kji,kj->ki", R_WC, x - p_WC)
        return c[:, :2] / c[:, 2:]

    xy = images(np.array([0.3, -0.4, 4.0])) + 0.01 * rng.normal(size=(6, 2))
    best = least_squares(lambda x: (images(x) - xy).ravel(), [0.0, 0.0, 3.0]).x
    np.testing.assert_allclose(locate(R_WC, p_WC, xy).p_WP, best, atol=1e-4)


def test_parallel_bearings_and_points_behind_are_told():
    R_WC, p_WC = np.stack([np.eye(3)] * 2), np.array([[0.0, 0, 0], [0.5, 0, 0]])
    assert (
        locate(R_WC, p_WC, np.zeros((2, 2))).depth_m <= 0.0
        or not np.isfinite(locate(R_WC, p_WC, np.zeros((2, 2))).p_WP).all()
    )
    crossed = locate(R_WC, p_WC, np.array([[-0.1, 0.0], [0.1, 0.0]]))
    assert not crossed.depth_m > 0.0 or crossed.error > 0.05


def test_two_views_give_the_direction_and_the_turn(flown):
    seen, R_WI, p_WI, _ = picked(flown)
    rig = rig_of(1)
    R_ab, p_ab, good = relative_pose(seen[0], seen[-4], 1e-4, 8)
    R_WC, p_WC = R_WI @ rig.R_IC[0], p_WI + R_WI @ rig.p_IC[0]
    true_R, true_p = R_WC[0].T @ R_WC[-4], R_WC[0].T @ (p_WC[-4] - p_WC[0])
    assert np.linalg.norm(so3_log(true_R.T @ R_ab)) < 1e-3
    assert p_ab @ true_p / np.linalg.norm(true_p) > 1.0 - 1e-4
    assert len(good) >= 8


def test_structure_is_the_true_path_up_to_scale(flown):
    seen, R_WI, p_WI, _ = picked(flown)
    rig = rig_of(1)
    found = build_structure(seen, flown.recording.sigma, 8, 0.03)
    p_WC = p_WI + R_WI @ rig.p_IC[0]
    s, R, t = align(found.p_SC, p_WC, with_scale=True)
    error = np.linalg.norm(s * found.p_SC @ R.T + t - p_WC, axis=1)
    path = np.linalg.norm(np.diff(p_WC, axis=0), axis=1).sum()
    assert error.max() < 1e-3 * path
    turns = so3_log(np.swapaxes(R @ found.R_SC, 1, 2) @ (R_WI @ rig.R_IC[0]))
    assert np.linalg.norm(turns, axis=1).max() < 1e-3


def test_no_structure_without_motion():
    still = simulate(Flight(still_s=5.0, duration_s=2.0))
    frames = [sighted(f, 0) for f in list(still.recording.frames())[::5]]
    assert build_structure(frames, still.recording.sigma, 8, 0.03) is None


def test_exact_poses_and_motions_give_exact_scale_gravity_velocity_and_bias():
    flight = Flight(still_s=0.0, duration_s=4.0, seed=5)
    exact = Flight(still_s=0.0, duration_s=4.0, seed=5, gyro_rad_s_rthz=0.0, accel_mps2_rthz=0.0)
    flown, pose = simulate(exact), motion(flight)
    R_IC, p_IC = flown.recording.rig.R_IC[0], flown.recording.rig.p_IC[0]
    stamps = 150_000 * np.arange(6, 22)
    p_WI, R_WI = pose(stamps / 1e6)
    turn = so3_exp(np.array([1.0, -0.5, 2.0]))  # poses in tilted axes, a third of their size
    R_SI, p_SC = turn @ R_WI, (p_WI + R_WI @ p_IC) @ turn.T / 3.0
    pairs = [segments(flown.recording.imu, int(a), int(b)) for a, b in pairwise(stamps)]
    bias = np.zeros(3)
    for _ in range(3):
        motions = [preintegrate(s, bias, ACCEL_BIAS, QUIET.densities()) for s in pairs]
        bias = bias + gyro_bias_step(motions, R_SI)
    np.testing.assert_allclose(bias, GYRO_BIAS, atol=1e-4)
    motions = [preintegrate(s, bias, ACCEL_BIAS, QUIET.densities()) for s in pairs]
    found = align_poses(motions, R_SI, p_SC, p_IC)
    assert found.scale == pytest.approx(3.0, rel=2e-3)
    np.testing.assert_allclose(found.gravity_S, turn @ [0.0, 0.0, -9.81], atol=5e-3)
    assert found.gravity_free_mps2 == pytest.approx(9.81, rel=1e-3)
    frame_v = np.array([flown.v_WI[t // 50_000] for t in stamps])
    np.testing.assert_allclose(found.v_SI, frame_v @ turn.T, atol=5e-3)
    assert R_IC.shape == (3, 3)


def test_without_acceleration_there_is_no_scale():
    # Constant velocity: the spread of the scale must say that it is unknown.
    samples = [np.tile([0.005, 0, 0, 0, 0, 0, 9.81], (30, 1)) for _ in range(9)]
    motions = [preintegrate(s, np.zeros(3), np.zeros(3), QUIET.densities()) for s in samples]
    p_SC = np.outer(np.arange(10), [0.1, 0.0, 0.0])
    found = align_poses(motions, np.stack([np.eye(3)] * 10), p_SC, np.zeros(3))
    assert found is None or found.scale_sigma > 0.2


@pytest.mark.parametrize("seed", [3, 6])
def test_a_moving_vehicle_finds_speed_tilt_and_bias(seed):
    flown = simulate(Flight(still_s=0.0, duration_s=6.0, seed=seed, pace=1.8))
    frames = list(flown.recording.frames())
    found, k = None, 44
    while found is None and k < len(frames) - 2:
        k += 5
        intake = Intake(3.0, flown.recording.imu, tuple(frames[k - 44 : k + 1]), True)
        found = moving_start(
            MovingStart(),
            Standing(),
            intake,
            StartPose(),
            flown.recording.rig,
            QUIET,
            flown.recording.sigma,
        )
    state, P = found
    true_R = quat_to_R(flown.truth.q[k])
    R = quat_to_R(state.q_WI)
    assert np.linalg.norm(state.v_WI) == pytest.approx(np.linalg.norm(flown.v_WI[k]), abs=0.06)
    assert state.v_WI[2] == pytest.approx(flown.v_WI[k][2], abs=0.05)
    assert np.degrees(np.arccos(min(1.0, R[2] @ true_R[2]))) < 1.0
    np.testing.assert_allclose(state.gyro_bias, GYRO_BIAS, atol=0.01)
    np.testing.assert_allclose(state.p_WI, 0.0, atol=1e-3)
    assert np.linalg.eigvalsh(P).min() > 0.0
