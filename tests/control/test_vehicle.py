# SPDX-License-Identifier: Apache-2.0
"""Tests of `control.vehicle` and its loops, closed with the taut model and the rotors' lag."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skyhaul.control.geometric import Geometric, hold_plan
from skyhaul.control.load_loop import observe_disturbance
from skyhaul.control.vehicle import CableTracking
from skyhaul.control.vehicle_loop import hook_accel
from skyhaul.model import PointPayload, Team, hover_state, hover_wrenches, wrench_to_rotors
from skyhaul.model.state import CableState, TeamState

GAINS = Geometric()
PLACE = np.array([0.3, -0.2, 2.0])


def holding(team, R_WL=None):
    R = np.eye(3) if R_WL is None else R_WL
    return hold_plan(team, 0, PLACE, R, np.ones(team.count, dtype=bool), GAINS)


def hovering(team, perfect_estimate, yaw=0.0):
    rotors = wrench_to_rotors(team, hover_wrenches(team))
    return perfect_estimate(team, hover_state(team, PLACE, yaw), rotors, 0)


def tick(team, estimate, plan, params=None, **more):
    tracker = (params or CableTracking()).build(team)
    return tracker.step(tracker.init(team.count), estimate, plan, np.zeros(team.count), **more)


@pytest.mark.parametrize("n", [3, 4, 8])
def test_hover_asks_for_the_hover_thrusts_and_no_moments(n, still_air, perfect_estimate):
    team = still_air(Team(count=n))
    _, command = tick(team, hovering(team, perfect_estimate), holding(team))
    np.testing.assert_allclose(command.thrust, hover_wrenches(team)[:, 0], rtol=1e-9)
    np.testing.assert_allclose(command.moment_B, 0.0, atol=1e-9)
    np.testing.assert_allclose(command.rotor_cmd.sum(axis=1), command.thrust, rtol=1e-9)
    np.testing.assert_array_equal(command.wrench_slack_W, 0.0)


@pytest.fixture
def disturbed(perfect_estimate, team):
    """An estimate off the plan in everything."""
    rng = np.random.default_rng(4)
    estimate = hovering(team, perfect_estimate)
    bodies, cables = estimate.team, estimate.cables

    def near(a, size=0.02):
        return a + size * rng.normal(size=a.shape)

    def turned(q):
        turn = Rotation.from_rotvec(0.05 * rng.normal(size=(*q.shape[:-1], 3)))
        return (Rotation.from_quat(q, scalar_first=True) * turn).as_quat(scalar_first=True)

    bodies = TeamState(
        near(bodies.p_WL),
        turned(bodies.q_WL),
        near(bodies.v_WL, 0.1),
        near(bodies.w_WL_L, 0.1),
        bodies.p_WB,
        turned(bodies.q_WB),
        near(bodies.v_WB, 0.1),
        near(bodies.w_WB_B, 0.2),
    )
    dir_W = near(cables.dir_W)
    dir_W /= np.linalg.norm(dir_W, axis=1, keepdims=True)
    w_W = np.cross(dir_W, 0.1 * rng.normal(size=dir_W.shape))
    cables = CableState(dir_W, w_W, cables.tension, np.array(team.cable_lengths_m()))
    return replace(estimate, team=bodies, cables=cables)


def test_one_vehicle_alone_gets_what_it_gets_in_the_team(team, disturbed):
    tracker, plan, yaw = CableTracking().build(team), holding(team), np.zeros(4)
    _, all_of_them = tracker.step(tracker.init(4), disturbed, plan, yaw)
    for i in range(4):
        _, one = tracker.step_one(tracker.init(4), disturbed, plan, yaw, i)
        np.testing.assert_array_equal(one.rotor_cmd[i], all_of_them.rotor_cmd[i])
        np.testing.assert_array_equal(np.delete(one.rotor_cmd, i, axis=0), 0.0)
        np.testing.assert_array_equal(one.force_W, all_of_them.force_W)


def test_a_tick_is_pure(team, disturbed):
    tracker, plan = CableTracking().build(team), holding(team)
    memory = tracker.init(4)
    a, b = (tracker.step(memory, disturbed, plan, np.zeros(4)) for _ in range(2))
    np.testing.assert_array_equal(a[1].rotor_cmd, b[1].rotor_cmd)
    np.testing.assert_array_equal(a[0].vehicles, b[0].vehicles)
    np.testing.assert_array_equal(memory.vehicles, 0.0)


def test_commands_do_not_depend_on_where_north_is(team, disturbed):
    """Turn world, plan and headings about the vertical: thrusts and body moments stay."""
    turn = Rotation.from_rotvec([0.0, 0.0, 0.7])

    def turned(estimate):
        b, c = estimate.team, estimate.cables

        def v(a):
            return a @ turn.as_matrix().T

        def q(a):
            return (turn * Rotation.from_quat(np.array(a), scalar_first=True)).as_quat(
                scalar_first=True
            )

        team_ = TeamState(
            v(b.p_WL),
            q(b.q_WL),
            v(b.v_WL),
            b.w_WL_L,
            v(b.p_WB),
            q(b.q_WB),
            v(b.v_WB),
            b.w_WB_B,
        )
        cables = CableState(v(c.dir_W), v(c.w_W), c.tension, c.length)
        return replace(estimate, team=team_, cables=cables)

    every = np.ones(4, dtype=bool)
    plan = hold_plan(team, 0, turn.apply(PLACE), turn.as_matrix(), every, GAINS)
    tracker = CableTracking().build(team)
    _, here = tracker.step(tracker.init(4), disturbed, holding(team), np.zeros(4))
    _, there = tracker.step(tracker.init(4), turned(disturbed), plan, np.full(4, 0.7))
    np.testing.assert_allclose(there.thrust, here.thrust, atol=1e-9)
    np.testing.assert_allclose(there.moment_B, here.moment_B, atol=1e-9)
    np.testing.assert_allclose(there.force_W, turn.apply(here.force_W), atol=1e-9)


def test_rotors_stay_within_their_limits(team, disturbed):
    shoved = replace(disturbed.team, v_WL=np.array([3.0, -2.0, 1.0]))
    _, command = tick(team, replace(disturbed, team=shoved), holding(team))
    assert command.rotor_cmd.min() >= 0.25 * team.vehicle.thrust_min_n - 1e-12
    assert command.rotor_cmd.max() <= 0.25 * team.vehicle.thrust_max_n + 1e-12


def test_lift_pulls_with_a_share_of_the_forces(team, perfect_estimate):
    estimate = hovering(team, perfect_estimate)
    plan = holding(team)
    _, full = tick(team, estimate, plan)
    for scale in (0.0, 0.3, 0.9):
        _, part = tick(team, estimate, plan, scale=scale)
        assert np.all(np.isfinite(part.rotor_cmd))
        assert np.all(part.thrust < full.thrust)
        expected = np.maximum(scale * np.linalg.norm(full.force_W, axis=1), 0.1)
        np.testing.assert_allclose(np.linalg.norm(part.force_W, axis=1), expected, atol=1e-3)


@pytest.mark.parametrize("slack_m", [0.004, 0.05, 0.4])
def test_a_vehicle_with_a_slack_cable_flies_out_gently(team, perfect_estimate, slack_m):
    estimate = hovering(team, perfect_estimate)
    b, c = estimate.team, estimate.cables
    slack = np.array([slack_m, 0.0, 0.0, 0.0])
    loose = replace(
        estimate,
        team=replace(b, p_WB=b.p_WB + slack[:, None] * c.dir_W),
        cables=replace(c, length=c.length - slack, tension=c.tension * (slack == 0.0)),
    )
    params = CableTracking(vehicle_observer_rate=0.0, load_observer_rate=0.0)
    _, on_the_floor = tick(team, loose, holding(team), params, scale=0.9)
    b3 = Rotation.from_quat(b.q_WB, scalar_first=True).apply([0.0, 0.0, 1.0])
    accel = on_the_floor.thrust[0] * b3[0] / 0.25 - np.array([0.0, 0.0, team.arrays().g])
    assert 0.0 < -accel @ c.dir_W[0] < 4.0
    _, in_the_air = tick(team, loose, holding(team), params)
    assert np.all(np.isfinite(in_the_air.rotor_cmd))
    assert np.all(in_the_air.thrust > 0.5 * 0.25 * team.arrays().g)


def test_a_released_vehicle_brakes_and_hovers_level(team, perfect_estimate):
    estimate = hovering(team, perfect_estimate)
    off = np.array([True, False, True, True])
    plan = hold_plan(team, 0, PLACE, np.eye(3), off, GAINS)
    _, command = tick(team, replace(estimate, attached=off), plan)
    assert command.thrust[1] == pytest.approx(0.25 * team.arrays().g, rel=0.01)
    np.testing.assert_array_equal(command.force_W[1], 0.0)


def test_headings_turn_at_a_limited_rate(team, perfect_estimate):
    tracker, plan = CableTracking(yaw_rate_dps=90.0).build(team), holding(team)
    memory = tracker.init(4)
    estimate = hovering(team, perfect_estimate)
    before = None
    for k in range(100):
        now = replace(estimate, stamp_us=2000 * k)
        memory, _ = tracker.step(memory, now, plan, np.array([0.0, 0.1, 3.0, -3.0]))
        before = memory.vehicles[:, 4] if before is None else before
    turned = memory.vehicles[:, 4] - before
    np.testing.assert_allclose(turned[2:], np.deg2rad(90.0) * 0.198 * np.array([1, -1]), rtol=0.02)
    assert turned[1] == pytest.approx(0.1, abs=0.01)


def test_hook_acceleration_is_that_of_a_point_on_a_turning_load(team):
    """Finite differences of the hook's place on a load that accelerates and turns."""
    rng = np.random.default_rng(8)
    arrays, x, motion, h = team.arrays(), np.zeros((5, 23)), rng.normal(size=6), 1e-4
    q, w = Rotation.from_rotvec([0.3, -0.2, 0.5]), 2.0 * rng.normal(size=3)
    x[0, 3:7], x[0, 10:13] = q.as_quat(scalar_first=True), w

    def hook(t):
        R = q * Rotation.from_rotvec(t * w + 0.5 * t * t * motion[3:])
        return 0.5 * t * t * motion[:3] + R.apply(arrays.p_LA[2])

    accel = (hook(h) - 2.0 * hook(0.0) + hook(-h)) / h**2
    accel[2] += arrays.g
    np.testing.assert_allclose(hook_accel(arrays, x, motion, 2), accel, atol=1e-4)


