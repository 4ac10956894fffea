# SPDX-License-Identifier: Apache-2.0
"""Tests of `control.cable`. Each name states the property it checks."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skyhaul.control.api import ForcePlan
from skyhaul.control.cable import (
    CableGains,
    cable_goal,
    cable_thrust_vector,
    model_motion,
    tension_wanted,
)
from skyhaul.control.geometric import Geometric, feedback_gains
from skyhaul.geometry.quaternion import R_to_quat
from skyhaul.model import Team, Vehicle, accelerations, hover_forces, load_acceleration
from skyhaul.model.state import TautState

GAINS = (36.0, 10.0, 1e3)
M, L = 0.25, 1.2
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def rng():
    return np.random.default_rng(2)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def curve(rng):
    """A force that never vanishes, and its derivatives."""
    poly = rng.normal(size=(4, 3)) + np.outer([1, 0, 0, 0], [0, 0, 3])
    return lambda t: np.array([1.0, t, t * t, t**3]) @ poly


def test_goal_is_the_direction_of_the_pull_with_its_motion(rng):
    f, t, h = curve(rng), 0.3, 1e-4
    d1 = (f(t + h) - f(t - h)) / (2.0 * h)
    d2 = (f(t + h) - 2.0 * f(t) + f(t - h)) / h**2
    goal = cable_goal(tuple(f(t)), tuple(d1), tuple(d2))
    before, now, after = (-unit(f(s)) for s in (t - h, t, t + h))
    np.testing.assert_allclose(goal.dir_W, now, atol=1e-12)
    np.testing.assert_allclose(goal.w_W, np.cross(now, (after - before) / (2 * h)), atol=1e-6)
    ddir = (after - 2.0 * now + before) / h**2
    np.testing.assert_allclose(goal.dw_W, np.cross(now, ddir), atol=1e-4)


def one_cable(rng):
    xi = unit(rng.normal(size=3) - 3.0 * UP)
    w = np.cross(xi, rng.normal(size=3))
    a = rng.normal(size=3) + 9.81 * UP
    return xi, w, a


def cable_acceleration(u, xi, a):
    """Angular acceleration of a taut cable under thrust u, its hook accelerated by a - g e_3."""
    return np.cross(xi, a) / L - np.cross(xi, u) / (M * L)


@pytest.mark.parametrize("seed", range(5))
def test_on_the_goal_the_cable_moves_as_the_goal_does(seed):
    rng = np.random.default_rng(seed)
    f, t, h = curve(rng), 0.1, 1e-4
    rates = (f(t + h) - f(t - h)) / (2.0 * h), (f(t + h) - 2.0 * f(t) + f(t - h)) / h**2
    goal = cable_goal(tuple(f(t)), *(tuple(r) for r in rates))
    xi, w, a = np.array(goal.dir_W), goal.w_W, rng.normal(size=3) + 9.81 * UP
    u = cable_thrust_vector(tuple(f(t)), goal, (tuple(xi), w), tuple(a), (M, L), GAINS)
    np.testing.assert_allclose(cable_acceleration(u, xi, a), goal.dw_W, atol=1e-9)


def test_the_cable_takes_the_tension_of_the_wanted_force(rng):
    """m (p'' + g e_3) = u + T xi along xi gives back T = -f . xi."""
    xi, w, a = one_cable(rng)
    f = -2.0 * xi + 0.3 * rng.normal(size=3)
    goal = cable_goal(tuple(f), (0.1, 0.2, 0.3), (0.0, 0.0, 0.0))
    u = np.array(
        cable_thrust_vector(tuple(f), goal, (tuple(xi), tuple(w)), tuple(a), (M, L), GAINS)
    )
    along = M * (xi @ a + L * w @ w)  # m xi . (hook - l xi'' + g e_3)
    assert along - u @ xi == pytest.approx(tension_wanted(tuple(f), tuple(xi)))
    assert tension_wanted(tuple(f), tuple(-xi)) == 0.0


def test_a_small_direction_error_decays_as_the_gains_say(rng):
    xi, _, a = one_cable(rng)
    f = -1.5 * xi
    goal = cable_goal(tuple(f), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    off = unit(xi + 1e-5 * np.cross(xi, [1.0, 0.0, 0.0]))
    w = np.cross(off, 1e-5 * rng.normal(size=3))
    u = cable_thrust_vector(tuple(f), goal, (tuple(off), tuple(w)), tuple(a), (M, L), GAINS)
    expected = -GAINS[0] * np.cross(xi, off) - GAINS[1] * w
    np.testing.assert_allclose(cable_acceleration(u, off, a), expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_rate_error_obeys_the_gains_along_a_moving_goal(seed):
    """Normal to the cable, d/dt e_w = -K_xi e_xi - K_w e_w; the goal may be far off."""
    rng = np.random.default_rng(seed)
    f, t, h = curve(rng), 0.2, 1e-5

    def goal_at(s):
        d1 = (f(s + 1e-4) - f(s - 1e-4)) / 2e-4
        d2 = (f(s + 1e-4) - 2.0 * f(s) + f(s - 1e-4)) / 1e-8
        return cable_goal(tuple(f(s)), tuple(d1), tuple(d2))

    def rate_error(s, xi, w):
        return w + np.cross(xi, np.cross(xi, goal_at(s).w_W))

    goal, a = goal_at(t), rng.normal(size=3) + 9.81 * UP
    xi = unit(np.array(goal.dir_W) + 0.4 * rng.normal(size=3))
    w = np.cross(xi, rng.normal(size=3))
    u = cable_thrust_vector(tuple(f(t)), goal, (tuple(xi), tuple(w)), tuple(a), (M, L), GAINS)
    dw, dxi = cable_acceleration(u, xi, a), np.cross(w, xi)
    rate = rate_error(t + h, xi + h * dxi, w + h * dw) - rate_error(t - h, xi - h * dxi, w - h * dw)
    rate = rate / (2.0 * h)
    e_xi, e_w = np.cross(goal.dir_W, xi), rate_error(t, xi, w)
    across = np.eye(3) - np.outer(xi, xi)
    np.testing.assert_allclose(across @ rate, -across @ (36.0 * e_xi + 10.0 * e_w), atol=1e-3)


def test_a_large_direction_error_is_closed_at_the_given_rate(rng):
    xi, _, a = one_cable(rng)
    goal = cable_goal(tuple(-xi), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    off = unit(xi + 0.5 * unit(np.cross(xi, [1.0, 0.0, 0.0])))
    turn = unit(np.cross(off, xi))
    gains = (36.0, 10.0, 0.4)
    u = cable_thrust_vector(
        tuple(-xi), goal, (tuple(off), tuple(0.4 * turn)), tuple(a), (M, L), gains
    )
    np.testing.assert_allclose(cable_acceleration(u, off, a), 0.0, atol=1e-9)


def test_model_motion_is_the_loads_dynamics(rng):
    team, load, force = Team(), rng.normal(size=13), rng.normal(size=(4, 3))
    load[3:7] = unit(load[3:7])
    arrays, out = team.arrays(), np.empty(6)
    R = Rotation.from_quat(load[3:7], scalar_first=True).as_matrix()
    moment = np.cross(arrays.p_LA, force @ R).sum(axis=0)
    total = (tuple(force.sum(axis=0)), tuple(moment))
    model_motion(load, total, (arrays.m_L, tuple(arrays.J_L)), arrays.g, out)
    np.testing.assert_allclose(out, load_acceleration(team, load, force), rtol=1e-9)


def test_the_law_fits_the_dynamics_of_the_whole_team(rng):
    """Thrust vectors of all vehicles, tensions by `model.accelerations`: cables do as asked."""
    team = Team()
    arrays, n = team.arrays(), team.count
    xi = -unit(hover_forces(team)) + 0.05 * rng.normal(size=(n, 3))
    xi, w_L = unit(xi), 0.5 * rng.normal(size=3)
    w = np.cross(xi, rng.normal(size=(n, 3)))
    force = hover_forces(team) + 0.05 * rng.normal(size=(n, 3))
    pulled = np.sum(force * xi, axis=1, keepdims=True) * xi
    load = np.concatenate([np.zeros(3), [1.0, 0.0, 0.0, 0.0], np.zeros(3), w_L])
    motion = load_acceleration(team, load, pulled)
    u = np.empty((n, 3))
    for i in range(n):
        r = arrays.p_LA[i]
        hook = motion[:3] + np.cross(motion[3:], r) + np.cross(w_L, np.cross(w_L, r))
        hook = hook + arrays.g * UP
        goal = cable_goal(tuple(force[i]), (0.3, 0.1, 0.0), (0.0, 0.2, 0.0))
        cable = (tuple(xi[i]), tuple(w[i]))
        u[i] = cable_thrust_vector(tuple(force[i]), goal, cable, tuple(hook), (M, 1.0), GAINS)
    b3 = unit(u)
    b2 = unit(np.cross(b3, [1.0, 0.0, 0.0]))
    R_WB = np.stack([np.cross(b2, b3), b2, b3], axis=-1)
    zero = np.zeros(3)
    state = TautState(
        zero, load[3:7].copy(), zero.copy(), w_L, xi, w, R_to_quat(R_WB), np.zeros((n, 3))
    )
    wrench = np.column_stack([np.linalg.norm(u, axis=1), np.zeros((n, 3))])
    got = accelerations(team, state, wrench)
    np.testing.assert_allclose(got.tension, -np.sum(force * xi, axis=1), atol=1e-9)
    np.testing.assert_allclose(got.a_WL, motion[:3], atol=1e-9)
    np.testing.assert_allclose(got.dw_WL_L, motion[3:], atol=1e-8)


def swing_plan(team, amplitude_deg=20.0, period_s=2.5, seconds=7.5):
    """Neighbouring cables swing sideways against each other; the load feels nothing."""
    t = np.arange(0.0, seconds + 0.05, 0.05)
    hover = hover_forces(team)
    sideways = np.cross([0.0, 0.0, 1.0], unit(hover * [1.0, 1.0, 0.0]))
    sideways *= np.array([1.0, -1.0, 1.0, -1.0])[:, None] * np.linalg.norm(hover, axis=1)[:, None]
    s, w = np.clip(t / period_s, 0.0, 1.0), 2.0 * np.pi / period_s
    rise, drise = s**3 * (10 - 15 * s + 6 * s * s), 30 * s**2 * (1 - s) ** 2 / period_s
    angle = np.deg2rad(amplitude_deg) * rise * np.sin(w * t)
    rate = np.deg2rad(amplitude_deg) * (rise * w * np.cos(w * t) + drise * np.sin(w * t))
    load = np.tile([0.0, 0.0, 2.0, 1.0] + 9 * [0.0], (len(t), 1))
    active = np.ones(4, dtype=bool)
    return ForcePlan(
        stamp_us=0,
        node_s=t,
        load=load,
        accel_W=np.zeros((len(t), 3)),
        force_W=hover + np.tan(angle)[:, None, None] * sideways,
        dforce_W=(rate / np.cos(angle) ** 2)[:, None, None] * sideways,
        gain=feedback_gains(team, np.tile(np.eye(3), (len(t), 1, 1)), active, Geometric()),
        thrust=np.zeros((len(t), 4)),
        active=active,
    )


class Fixed:
    """A `PayloadController` with one plan."""

    def __init__(self, plan):
        self.plan = plan

    def build(self, team, limits):
        return self

    def init(self):
        return None

    def solve(self, memory, request):
        return None, SimpleNamespace(plan=self.plan)


@pytest.mark.parametrize("lag_s", [0.0, 0.03])
def test_swing_is_followed_within_a_tenth_of_a_degree(closed_loop, references, lag_s):
    team = Team(vehicle=Vehicle(motor_lag_s=lag_s, drag_ns_per_m=0.0), separation_m=0.05)
    team = replace(team, payload=replace(team.payload, drag_ns_per_m=0.0))
    loop = closed_loop(team, controller=Fixed(swing_plan(team)), replan_s=100.0)
    flight = loop.fly(references[1](), 7.5)
    wanted = -unit(flight.force_W)
    error = np.rad2deg(np.linalg.norm(np.cross(wanted, flight.cable_dir_W), axis=2))
    swing = np.rad2deg(np.arccos(np.clip(np.sum(wanted * wanted[0], axis=2), -1.0, 1.0)))
    assert 19.5 < swing.max() < 20.5
    assert error.max() < 0.1


def test_gains_must_be_positive():
    with pytest.raises(ValueError, match="damping must be > 0, got -1"):
        CableGains(damping=-1.0)
