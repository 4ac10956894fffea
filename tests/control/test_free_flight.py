# SPDX-License-Identifier: Apache-2.0
"""Tests of `control.free_flight`. Each name states the property it checks."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skyhaul.control.free_flight import FreeFlight, creep_speed
from skyhaul.model import Team, TeamState, Vehicle, rotors_to_wrench, saturate_rotors
from skyhaul.types import GRAVITY_MPS2

N = 4
UP = np.array([0.0, 0.0, 1.0])


def at_rest(p_WB, q_WB=None):
    q = np.tile([1.0, 0.0, 0.0, 0.0], (N, 1)) if q_WB is None else q_WB
    zero = np.zeros((N, 3))
    load = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    return TeamState(*load, np.array(p_WB, dtype=float), q, zero, zero.copy())


def fly(team, state, goal, seconds, yaw=0.0, pull_W=None, dt=2e-3):
    """Free vehicles with rotor lag, semi-implicit Euler; returns the last state and the path."""
    flyer, arrays = FreeFlight().build(team), team.arrays()
    p, v, w = state.p_WB.copy(), state.v_WB.copy(), state.w_WB_B.copy()
    R = Rotation.from_quat(state.q_WB, scalar_first=True)
    rotors = np.full((N, 4), 0.25 * arrays.m_B[0] * GRAVITY_MPS2)
    share, path = 1.0 - np.exp(-dt / arrays.motor_lag), []
    for _ in range(round(seconds / dt)):
        q = R.as_quat(scalar_first=True)
        now = TeamState(
            state.p_WL, state.q_WL, state.v_WL, state.w_WL_L, p.copy(), q, v.copy(), w.copy()
        )
        zero = np.zeros((N, 3))
        thrust, moment = flyer.step(now, goal, zero, zero, np.full(N, yaw), pull_W)
        command = saturate_rotors(team, np.column_stack([thrust, moment]))
        rotors += share * (command - rotors)
        wrench = rotors_to_wrench(team, rotors)
        force = R.apply(wrench[:, :1] * UP) - team.vehicle.drag_ns_per_m * v
        force = force if pull_W is None else force + pull_W
        v += dt * (force / arrays.m_B[:, None] - GRAVITY_MPS2 * UP)
        w += dt * (wrench[:, 1:] - np.cross(w, arrays.J_B * w)) / arrays.J_B
        p += dt * v
        R = R * Rotation.from_rotvec(dt * w)
        path.append(p.copy())
    return p, R, np.array(path)


def test_hover_takes_the_weight_and_no_moment():
    goal = np.arange(12.0).reshape(4, 3)
    zero = np.zeros((4, 3))
    thrust, moment = FreeFlight().build(Team()).step(at_rest(goal), goal, zero, zero, np.zeros(4))
    np.testing.assert_allclose(thrust, 0.25 * GRAVITY_MPS2)
    np.testing.assert_allclose(moment, 0.0, atol=1e-12)


def test_vehicles_reach_their_points_and_headings():
    start = np.array([[0.0, 0, 1], [2, 0, 1], [0, 2, 1], [2, 2, 1]])
    goal = start + np.array([[1.0, 0, 0], [0, -1, 0.5], [-0.5, 0.5, -0.5], [0, 0, 1]])
    p, R, path = fly(Team(), at_rest(start), goal, 6.0, yaw=2.0)
    np.testing.assert_allclose(p, goal, atol=2e-3)
    heading = R.apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(np.arctan2(heading[:, 1], heading[:, 0]), 2.0, atol=0.02)
    over = np.linalg.norm(path - start, axis=2).max(axis=0) / np.linalg.norm(goal - start, axis=1)
    assert over.max() < 1.1  # overshoot


def test_a_far_goal_does_not_tip_a_vehicle_over():
    start = np.array([[0.0, 0, 1], [2, 0, 1], [0, 2, 1], [2, 2, 1]])
    goal = start + np.array([20.0, 0.0, 0.0])
    _, R, path = fly(Team(), at_rest(start), goal, 2.0)
    assert np.rad2deg(np.arccos(R.apply(UP)[:, 2])).max() < 36.0
    assert np.abs(path[:, :, 2] - 1.0).max() < 0.1


def test_a_tilted_start_is_caught():
    q = Rotation.from_rotvec([[0.6, 0, 0], [0, -0.6, 0], [0.4, 0.4, 0], [0, 0, 3.0]])
    start = np.array([[0.0, 0, 3], [2, 0, 3], [0, 2, 3], [2, 2, 3]])
    p, _, _ = fly(Team(), at_rest(start, q.as_quat(scalar_first=True)), start, 6.0)
    np.testing.assert_allclose(p, start, atol=2e-3)


def test_a_known_pull_is_made_up_for():
    start = np.array([[0.0, 0, 3], [2, 0, 3], [0, 2, 3], [2, 2, 3]])
    pull = np.tile([0.3, 0.0, -0.5], (4, 1))
    p, _, _ = fly(Team(), at_rest(start), start, 5.0, pull_W=pull)
    np.testing.assert_allclose(p, start, atol=2e-3)


def test_attitude_gains_place_the_poles_with_the_rotor_lag():
    f, lag = FreeFlight(), Vehicle().motor_lag_s
    poles = np.roots([lag, 1.0, f.attitude_damping, f.attitude_stiffness])
    assert poles.real.max() < -9.0
    assert np.all(-poles.real / np.abs(poles) > 0.68)


def test_creep_stops_at_the_tension_and_backs_off_beyond_it():
    tension = np.array([0.0, 0.1, 0.2, 0.3, 1.0])
    np.testing.assert_allclose(
        creep_speed(tension, 0.2, 0.1), [0.1, 0.05, 0.0, -0.05, -0.1], atol=1e-12
    )


def test_bad_gains_are_refused():
    with pytest.raises(ValueError, match="tilt_max_deg must lie in"):
        FreeFlight(tilt_max_deg=90.0)
    with pytest.raises(ValueError, match="yaw_damping must be > 0"):
        FreeFlight(yaw_damping=-1.0)


@pytest.mark.parametrize("i", range(N))
def test_one_vehicle_alone_is_told_the_same(i):
    team, rng = Team(), np.random.default_rng(5)
    goal = rng.normal(size=(3, N, 3))
    state, yaw = at_rest(rng.normal(size=(N, 3))), rng.uniform(-3.0, 3.0, N)
    flyer = FreeFlight().build(team)
    thrust, moment = flyer.step(state, *goal, yaw)
    rotors, alone, torque = flyer.step_one(state, i, goal[:, i], yaw[i])
    together = saturate_rotors(team, np.column_stack([thrust, moment]))[i]
    assert alone == thrust[i]
    np.testing.assert_array_equal(torque, moment[i])
    np.testing.assert_allclose(rotors, together, rtol=1e-12)