def test_observer_finds_a_steady_disturbance_and_nothing_else():
    o, v, d = np.zeros(6), np.zeros(3), np.array([0.3, -0.2, 0.1])
    accel = np.array([0.5, 0.0, -0.5])
    for _ in range(4000):
        observe_disturbance(o, tuple(v), tuple(accel), (2e-3, 2.0), 1.0)
        v += 2e-3 * (accel + d)
    np.testing.assert_allclose(o[3:], d, atol=1e-3)


def test_observer_is_limited():
    o = np.zeros(6)
    for k in range(1000):
        observe_disturbance(o, (0.05 * k, 0.0, 0.0), (0.0, 0.0, 0.0), (2e-3, 3.0), 1.5)
    assert np.linalg.norm(o[3:]) <= 1.5 + 1e-12


def test_hover_stays_put(closed_loop, references, team):
    flight = closed_loop(team).fly(references[1](), 1.0)
    assert flight.error_m.max() < 1e-6


@pytest.mark.parametrize(("period_s", "bar_mm"), [(10.0, 1.0), (5.0, 5.0)])
def test_circle_is_tracked_with_rotor_lag(closed_loop, references, triangle, period_s, bar_mm):
    flight = closed_loop(triangle).fly(references[0](period_s=period_s), 4.0)
    assert 1e3 * flight.rmse_m() < bar_mm
    assert flight.tension.min() > 0.3


