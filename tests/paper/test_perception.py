# SPDX-License-Identifier: Apache-2.0
"""The paper's equations (7) to (18), as PAPER_NOTES 40 to 48 settle them."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from simulated_tracks import rig_of

from skyhaul.geometry.quaternion import quat_exp, quat_rotate
from skyhaul.geometry.so3 import hat, so3_exp
from skyhaul.perception.slam.pose_graph import Relation, optimize_poses
from skyhaul.perception.vio.api import NE, NavState
from skyhaul.perception.vio.clones import clone, correct, start_filter
from skyhaul.perception.vio.constraints import sight_derivatives
from skyhaul.perception.vio.imu import ImuNoise, advance
from skyhaul.perception.vio.pose_update import Sights, TukeyPose, bearings, update_pose
from skyhaul.perception.vio.structure import relative_pose
from skyhaul.perception.vio.triangulation import locate

LEVEL = NavState(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), *np.zeros((3, 3)))


def still(seconds):
    """IMU segments of a body that stands."""
    return np.tile([0.005, 0, 0, 0, 0, 0, 9.81], (round(200 * seconds), 1))


def test_a_body_at_rest_stays_where_it_is_because_gravity_is_in_the_equations():
    # Eqs. (7), (8), PAPER_NOTES 40: without g it would be 4.9 m up after a second.
    end, _, _ = advance(LEVEL, still(1.0), ImuNoise().densities())
    np.testing.assert_allclose(end.p_WI, 0.0, atol=1e-12)
    np.testing.assert_allclose(end.v_WI, 0.0, atol=1e-12)


def test_noise_is_in_the_covariance_and_never_in_the_mean():
    # Eqs. (7), (8), PAPER_NOTES 40.
    quiet = advance(LEVEL, still(1.0), np.zeros(4))
    loud = advance(LEVEL, still(1.0), 10.0 * ImuNoise().densities())
    np.testing.assert_array_equal(quiet[0].p_WI, loud[0].p_WI)
    np.testing.assert_array_equal(quiet[2], 0.0)
    assert np.linalg.eigvalsh(loud[2]).min() > 0.0


def test_pi_rad_per_second_for_a_second_is_half_a_turn():
    # Eq. (9), PAPER_NOTES 41: half the angle inside Exp.
    samples = np.tile([0.005, 0, 0, np.pi, 0, 0, 9.81], (200, 1))
    end, _, _ = advance(LEVEL, samples, ImuNoise().densities())
    np.testing.assert_allclose(np.abs(end.q_WI), [0.0, 0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(quat_rotate(end.q_WI, np.array([1.0, 0, 0])), [-1, 0, 0], atol=1e-12)


def test_an_image_is_divided_by_depth_and_none_is_behind_the_camera():
    # Eq. (10), PAPER_NOTES 42.
    R, p = np.stack([np.eye(3)] * 2), np.array([[0.0, 0, 0], [1.0, 0, 0]])
    np.testing.assert_allclose(locate(R, p, np.array([[0.1, 0], [-0.1, 0]])).p_WP, [0.5, 0, 5.0])
    assert not locate(R, p, np.array([[-0.1, 0], [0.1, 0]])).depth_m > 0.0


def test_the_pose_is_that_of_the_body_in_the_world():
    # Eqs. (11), (12), PAPER_NOTES 43, 44: T_WI, T_CW <- Exp(x) T_CW; exact sights give it exactly.
    rig, R_WI = rig_of(4), so3_exp(np.array([0.2, -0.1, 0.4]))
    rng = np.random.default_rng(0)
    camera = np.arange(40) % 4
    in_C = np.column_stack([rng.uniform(-2, 2, (40, 2)), rng.uniform(3, 6, 40)])
    in_I = np.einsum("nij,nj->ni", rig.R_IC[camera], in_C) + rig.p_IC[camera]
    points = in_I @ R_WI.T + [1.0, 2.0, 3.0]
    sights = Sights(points, bearings(in_C[:, :2] / in_C[:, 2:]), camera, np.full(40, 1e-3))
    fix = update_pose(TukeyPose(), rig, (np.array([1.1, 2.1, 2.9]), np.eye(3)), sights)
    np.testing.assert_allclose(fix.p_WI, [1.0, 2.0, 3.0], atol=1e-9)
    np.testing.assert_allclose(fix.R_WI, R_WI, atol=1e-9)


def test_the_essential_matrix_is_t_cross_r():
    # Eq. (14), PAPER_NOTES 45: for x2 = R x1 + t, x2^T [t]x R x1 = 0; R [t]x does not vanish.
    rng = np.random.default_rng(1)
    R, t = so3_exp(np.array([0.1, -0.2, 0.15])), np.array([0.6, -0.3, 0.2])
    x1 = np.column_stack([rng.uniform(-2, 2, (40, 2)), rng.uniform(3, 6, 40)])
    x2 = x1 @ R.T + t
    a, b = x1 / x1[:, 2:], x2 / x2[:, 2:]
    residual = np.einsum("ni,ij,nj->n", b, hat(t) @ R, a)
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)
    assert np.abs(np.einsum("ni,ij,nj->n", b, R @ hat(t), a)).max() > 0.01
    seen = [dict(enumerate(v[:, :2])) for v in (a, b)]
    R_ab, p_ab, _ = relative_pose(*seen, 1e-4, 8)
    np.testing.assert_allclose(R_ab, R.T, atol=1e-6)
    np.testing.assert_allclose(p_ab, -R.T @ t / np.linalg.norm(t), atol=1e-6)


def test_a_relation_of_poses_has_no_error_where_both_are_right_wherever_the_world_is():
    rng = np.random.default_rng(46)
    R = np.array([so3_exp(v) for v in rng.uniform(-1.0, 1.0, (3, 3))])
    p = rng.uniform(-2.0, 2.0, (3, 3))
    G, g = so3_exp(np.array([0.3, -0.4, 0.9])), np.array([3.0, 1.0, -2.0])
    relations = [
        Relation(i, j, R[i].T @ R[j], R[i].T @ (p[j] - p[i]), 1e-4 * np.eye(6))
        for i, j in ((0, 1), (1, 2))
    ]
    for R_W, p_W in ((R, p), (G @ R, p @ G.T + g)):
        off = p_W + np.array([[0.0] * 3, [0.1, 0.0, -0.1], [0.0, 0.2, 0.1]])
        back_R, back_p = optimize_poses((R_W, off), relations, ())
        np.testing.assert_allclose(back_R, R_W, atol=1e-6)
        np.testing.assert_allclose(back_p, p_W, atol=1e-6)


def test_the_filter_corrects_in_the_tangent_space_and_keeps_its_covariance_symmetric():
    # Eqs. (16)-(18), PAPER_NOTES 47.
    f = clone(start_filter(LEVEL, 1e-2 * np.eye(NE)), 1)
    H = np.zeros((3, len(f.covariance)))
    H[:, 3:6] = np.eye(3)
    turn = np.array([0.3, -0.2, 0.4])
    after = correct(f, turn, H, 1e-9)
    np.testing.assert_allclose(after.state.q_WI, quat_exp(turn), atol=1e-9)
    assert (
        np.linalg.norm(after.state.q_WI) == 1.0 or abs(np.linalg.norm(after.state.q_WI) - 1) < 1e-15
    )
    np.testing.assert_array_equal(after.covariance, after.covariance.T)


def test_a_sight_depends_on_the_pose_as_the_linearisation_says():
    # Eq. (17), PAPER_NOTES 47: h about the state, no homogeneous shortcut.
    rig = rig_of(1)
    point, R, p = np.array([4.0, 0.5, -0.3]), np.eye(3)[None], np.zeros((1, 3))
    by_pose, by_point = sight_derivatives(R, p, rig.R_IC, rig.p_IC, point)
    np.testing.assert_allclose(by_pose[:, :, :3], -by_point)
