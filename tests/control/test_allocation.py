# SPDX-License-Identifier: Apache-2.0
"""Tests of `control.allocation`. Each name states the property it checks."""

import numpy as np
import pytest
from scipy.optimize import minimize

from skyhaul.control.allocation import (
    AllocationLimits,
    ForceLimits,
    distribute,
    null_space,
    pseudo_inverse,
    wrench_map,
    wrench_weights,
)
from skyhaul.model import PointPayload, Team, formation_forces, hover_forces
from skyhaul.types import GRAVITY_MPS2

MILD = AllocationLimits(
    yaw_weight=3.0,
    horizontal_weight=10.0,
    tilt_weight=30.0,
    vertical_weight=100.0,
    cone_deg=40.0,
    tolerance_n=1e-6,
)
"""Weights that a general-purpose solver can handle too."""


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def limits_of(team, params=MILD, separation=0.0, active=None, thrust_max=None):
    n = team.count
    arrays = team.arrays()
    return ForceLimits(
        axis=team.formation_dirs_L().copy(),
        arm=team.hooks_L().copy(),
        offset=np.outer(arrays.m_B, [0.0, 0.0, GRAVITY_MPS2]),
        thrust_max=arrays.thrust_max if thrust_max is None else np.full(n, thrust_max),
        length=arrays.length,
        active=np.ones(n) if active is None else np.array(active, dtype=float),
        tension_min=team.tension_min_n,
        cone_tan=np.tan(np.deg2rad(params.cone_deg)),
        separation=separation,
        weight=wrench_weights(params, team.hook_ring_m),
        tolerance=params.tolerance_n,
    )


def solve(wanted, limits, max_cuts=200):
    f, slack = wanted.copy(), np.empty(6)
    outcome = distribute(f, limits, max_cuts, slack)
    return f, slack, outcome


def margins(f, lim):
    """Every limit but the separation, >= 0 where kept, (n, 3)."""
    along = np.sum(lim.axis * f, axis=1)
    side = np.linalg.norm(f - along[:, None] * lim.axis, axis=1)
    thrust = np.linalg.norm(f + lim.offset, axis=1)
    return np.stack(
        [along - lim.tension_min, lim.cone_tan * along - side, lim.thrust_max - thrust], axis=1
    )


def distances(f, lim):
    tips = lim.arm + lim.length[:, None] * f / np.linalg.norm(f, axis=1, keepdims=True)
    i, k = np.triu_indices(len(f), 1)
    return np.linalg.norm(tips[i] - tips[k], axis=1)


def cost(f, wanted, lim):
    d = (f - wanted).ravel()
    s = wrench_map(lim.arm) @ d
    return 0.5 * d @ d + 0.5 * lim.weight @ (s * s)


def wild_forces(team, rng, size=0.6):
    return hover_forces(team) + rng.normal(scale=size, size=(team.count, 3))


@pytest.mark.parametrize("n", [3, 4, 8])
def test_map_gives_force_and_moment(n, rng):
    team = Team(count=n)
    f = rng.normal(size=(n, 3))
    wrench = wrench_map(team.hooks_L()) @ f.ravel()
    np.testing.assert_allclose(wrench[:3], f.sum(axis=0))
    np.testing.assert_allclose(wrench[3:], np.cross(team.hooks_L(), f).sum(axis=0))


@pytest.mark.parametrize("active", [None, [True, False, True, True, True]])
def test_pseudo_inverse_gives_the_wrench_and_internal_forces_give_none(active, rng):
    hooks = Team(count=5).hooks_L()
    P, w = wrench_map(hooks, active), rng.normal(size=6)
    np.testing.assert_allclose(P @ pseudo_inverse(hooks, active) @ w, w, atol=1e-9)
    N = null_space(hooks, active)
    carrying = 5 if active is None else sum(active)
    assert N.shape == (15, 3 * carrying - 6)
    np.testing.assert_allclose(P @ N, 0.0, atol=1e-12)
    np.testing.assert_allclose(N.T @ N, np.eye(N.shape[1]), atol=1e-12)


def test_pseudo_inverse_is_the_nominal_allocation_without_internal_force(rng):
    team, w = Team(), rng.normal(size=6)
    bent = formation_forces(team, w) - formation_forces(team, np.zeros(6))
    np.testing.assert_allclose((pseudo_inverse(team.hooks_L()) @ w).reshape(4, 3), bent, atol=1e-12)


def test_forces_within_the_limits_are_left_alone():
    team = Team()
    f, slack, outcome = solve(hover_forces(team), limits_of(team, separation=0.45))
    assert outcome == (0, True)
    np.testing.assert_array_equal(f, hover_forces(team))
    np.testing.assert_array_equal(slack, 0.0)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("n", [3, 4, 6])
def test_result_is_the_optimum_of_a_general_solver(n, seed):
    team = Team(count=n)
    lim = limits_of(team, thrust_max=3.4)
    wanted = wild_forces(team, np.random.default_rng(seed))
    f, slack, outcome = solve(wanted, lim)
    assert outcome.kept
    assert margins(f, lim).min() >= -2e-6
    best = minimize(
        lambda y: cost(y.reshape(n, 3), wanted, lim),
        hover_forces(team).ravel(),
        constraints={"type": "ineq", "fun": lambda y: margins(y.reshape(n, 3), lim).ravel()},
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 500},
    )
    assert cost(f, wanted, lim) <= cost(best.x.reshape(n, 3), wanted, lim) + 1e-5
    np.testing.assert_allclose(f.ravel(), best.x, atol=3e-3)
    np.testing.assert_allclose(slack, wrench_map(lim.arm) @ (f - wanted).ravel(), atol=1e-12)


