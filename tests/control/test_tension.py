# SPDX-License-Identifier: Apache-2.0
"""Tests of `control.tension`. Each name states the property it checks."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from skyhaul.control.allocation import wrench_map
from skyhaul.control.tension import make_up_for_direction
from skyhaul.model import Team, hover_forces

NONE = (0.0, 0.0, 0.0)
REACH = (0.1, 1.7, 0.1414)
WEIGHT = np.array([0.02, 0.02, 1.0, 1.0, 1.0, 0.02])


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def solve(force, xi, arm, free=None, moment=NONE, reach=REACH):
    out = np.empty(len(force))
    free = np.ones(len(force)) if free is None else np.array(free, dtype=float)
    make_up_for_direction((force, moment), xi, arm, free, reach, out)
    return out


def scaled_wrench(arm, force):
    w = wrench_map(arm) @ np.ravel(force)
    w[3:] /= REACH[2]
    return w


def leaning(seed, size=0.3):
    rng = np.random.default_rng(seed)
    team = Team()
    force = hover_forces(team)
    xi = unit(-unit(force) + size * rng.normal(size=(4, 3)))
    return force, xi, team.hooks_L().copy()


def test_cables_on_their_goal_need_nothing():
    force = hover_forces(Team())
    np.testing.assert_allclose(solve(force, -unit(force), Team().hooks_L().copy()), 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_result_is_the_bounded_least_squares_optimum(seed):
    force, xi, arm = leaning(seed)
    moment = (0.02, -0.01, 0.0)
    tension = -np.sum(force * xi, axis=1)
    lost = scaled_wrench(arm, force + tension[:, None] * xi)
    lost[3:] += np.array(moment) / REACH[2]
    A = np.column_stack([scaled_wrench(arm, -np.eye(4)[i][:, None] * xi) for i in range(4)])
    rows = np.vstack([np.sqrt(WEIGHT)[:, None] * A, np.sqrt(0.02) * np.eye(4)])
    target = np.concatenate([np.sqrt(WEIGHT) * lost, np.zeros(4)])
    low, high = np.minimum(0.0, 0.1 - tension), np.maximum(0.0, 1.7 - tension)
    best = lsq_linear(rows, target, (low - 1e-12, high + 1e-12)).x
    got = solve(force, xi, arm, moment=moment)
    assert np.all(tension + got >= np.minimum(tension, 0.1) - 1e-9)
    residual = [np.linalg.norm(rows @ d - target) for d in (got, best)]
    assert residual[0] <= 1.01 * residual[1] + 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_tensions_hold_the_load_upright_while_a_cable_leans_wrongly(seed):
    force, xi, arm = leaning(seed, 0.15)
    tension = -np.sum(force * xi, axis=1)
    off = scaled_wrench(arm, force + tension[:, None] * xi)[2:5]
    mended = scaled_wrench(arm, force + (tension + solve(force, xi, arm))[:, None] * xi)[2:5]
    assert np.linalg.norm(mended) < 0.15 * np.linalg.norm(off)


def test_the_others_take_over_from_a_slack_cable():
    force = hover_forces(Team())
    free = [0.0, 1.0, 1.0, 1.0]
    got = solve(force, -unit(force), Team().hooks_L().copy(), free)
    assert got[0] == 0.0
    assert got[1] > 0.1
    assert got[3] > 0.1
    assert got[2] < 0.0


def test_moment_is_turned_into_differences_of_tension():
    team = Team()
    force, arm = hover_forces(team), team.hooks_L().copy()
    moment = (0.03, 0.0, 0.0)
    d = solve(force, -unit(force), arm, moment=moment)
    given = wrench_map(arm) @ (d[:, None] * unit(force)).ravel()
    assert given[3] == pytest.approx(0.03, rel=0.05)
    assert abs(given[2]) < 0.01


def test_a_point_mass_has_no_moment():
    force, xi, arm = leaning(0)
    point = solve(force, xi, 0.0 * arm, reach=(0.1, 1.7, 0.0))
    tension = -np.sum(force * xi, axis=1)
    lift = force + (tension + point)[:, None] * xi
    assert abs(lift.sum(axis=0)[2]) < 0.1 * abs((force + tension[:, None] * xi).sum(axis=0)[2])
