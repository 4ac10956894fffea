# SPDX-License-Identifier: Apache-2.0
"""Tests of `geometry.so3`, `geometry.quaternion` and their numba twins."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skyhaul.errors import GeometryError
from skyhaul.geometry import kernels, quaternion, so3


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def random_quats(rng, n):
    return quaternion.quat_normalize(rng.normal(size=(n, 4)))


def scipy_rotation(q):
    return Rotation.from_quat(q, scalar_first=True)


def near_half_turns(rng, n):
    axis = rng.normal(size=(n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return (np.pi - 10.0 ** rng.uniform(-12, -1, size=(n, 1))) * axis


def kernel_matrix(function, v):
    out = np.empty((3, 3))
    function(v, out)
    return out


def test_quaternion_product_composes_rotations(rng):
    a, b = random_quats(rng, 20), random_quats(rng, 20)
    R = quaternion.quat_to_R(quaternion.quat_mul(a, b))
    np.testing.assert_allclose(R, quaternion.quat_to_R(a) @ quaternion.quat_to_R(b), atol=1e-14)


def test_matrix_and_rotated_vector_agree_with_scipy(rng):
    q, v = random_quats(rng, 50), rng.normal(size=(50, 3))
    np.testing.assert_allclose(quaternion.quat_to_R(q), scipy_rotation(q).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(quaternion.quat_rotate(q, v), scipy_rotation(q).apply(v), atol=1e-14)


def test_matrix_to_quaternion_round_trip_also_at_half_turns(rng):
    q = np.vstack(
        [random_quats(rng, 200), np.eye(4), quaternion.quat_exp(near_half_turns(rng, 50))]
    )
    back = quaternion.R_to_quat(quaternion.quat_to_R(q))
    same = np.sign(np.sum(q * back, axis=1, keepdims=True)) * q
    np.testing.assert_allclose(back, same, atol=1e-14)
    assert np.all(back[:, 0] >= 0.0)


def test_half_turn_per_second_for_one_second_is_a_half_turn():
    q = quaternion.quat_exp(np.array([0.0, 0.0, np.pi]))
    np.testing.assert_allclose(q, [0.0, 0.0, 0.0, 1.0], atol=1e-15)


@pytest.mark.parametrize("scale", [0.0, 1e-12, 1e-8, 1e-5, 1e-4, 1e-2, 1.0, 3.0])
def test_log_inverts_exp_at_every_scale(rng, scale):
    phi = rng.normal(size=(20, 3))
    phi *= scale / np.linalg.norm(phi, axis=1, keepdims=True)
    np.testing.assert_allclose(quaternion.quat_log(quaternion.quat_exp(phi)), phi, atol=2e-15)
    np.testing.assert_allclose(so3.so3_log(so3.so3_exp(phi)), phi, atol=2e-14)
    for p in phi:
        np.testing.assert_allclose(kernels.quat_log(kernels.quat_exp(p)), p, atol=2e-15)
        R = kernel_matrix(kernels.so3_exp, p)
        np.testing.assert_allclose(kernels.so3_log(R), p, atol=2e-14)


def test_log_inverts_exp_next_to_half_turns(rng):
    phi = near_half_turns(rng, 50)
    np.testing.assert_allclose(so3.so3_log(so3.so3_exp(phi)), phi, atol=1e-13)


def test_log_is_the_same_for_both_signs_of_a_quaternion(rng):
    q = random_quats(rng, 30)
    np.testing.assert_allclose(quaternion.quat_log(-q), quaternion.quat_log(q), atol=1e-15)
    for row in q:
        np.testing.assert_allclose(kernels.quat_log(-row), kernels.quat_log(row), atol=1e-15)
    assert np.all(np.linalg.norm(quaternion.quat_log(q), axis=1) <= np.pi)


def test_exp_of_a_skew_matrix_is_its_power_series(rng):
    S = so3.hat(0.3 * rng.normal(size=3))
    series, term = np.eye(3), np.eye(3)
    for k in range(1, 20):
        term = term @ S / k
        series = series + term
    np.testing.assert_allclose(so3.so3_exp(so3.vee(S)), series, atol=1e-15)


def test_hat_is_the_cross_product_and_vee_its_inverse(rng):
    a, b = rng.normal(size=(2, 10, 3))
    np.testing.assert_allclose(np.squeeze(so3.hat(a) @ b[..., None], -1), np.cross(a, b))
    np.testing.assert_array_equal(so3.vee(so3.hat(a)), a)


def test_kernels_equal_the_array_functions(rng):
    for a, b, v in zip(
        random_quats(rng, 20), random_quats(rng, 20), rng.normal(size=(20, 3)), strict=True
    ):
        R, S = quaternion.quat_to_R(a), quaternion.quat_to_R(b)
        np.testing.assert_allclose(kernels.quat_mul(a, b), quaternion.quat_mul(a, b), atol=1e-15)
        np.testing.assert_array_equal(kernels.quat_conj(a), quaternion.quat_conj(a))
        np.testing.assert_allclose(kernel_matrix(kernels.quat_to_R, a), R, atol=1e-15)
        np.testing.assert_allclose(kernels.R_to_quat(R), quaternion.R_to_quat(R), atol=1e-15)
        np.testing.assert_allclose(kernels.quat_exp(v), quaternion.quat_exp(v), atol=1e-15)
        np.testing.assert_allclose(kernels.quat_rotate(a, v), R @ v, atol=1e-14)
        np.testing.assert_allclose(kernels.quat_inv_rotate(a, v), R.T @ v, atol=1e-14)
        np.testing.assert_array_equal(kernel_matrix(kernels.hat, v), so3.hat(v))
        assert kernels.vee(so3.hat(v)) == tuple(v)
        np.testing.assert_allclose(kernels.mat_vec(R, v), R @ v, atol=1e-15)
        np.testing.assert_allclose(kernels.mat_t_vec(R, v), R.T @ v, atol=1e-15)
        product, product_t = np.empty((3, 3)), np.empty((3, 3))
        kernels.mat_mul(R, S, product)
        kernels.mat_t_mul(R, S, product_t)
        np.testing.assert_allclose(product, R @ S, atol=1e-15)
        np.testing.assert_allclose(product_t, R.T @ S, atol=1e-15)
        np.testing.assert_allclose(kernels.cross(v, R[0]), np.cross(v, R[0]), atol=1e-15)
        assert kernels.dot(v, R[1]) == pytest.approx(v @ R[1])
        assert kernels.norm(v) == pytest.approx(np.linalg.norm(v))


def test_matrix_to_quaternion_kernel_covers_every_branch():
    for turn in np.vstack([np.eye(3), -np.eye(3), np.zeros((1, 3))]) * 3.1:
        R = so3.so3_exp(turn)
        np.testing.assert_allclose(kernels.so3_log(R), turn, atol=1e-14)


def test_quaternion_derivative_is_the_limit_of_small_turns(rng):
    q, w, h = random_quats(rng, 1)[0], rng.normal(size=3), 1e-6
    ahead = quaternion.quat_mul(q, quaternion.quat_exp(h * w))
    behind = quaternion.quat_mul(q, quaternion.quat_exp(-h * w))
    np.testing.assert_allclose(kernels.quat_derivative(q, w), (ahead - behind) / (2 * h), atol=1e-9)


def test_euler_angles_round_trip(rng):
    angles = rng.uniform([-3, -1.5, -3], [3, 1.5, 3], size=(50, 3))
    np.testing.assert_allclose(so3.euler_zyx(so3.euler_to_R(angles)), angles, atol=1e-12)
    matrix = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    np.testing.assert_allclose(so3.euler_to_R(angles), matrix, atol=1e-14)


def test_rotation_about_z_is_pure_yaw():
    np.testing.assert_allclose(
        so3.rotation_z(0.7), so3.euler_to_R(np.array([0, 0, 0.7])), atol=1e-15
    )


@pytest.mark.parametrize(
    ("R", "message"),
    [(2.0 * np.eye(3), "differs from the identity"), (-np.eye(3), "mirrors")],
)
def test_what_is_no_rotation_is_refused(R, message):
    with pytest.raises(GeometryError, match=f"R_WL.*{message}"):
        so3.check_rotation(R, "R_WL")
