# SPDX-License-Identifier: Apache-2.0
"""One interval of the horizon: derivatives, accuracy, closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skyhaul.control.nmpc.load_step import (
    LoadParams,
    angular_acceleration,
    empty_load_step,
    load_step,
    moment_by_attitude,
    right_jacobian,
    right_jacobian_inverse,
)
from skyhaul.geometry.quaternion import quat_conj, quat_exp, quat_log, quat_mul, quat_to_R
from skyhaul.model import Team, load_acceleration, load_derivative

TEAM = Team()
LOAD = LoadParams(TEAM.payload.mass_kg, TEAM.payload.J_L, True, TEAM.arrays().g)


def random_case(seed, spread=1.0):
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.normal(size=3), rng.normal(size=4), spread * rng.normal(size=6)])
    x[3:7] = quat_exp(0.4 * spread * rng.normal(size=3))
    force = 0.57 * (TEAM.formation_dirs_L() + 0.1 * rng.normal(size=(4, 3)))
    return x, force, 0.5 * spread * rng.normal(size=(4, 3))


def moments(force):
    return np.append(np.einsum("nc,nb->cb", force, TEAM.hooks_L()).ravel(), np.zeros(3))


def step(x, inputs, dt, load=LOAD):
    out = empty_load_step()
    work = (np.zeros((6, 30)), np.zeros((7, 12)), np.zeros((3, 3)), np.zeros(12))
    load_step(load, x, inputs, dt, work, out)
    return out


def inputs_of(force, rate):
    return force.sum(axis=0), rate.sum(axis=0), moments(force), moments(rate)


def plus(x, d):
    q = quat_mul(x[3:7], quat_exp(d[3:6]))
    return np.concatenate([x[:3] + d[:3], q, x[7:] + d[6:]])


def minus(a, b):
    turn = quat_log(quat_mul(quat_conj(b[3:7]), a[3:7]))
    return np.concatenate([a[:3] - b[:3], turn, a[7:] - b[7:]])


def differences(f, size, h=1e-6):
    columns = []
    for j in range(size):
        d = np.zeros(size)
        d[j] = h
        columns.append((f(d) - f(-d)) / (2.0 * h))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("dt", [0.05, 0.15])
@pytest.mark.parametrize("seed", range(3))
def test_derivatives_by_the_state_match_differences(seed, dt):
    x, force, rate = random_case(seed)
    base = step(x, inputs_of(force, rate), dt)
    end = base.x.copy()
    A = differences(lambda d: minus(step(plus(x, d), inputs_of(force, rate), dt).x, end), 12)
    np.testing.assert_allclose(base.A, A, atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_by_the_moment_inputs_match_differences(seed):
    x, force, rate = random_case(seed)
    F, dF, y, dy = inputs_of(force, rate)
    y = y + np.append(np.zeros(9), [0.01, -0.02, 0.005])
    base = step(x, (F, dF, y, dy), 0.1)
    end = base.x.copy()

    def moved(d):
        return minus(step(x, (F, dF, y + d[:12], dy + d[12:]), 0.1).x, end)

    turn = differences(moved, 24)[[3, 4, 5, 9, 10, 11]]
    np.testing.assert_allclose(base.y, turn, atol=2e-6)


@pytest.mark.parametrize("seed", range(3))
def test_step_agrees_with_the_model_integrated_finely(seed):
    x, force, rate = random_case(seed, spread=0.5)
    out = step(x, inputs_of(force, rate), 0.1)
    fine = solve_ivp(
        lambda t, s: load_derivative(TEAM, s, force + t * rate),
        (0.0, 0.1),
        x,
        rtol=1e-10,
        atol=1e-11,
    ).y[:, -1]
    error, moved = minus(out.x, fine), minus(fine, x)
    np.testing.assert_allclose(error[[0, 1, 2, 6, 7, 8]], 0.0, atol=1e-9)
    assert np.abs(error[3:6]).max() < 0.02 * np.abs(moved[3:6]).max()
    assert np.abs(error[9:12]).max() < 0.02 * np.abs(moved[9:12]).max()


def test_error_of_the_rotation_falls_with_the_square_of_the_sub_step():
    """But for the gyroscopic term, which is of first order: here there is none."""
    x, force, rate = random_case(1, spread=0.5)
    round_load = LOAD._replace(J=np.full(3, 1e-3))
    errors, fine = [], None
    for parts in (64, 8, 4):
        state = x
        for i in range(parts):
            t, h = i * 0.05 / parts, 0.05 / parts
            state = step(state, inputs_of(force + t * rate, rate), h, round_load).x.copy()
        fine = state if fine is None else fine
        errors.append(np.linalg.norm(minus(state, fine)[3:6]))
    assert errors[2] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_a_long_free_swing_keeps_its_amplitude():
    """Forces held in world axes: the load swings under its hooks for ever."""
    force = 0.57 * TEAM.formation_dirs_L()
    x = np.zeros(13)
    x[3:7] = quat_exp(np.array([0.2, 0.0, 0.0]))
    rates = []
    for _ in range(400):
        x = step(x, inputs_of(force, 0.0 * force), 0.025).x.copy()
        rates.append(abs(x[10]))
    assert max(rates[-100:]) == pytest.approx(max(rates[:100]), rel=0.01)


def test_accelerations_are_those_of_the_model():
    for seed in range(5):
        x, force, _ = random_case(seed)
        out = np.empty(3)
        angular_acceleration(LOAD, quat_to_R(x[3:7]), x[10:13], moments(force), out)
        np.testing.assert_allclose(out, load_acceleration(TEAM, x, force)[3:], atol=1e-9)


def test_moment_by_attitude_matches_differences():
    x, force, _ = random_case(7)
    hooks = TEAM.hooks_L()

    def moment(d):
        R = quat_to_R(quat_mul(x[3:7], quat_exp(d)))
        return np.cross(hooks, force @ R).sum(axis=0)

    D = np.empty((3, 3))
    moment_by_attitude(quat_to_R(x[3:7]), moments(force), D)
    np.testing.assert_allclose(D, differences(moment, 3), atol=1e-8)


def test_a_point_mass_does_not_turn():
    x, force, rate = random_case(3)
    x[3:7], x[10:] = [1.0, 0.0, 0.0, 0.0], 0.0
    out = step(x, inputs_of(force, rate), 0.1, LOAD._replace(rigid=False))
    np.testing.assert_array_equal(out.x[3:7], x[3:7])
    np.testing.assert_array_equal(out.y, 0.0)


@pytest.mark.parametrize("size", [1e-5, 0.3, 2.5])
def test_right_jacobians_are_inverse_and_match_differences(size):
    phi = size * np.array([0.6, -0.64, 0.48])
    J, inverse = np.empty((3, 3)), np.empty((3, 3))
    right_jacobian(phi, J)
    right_jacobian_inverse(phi, inverse)
    np.testing.assert_allclose(J @ inverse, np.eye(3), atol=1e-12)
    q = quat_exp(phi)
    wanted = differences(lambda d: quat_log(quat_mul(quat_conj(q), quat_exp(phi + d))), 3)
    np.testing.assert_allclose(J, wanted, atol=1e-8)