@pytest.mark.parametrize("n", [1, 2])
def test_one_and_two_cables_and_a_point_mass_are_solved_too(n, rng):
    team = Team(count=n, payload=PointPayload())
    lim = limits_of(team, thrust_max=4.0)
    f, _, outcome = solve(wild_forces(team, rng, 2.0), lim)
    assert outcome.kept
    assert margins(f, lim).min() >= -2e-6


@pytest.mark.parametrize("seed", range(20))
def test_every_limit_holds_whenever_it_is_said_to(seed):
    rng = np.random.default_rng(100 + seed)
    team = Team(count=int(rng.integers(3, 9)))
    lim = limits_of(team, AllocationLimits(), separation=0.45)
    f, _, outcome = solve(wild_forces(team, rng, 0.8), lim)
    assert outcome.kept
    assert margins(f, lim).min() >= -2e-4
    assert distances(f, lim).min() >= 0.45 - 1e-3


def test_small_tensions_are_mended_without_giving_up_wrench():
    team = Team()
    lim = limits_of(team, AllocationLimits())
    moment = np.array([0.0, 0.0, team.payload.mass_kg * GRAVITY_MPS2, 0.2, 0.0, 0.0])
    wanted = (pseudo_inverse(team.hooks_L()) @ moment).reshape(4, 3)  # no internal force
    assert margins(wanted, lim)[:, 0].min() < -0.02
    f, slack, outcome = solve(wanted, lim)
    assert outcome.kept
    assert margins(f, lim).min() >= -2e-4
    assert np.abs(slack[2]) < 1e-3
    assert np.abs(slack[3:5]).max() < 1e-3


def test_what_cannot_be_had_at_all_is_given_up_from_yaw_to_vertical_force():
    """Each weight in turn: of two parts of the wrench that cannot be had together, one gives."""
    team = Team()
    tight = AllocationLimits(cone_deg=8.0)
    lim, r = limits_of(team, tight), team.hook_ring_m
    weight = team.payload.mass_kg * GRAVITY_MPS2
    yaw_or_side = solve(formation_forces(team, np.array([0.5, 0, weight, 0, 0, 0.2])), lim)[1]
    assert abs(yaw_or_side[5]) / r > 5.0 * abs(yaw_or_side[0]) > 0.0
    side_or_tilt = solve(formation_forces(team, np.array([3.0, 0, weight, 0, 0.1, 0])), lim)[1]
    assert abs(side_or_tilt[0]) > 5.0 * abs(side_or_tilt[4]) / r


def test_vertical_force_is_given_up_last_and_yaw_moment_first():
    """Ask for more of everything than a weak team has: who loses how much, in newtons."""
    team = Team()
    lim = limits_of(team, AllocationLimits(), thrust_max=3.35)
    r = team.hook_ring_m
    wrench = np.array([2.5, 0.0, 2.6, 0.05, 0.0, 0.3])
    wanted = formation_forces(team, wrench)
    _, slack, outcome = solve(wanted, lim)
    lost = np.abs(slack)
    yaw, horizontal, tilt, vertical = lost[5] / r, lost[0], lost[3] / r, lost[2]
    assert outcome.kept
    assert yaw + horizontal > 0.3
    assert tilt < 0.1 * (yaw + horizontal)
    assert vertical < 0.05 * (yaw + horizontal)


def test_yaw_moment_alone_is_given_up_before_horizontal_force():
    team = Team()
    lim = limits_of(team, AllocationLimits())
    wanted = formation_forces(team, np.array([0.3, 0.0, 2.3, 0.0, 0.0, 0.6]))
    _, slack, outcome = solve(wanted, lim)
    assert outcome.kept
    assert np.abs(slack[5]) / team.hook_ring_m > 10.0 * np.abs(slack[:3]).max()


def test_idle_cables_are_left_alone(rng):
    team = Team(count=5)
    lim = limits_of(team, AllocationLimits(), active=[1, 1, 0, 1, 1])
    wanted = wild_forces(team, rng, 1.0)
    f, _, outcome = solve(wanted, lim)
    assert outcome.steps > 0
    np.testing.assert_array_equal(f[2], wanted[2])


def test_result_follows_a_change_of_frame(rng):
    team = Team()
    lim = limits_of(team, thrust_max=3.4)
    wanted = wild_forces(team, rng)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = lim._replace(
        axis=lim.axis @ turn.T.copy(), arm=lim.arm @ turn.T.copy(), offset=lim.offset @ turn.T
    )
    np.testing.assert_allclose(
        solve(wanted @ turn.T, turned)[0], solve(wanted, lim)[0] @ turn.T, atol=1e-5
    )


def test_result_changes_continuously(rng):
    team = Team()
    lim = limits_of(team, AllocationLimits(), separation=0.45)
    a, b = hover_forces(team), wild_forces(team, rng, 0.8)
    path = [solve(a + s * (b - a), lim)[0] for s in np.linspace(0.0, 1.0, 400)]
    steps = np.linalg.norm(np.diff(path, axis=0), axis=(1, 2))
    assert steps.max() < 20.0 * np.linalg.norm(b - a) / 400


def test_a_vehicle_too_weak_for_anything_is_reported():
    team = Team()
    f, _, outcome = solve(hover_forces(team), limits_of(team, thrust_max=2.0))
    assert not outcome.kept
    assert np.all(np.isfinite(f))


def test_weights_must_rise():
    with pytest.raises(ValueError, match="rise"):
        AllocationLimits(yaw_weight=1e9)
