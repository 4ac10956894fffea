# SPDX-License-Identifier: Apache-2.0
"""The paper's equations (1) to (5), as PAPER_NOTES 1 to 6 settle them, and 9 on the Log."""

import numpy as np

from skyhaul.geometry.quaternion import quat_exp, quat_log, quat_rotate
from skyhaul.geometry.so3 import euler_rate_map, euler_to_R, euler_zyx, so3_exp
from skyhaul.model import (
    PointPayload,
    TautState,
    Team,
    accelerations,
    hover_state,
    hover_wrenches,
    load_acceleration,
    rotors_to_wrench,
    saturate_rotors,
    slack_cables,
    tensions,
)


def test_hover_thrust_is_upward_and_carries_an_even_share():
    # Eqs. (1), (2), PAPER_NOTES 3: z is up, so thrust = +(m_i + m_L / N) g.
    team = Team(count=3, payload=PointPayload(), cable_angle_deg=0.0, separation_m=1e-3)
    wrenches = hover_wrenches(team)
    weight = (team.vehicle.mass_kg + team.payload.mass_kg / 3) * 9.81
    np.testing.assert_allclose(wrenches[:, 0], weight, rtol=1e-5)
    state = hover_state(team, np.zeros(3))
    up = quat_rotate(state.q_WB, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(up, np.tile([0.0, 0.0, 1.0], (3, 1)), atol=1e-3)
    np.testing.assert_allclose(accelerations(team, state, wrenches).a_WL, 0.0, atol=1e-10)


def test_more_thrust_lifts_and_none_falls():
    # Eq. (1), PAPER_NOTES 3.
    team = Team()
    state, wrenches = hover_state(team, np.zeros(3)), hover_wrenches(team)
    assert accelerations(team, state, 1.2 * wrenches).a_WL[2] > 0.5
    assert accelerations(team, state, 0.0 * wrenches).a_WL[2] < -9.0


def test_cable_pulls_along_its_world_direction_and_turns_the_load_about_its_hook():
    # Eqs. (1), (2), PAPER_NOTES 4: force -T dir_W, torque p_LA x R_WL^T (-T dir_W).
    team = Team()
    q_WL = quat_exp(np.array([0.3, -0.2, 1.1]))
    load = np.concatenate([np.zeros(3), q_WL, np.zeros(6)])
    force_W = np.zeros((4, 3))
    force_W[0] = [0.4, 0.0, 1.0]
    a = load_acceleration(team, load, force_W)
    arrays = team.arrays()
    np.testing.assert_allclose(a[:3], force_W[0] / arrays.m_L - [0, 0, arrays.g])
    torque_W = np.cross(quat_rotate(q_WL, arrays.p_LA[0]), force_W[0])
    np.testing.assert_allclose(quat_rotate(q_WL, arrays.J_L * a[3:]), torque_W, atol=1e-15)


def test_tension_follows_from_the_constraint():
    # Eqs. (1), (2), PAPER_NOTES 5: p_B = p_L + R_L r - l xi, twice differentiated, gives T.
    team = Team()
    state, wrenches = hover_state(team, np.zeros(3)), hover_wrenches(team)
    share = team.payload.mass_kg * 9.81 / 4 / np.cos(team.cable_angle_rad)
    np.testing.assert_allclose(tensions(team, state, wrenches), share, rtol=1e-12)


def test_cable_that_would_have_to_push_is_slack():
    # PAPER_NOTES 5: T >= 0.
    team = Team(count=1, payload=PointPayload())
    above = hover_state(team, np.zeros(3))
    upside_down = TautState(**{**vars(above), "cable_dir_W": -above.cable_dir_W})
    assert slack_cables(team, upside_down, hover_wrenches(team)).all()
    assert not slack_cables(team, above, hover_wrenches(team)).any()


def test_yaw_turns_about_the_vertical():
    # Eq. (3), PAPER_NOTES 1: at 90 deg of yaw, thrust still points up and x to the north.
    R = euler_to_R(np.array([0.0, 0.0, np.pi / 2]))
    np.testing.assert_allclose(R @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(R @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


def test_gamma_maps_body_rates_to_euler_rates():
    # Eq. (4), PAPER_NOTES 2: Gamma fits the rotation that is used.
    angles, w, h = np.array([0.4, -0.6, 2.0]), np.array([0.3, -0.5, 0.9]), 1e-6
    R = euler_to_R(angles)
    difference = euler_zyx(R @ so3_exp(h * w)) - euler_zyx(R @ so3_exp(-h * w))
    np.testing.assert_allclose(euler_rate_map(angles) @ w, difference / (2 * h), atol=1e-8)


def test_rotors_saturate_one_by_one_from_below_too():
    # Eq. (5), PAPER_NOTES 6.
    team = Team(count=1, payload=PointPayload())
    v = team.vehicle
    for thrust in (-5.0, 0.0, 100.0):
        rotors = saturate_rotors(team, np.array([[thrust, 0.01, 0.02, 0.1]]))
        assert np.all(rotors >= v.thrust_min_n / 4)
        assert np.all(rotors <= v.thrust_max_n / 4)
    assert rotors_to_wrench(team, rotors)[0, 0] <= v.thrust_max_n


def test_attitude_error_is_the_same_for_both_signs_of_the_quaternion():
    # PAPER_NOTES 9: Log(q_d^-1 (x) q) instead of a log of Euler angles, q and -q alike.
    q = quat_exp(np.array([0.1, -0.2, 0.3]))
    np.testing.assert_allclose(quat_log(-q), quat_log(q))
    np.testing.assert_allclose(quat_log(q), [0.1, -0.2, 0.3])
