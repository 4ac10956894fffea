# SPDX-License-Identifier: Apache-2.0
"""Tests of `model.jets`: Taylor series of products, roots and directions of functions of time."""

import numpy as np
import pytest
from numpy.polynomial import polynomial as poly

from skyhaul.geometry.so3 import so3_exp
from skyhaul.model import jets

K = 7


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def at(jet, t):
    """The series of a jet at t."""
    return np.tensordot(t ** np.arange(len(jet)), jet, axes=1)


def test_derivatives_of_the_exponential():
    jet = jets.jet_from_derivatives(np.ones(K))
    assert at(jet, 0.1) == pytest.approx(np.exp(0.1), abs=1e-10)
    np.testing.assert_allclose(jet * jets.factorials(jet), 1.0)


def test_rate_is_the_derivative_of_a_polynomial(rng):
    a = rng.normal(size=(K, 3))
    np.testing.assert_allclose(jets.jet_rate(a), poly.polyder(a))


def test_products_are_those_of_polynomials(rng):
    a, b, s = rng.normal(size=(K, 3)), rng.normal(size=(K, 3)), rng.normal(size=K)
    product = lambda x, y: poly.polymul(x, y)[:K]  # noqa: E731
    np.testing.assert_allclose(
        jets.jet_dot(a, b), sum(product(a[:, c], b[:, c]) for c in range(3)), atol=1e-13
    )
    scaled = np.column_stack([product(s, a[:, c]) for c in range(3)])
    np.testing.assert_allclose(jets.jet_scale(s, a), scaled, atol=1e-13)
    x, y, z = range(3)
    crossed = np.column_stack(
        [product(a[:, i], b[:, j]) - product(a[:, j], b[:, i]) for i, j in ((y, z), (z, x), (x, y))]
    )
    np.testing.assert_allclose(jets.jet_cross(a, b), crossed, atol=1e-13)


def test_matrix_products_are_those_of_polynomials(rng):
    M, v = rng.normal(size=(K, 3, 3)), rng.normal(size=(K, 3))
    full = np.zeros((K, 3))
    full_t = np.zeros((K, 3))
    for k in range(K):
        for j in range(k + 1):
            full[k] += M[j] @ v[k - j]
            full_t[k] += M[j].T @ v[k - j]
    np.testing.assert_allclose(jets.jet_mat_vec(M, v), full, atol=1e-13)
    np.testing.assert_allclose(jets.jet_mat_t_vec(M, v), full_t, atol=1e-13)


def test_shorter_operand_cuts_the_result(rng):
    a, b = rng.normal(size=(K, 3)), rng.normal(size=(3, 3))
    np.testing.assert_array_equal(jets.jet_cross(a, b), jets.jet_cross(a[:3], b))


def test_square_root_squared_and_reciprocal_times_itself(rng):
    a = rng.normal(size=K)
    a[0] = 2.3
    root = jets.jet_sqrt(a)
    np.testing.assert_allclose(poly.polymul(root, root)[:K], a, atol=1e-12)
    unit = poly.polymul(jets.jet_reciprocal(a), a)[:K]
    np.testing.assert_allclose(unit, np.eye(K)[0], atol=1e-12)


def test_direction_has_unit_length_and_keeps_to_the_vector(rng):
    v = rng.normal(size=(K, 3))
    d = jets.jet_unit(v)
    np.testing.assert_allclose(jets.jet_dot(d, d), np.eye(K)[0], atol=1e-10)
    np.testing.assert_allclose(jets.jet_scale(jets.jet_norm(v), d), v, atol=1e-10)


def test_direction_of_nothing_is_nan():
    assert np.isnan(jets.jet_unit(np.zeros((K, 3)))).all()


def test_heading_follows_the_angle(rng):
    angle = rng.normal(size=K)
    heading, t = jets.jet_heading(angle), 0.02
    expected = [np.cos(at(angle, t)), np.sin(at(angle, t)), 0.0]
    np.testing.assert_allclose(at(heading, t), expected, atol=1e-9)


def test_body_rate_of_a_steady_turn_is_constant():
    w, size = np.array([0.4, -1.1, 0.8]), 30
    S = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    start = so3_exp(np.array([0.3, 0.2, -0.9]))
    derivatives = np.array([start @ np.linalg.matrix_power(S, k) for k in range(size)])
    R = jets.jet_from_derivatives(derivatives)
    np.testing.assert_allclose(at(R, 0.5), start @ so3_exp(0.5 * w), atol=1e-14)
    expected = np.zeros((size - 1, 3))
    expected[0] = w
    np.testing.assert_allclose(jets.jet_body_rate(R), expected, atol=1e-14)
