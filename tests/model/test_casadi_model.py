# SPDX-License-Identifier: Apache-2.0
"""Tests of `model.casadi_model`: the symbolic load equals the numeric one."""

import casadi as ca
import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.model import casadi_model, load_acceleration, load_derivative


def random_load(rng):
    q = rng.normal(size=4)
    return np.concatenate([rng.normal(size=3), q / np.linalg.norm(q), rng.normal(size=6)])


def function_of(expression, team, n, **options):
    load, force_W = ca.SX.sym("load", 13), ca.SX.sym("force_W", n, 3)
    return ca.Function("f", [load, force_W], [expression(team, load, force_W, **options)])


@pytest.mark.parametrize(("n", "kind"), [(1, "point"), (3, "rigid"), (4, "point"), (8, "rigid")])
def test_symbolic_equals_numeric_at_random_states(rng, make, n, kind):
    team = make.team(rng, n, kind)
    acceleration = function_of(casadi_model.load_acceleration, team, n)
    derivative = function_of(casadi_model.load_derivative, team.arrays(), n, norm_gain=3.0)
    for _ in range(20):
        load, force_W = random_load(rng), rng.normal(size=(n, 3))
        a = load_acceleration(team, load, force_W)
        np.testing.assert_allclose(acceleration(load, force_W).full().ravel(), a, atol=1e-10)
        dx = load_derivative(team, load, force_W)
        np.testing.assert_allclose(derivative(load, force_W).full().ravel(), dx, atol=1e-10)


def test_symbolic_rotation_matrix_equals_the_numeric_one(rng):
    q = random_load(rng)[3:7]
    np.testing.assert_allclose(casadi_model.quat_to_R(ca.DM(q)).full(), quat_to_R(q), atol=1e-15)


def test_norm_gain_pulls_a_long_quaternion_back(rng, make):
    team, load = make.team(rng, 3, "rigid"), random_load(rng)
    load[3:7] *= 1.01
    q = load[3:7]
    free = function_of(casadi_model.load_derivative, team, 3)(load, np.zeros((3, 3)))
    held = function_of(casadi_model.load_derivative, team, 3, norm_gain=5.0)(load, np.zeros((3, 3)))
    assert q @ free.full().ravel()[3:7] == pytest.approx(0.0, abs=1e-14)
    assert q @ held.full().ravel()[3:7] == pytest.approx(5.0 * (1 - q @ q) * (q @ q), rel=1e-12)
