# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.geometry.so3 import so3_exp, so3_log
from skyhaul.perception.vio.api import BA, BG, NE, P, R, V
from skyhaul.perception.vio.propagation import propagate, right_jacobian

NOISE = np.array([2e-3, 3e-2, 4e-4, 5e-3])
GRAVITY = np.array([0.0, 0.0, -9.81])


def run(x, R_WI, samples, gravity=GRAVITY):
    x, R_WI = x.copy(), R_WI.copy()
    Phi, Q = np.empty((NE, NE)), np.empty((NE, NE))
    propagate(x, R_WI, gravity, samples, NOISE, Phi, Q)
    return x, R_WI, Phi, Q


def shifted(x, R_WI, e):
    """State plus an error of the layout (p, R, v, b_g, b_a)."""
    moved = x + np.concatenate([e[P], e[V], e[BG], e[BA]])
    return moved, R_WI @ so3_exp(e[R])


def difference(a, b):
    """Error that leads from b to a."""
    d = a[0] - b[0]
    return np.concatenate([d[:3], so3_log(b[1].T @ a[1]), d[3:6], d[6:9], d[9:12]])


@pytest.fixture
def case():
    rng = np.random.default_rng(3)
    samples = np.hstack([rng.uniform(0.003, 0.02, (30, 1)), rng.normal(size=(30, 6))])
    samples[:, 4:] += [1.0, -2.0, 9.0]
    return 0.3 * rng.normal(size=12), so3_exp(rng.normal(size=3)), samples


@pytest.mark.parametrize("scale", [0.0, 1e-5, 1e-3, 0.5, 3.0])
def test_right_jacobian_is_the_derivative_of_exp(scale):
    phi = scale * np.array([0.6, -0.64, 0.48])
    J, h = np.empty((3, 3)), 1e-6
    right_jacobian(phi, J)
    columns = [so3_log(so3_exp(phi - d).T @ so3_exp(phi + d)) / (2.0 * h) for d in h * np.eye(3)]
    np.testing.assert_allclose(J, np.array(columns).T, atol=1e-8)


def test_transition_is_the_derivative_of_the_motion(case):
    x, R_WI, samples = case
    _, _, Phi, _ = run(x, R_WI, samples)
    h, columns = 1e-5, []
    for e in h * np.eye(NE):
        ahead = run(*shifted(x, R_WI, e), samples)
        behind = run(*shifted(x, R_WI, -e), samples)
        columns.append(difference(ahead, behind) / (2.0 * h))
    np.testing.assert_allclose(Phi, np.array(columns).T, atol=1e-7)


def test_noise_is_that_of_many_noisy_runs(case):
    x, R_WI, samples = case
    rng = np.random.default_rng(4)
    *clean, _, Q = run(x, R_WI, samples)
    errors = []
    for _ in range(1500):
        noisy = samples.copy()
        root = np.sqrt(samples[:, :1])
        noisy[:, 1:4] += NOISE[0] / root * rng.normal(size=(30, 3))
        noisy[:, 4:7] += NOISE[1] / root * rng.normal(size=(30, 3))
        errors.append(difference(run(x, R_WI, noisy), clean)[:9])
    # Biases walk besides; over so short a time they add nothing to p, R and v that shows here.
    sampled, sigma = np.cov(np.array(errors).T), np.sqrt(np.diag(Q)[:9])
    np.testing.assert_allclose(
        sampled / np.outer(sigma, sigma), Q[:9, :9] / np.outer(sigma, sigma), atol=0.12
    )


def test_white_noise_adds_up_as_the_closed_forms_say():
    n, dt = 400, 0.005
    samples = np.hstack([np.full((n, 1), dt), np.zeros((n, 3)), np.tile([0, 0, 9.81], (n, 1))])
    _, _, _, Q = run(np.zeros(12), np.eye(3), samples)
    T = n * dt
    turn = NOISE[0] ** 2 * T + NOISE[2] ** 2 * T**3 / 3.0
    np.testing.assert_allclose(np.diag(Q)[R], turn, rtol=1e-2)
    # The vertical feels no turn: its speed and place have the accelerometer's noise alone.
    walk = NOISE[3] ** 2
    assert Q[8, 8] == pytest.approx(NOISE[1] ** 2 * T + walk * T**3 / 3.0, rel=1e-2)
    assert Q[2, 2] == pytest.approx(NOISE[1] ** 2 * T**3 / 3.0 + walk * T**5 / 20.0, rel=1e-2)
    np.testing.assert_allclose(np.diag(Q)[BG], NOISE[2] ** 2 * T)
    np.testing.assert_allclose(np.diag(Q)[BA], NOISE[3] ** 2 * T)


def test_a_body_that_feels_nothing_falls():
    samples = np.hstack([np.full((100, 1), 0.01), np.zeros((100, 6))])
    x, R_WI, _, _ = run(np.zeros(12), np.eye(3), samples)
    np.testing.assert_allclose(x[:6], [0.0, 0.0, -0.5 * 9.81, 0.0, 0.0, -9.81], atol=1e-12)
    np.testing.assert_array_equal(R_WI, np.eye(3))


def test_biases_are_taken_off():
    bias = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6])
    samples = np.hstack([np.full((100, 1), 0.01), np.tile(bias + np.eye(6)[5] * 9.81, (100, 1))])
    x, R_WI, _, _ = run(np.concatenate([np.zeros(6), bias]), np.eye(3), samples)
    np.testing.assert_allclose(x[:6], 0.0, atol=1e-12)
    np.testing.assert_allclose(R_WI, np.eye(3), atol=1e-14)


def test_the_error_falls_with_the_square_of_the_step():
    def error(n):
        # Turns about z at 2 rad/s, pushed along its own x: a circle, known in closed form.
        samples = np.tile([1.0 / n, 0, 0, 2.0, 3.0, 0, 0], (n, 1))
        x, _, _, _ = run(np.zeros(12), np.eye(3), samples, np.zeros(3))
        return np.linalg.norm(x[3:5] - 1.5 * np.array([np.sin(2.0), 1.0 - np.cos(2.0)]))

    assert error(100) < 1e-3
    assert error(50) / error(100) == pytest.approx(4.0, rel=0.02)