def test_a_step_settles_without_slack_and_with_little_overshoot(closed_loop, references, team):
    hold = references[1]
    loop = closed_loop(team)
    start = loop.start_on(hold())
    flight = loop.fly(hold((0.5, 0.0, 2.0)), 5.0, *start)
    assert flight.error_m[-1] < 5e-3
    assert flight.load[:, 0].max() < 0.5 * 1.1
    assert flight.tension.min() > 0.2
    assert np.abs(flight.load[:, 2] - 2.0).max() < 0.03


def test_a_steady_push_leaves_no_steady_error(closed_loop, references, team):
    flight = closed_loop(team, push_W=(0.15, 0.0, 0.0)).fly(references[1](), 7.0)
    assert flight.error_m.max() > 5e-3
    assert flight.error_m[-1] < 2e-3


def test_a_point_mass_flies_too(closed_loop, references, still_air):
    team = still_air(Team(payload=PointPayload(), count=3))
    flight = closed_loop(team).fly(references[0](period_s=5.0), 3.0)
    assert 1e3 * flight.rmse_m() < 6.0


def test_bad_parameters_are_refused():
    with pytest.raises(ValueError, match="slack_m must be > 0, got 0"):
        CableTracking(slack_m=0.0)
    with pytest.raises(ValueError, match="load_observer_rate must be >= 0"):
        CableTracking(load_observer_rate=-1.0)
    with pytest.raises(ValueError, match="tilt_share"):
        CableTracking(tilt_share=1.5)
