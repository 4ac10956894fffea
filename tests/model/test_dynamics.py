# SPDX-License-Identifier: Apache-2.0
"""Tests of `model.dynamics`: the taut team and the load under cable forces."""

import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_exp, quat_mul, quat_rotate
from skyhaul.model import (
    PointPayload,
    TautState,
    Team,
    accelerations,
    energy,
    hover_state,
    hover_wrenches,
    load_acceleration,
    load_derivative,
    slack_cables,
    step,
    team_state,
    tensions,
)
from skyhaul.model.dynamics import arrays_of, pack, solve_spd, unpack, vehicle_motion
from skyhaul.model.team import Vehicle

SIZES = [(n, kind) for n in (1, 2, 3, 4, 8) for kind in ("point", "rigid")]


@pytest.mark.parametrize(("n", "kind"), SIZES)
def test_accelerations_equal_those_of_the_model_in_maximal_coordinates(rng, make, n, kind):
    for _ in range(5):
        team, state = make.team(rng, n, kind), make.state(rng, n, kind)
        wrenches = make.wrenches(rng, n)
        ours = accelerations(team, state, wrenches)
        theirs = make.maximal_rates(team, team_state(team, state), wrenches)
        np.testing.assert_allclose(ours.a_WL, theirs.a_WL, atol=1e-9)
        np.testing.assert_allclose(ours.dw_WL_L, theirs.dw_WL_L, atol=1e-9)
        np.testing.assert_allclose(ours.dw_WB_B, theirs.dw_WB_B, atol=1e-9)
        np.testing.assert_allclose(ours.tension, theirs.tension, atol=1e-9)
        np.testing.assert_allclose(vehicle_accelerations(team, state, ours), theirs.a_WB, atol=1e-9)


def vehicle_accelerations(team, state, rates):
    """Second derivative of p_WL + R p_LA - l cable_dir."""
    a = team.arrays()
    w, dw, d = state.w_WL_L, rates.dw_WL_L, state.cable_dir_W
    hook = np.cross(dw, a.p_LA) + np.cross(w, np.cross(w, a.p_LA))
    cw = state.cable_w_W
    ddd = np.cross(rates.cable_dw_W, d) + np.cross(cw, np.cross(cw, d))
    return rates.a_WL + quat_rotate(state.q_WL, hook * a.rigid) - a.length[:, None] * ddd


@pytest.mark.parametrize("angle", [0.05, 1.0, 2.5])
def test_a_single_load_swings_as_a_pendulum_on_a_free_support(angle):
    # The support, pushed up by f, is free too: ddangle = -f sin(angle) / (m_B l).
    team = Team(count=1, payload=PointPayload(mass_kg=0.4))
    m_B, length, thrust = team.vehicle.mass_kg, team.cable_length_m, 5.0
    level = hover_state(team, np.zeros(3))
    state = TautState(
        **{**vars(level), "cable_dir_W": np.array([[np.sin(angle), 0.0, -np.cos(angle)]])}
    )
    rates = accelerations(team, state, np.array([[thrust, 0.0, 0.0, 0.0]]))
    # Rotation about +y turns -z towards -x, so the swing angle runs about -y.
    ddangle = thrust * np.sin(angle) / (m_B * length)
    np.testing.assert_allclose(rates.cable_dw_W, [[0.0, ddangle, 0.0]], atol=1e-12)


def test_tension_of_a_vertical_drop_is_zero_and_of_a_hover_the_weight():
    team = Team(count=1, payload=PointPayload(mass_kg=0.4))
    state = hover_state(team, np.zeros(3))
    np.testing.assert_allclose(tensions(team, state, np.zeros((1, 4))), 0.0, atol=1e-14)
    hover = tensions(team, state, hover_wrenches(team))
    np.testing.assert_allclose(hover, 0.4 * 9.81, rtol=1e-12)


def test_a_spinning_dumbbell_is_held_by_its_centripetal_force():
    team = Team(count=1, payload=PointPayload(mass_kg=0.3))
    still = hover_state(team, np.zeros(3))
    spin = 4.0
    state = TautState(**{**vars(still), "cable_w_W": np.array([[spin, 0.0, 0.0]])})
    reduced = 0.3 * 0.25 / (0.3 + 0.25)
    np.testing.assert_allclose(
        tensions(team, state, np.zeros((1, 4))), reduced * spin**2 * 1.0, rtol=1e-12
    )


def test_a_cable_that_would_push_is_reported_as_slack():
    team = Team(count=3, payload=PointPayload())
    state, wrenches = hover_state(team, np.zeros(3)), hover_wrenches(team)
    assert not slack_cables(team, state, wrenches).any()
    wrenches[1, 0] = 0.0
    np.testing.assert_array_equal(slack_cables(team, state, wrenches), [False, True, False])
    assert tensions(team, state, wrenches)[1] < 0.0


@pytest.mark.parametrize(("n", "kind"), [(1, "rigid"), (3, "point"), (4, "rigid")])
def test_energy_grows_by_the_work_of_thrusts_and_moments(rng, make, n, kind):
    team, state, h = make.team(rng, n, kind), make.state(rng, n, kind), 1e-4
    wrenches = make.wrenches(rng, n)
    ahead = step(team, state, wrenches, h)
    middle = step(team, state, wrenches, 0.5 * h)
    _, v_WB = vehicle_motion(team, middle)
    z_B = quat_rotate(middle.q_WB, np.array([0.0, 0.0, 1.0]))
    power = np.sum(wrenches[:, 0] * np.sum(v_WB * z_B, axis=1))
    power += np.sum(wrenches[:, 1:] * middle.w_WB_B)
    gain = sum(energy(team, ahead)) - sum(energy(team, state))
    assert gain / h == pytest.approx(power, rel=1e-5)


@pytest.mark.parametrize("kind", ["point", "rigid"])
def test_load_under_the_tensions_moves_as_in_the_team(rng, make, kind):
    team, state = make.team(rng, 4, kind), make.state(rng, 4, kind)
    rates = accelerations(team, state, make.wrenches(rng, 4))
    force_W = -rates.tension[:, None] * state.cable_dir_W
    load = team_state(team, state).load
    got = load_acceleration(team, load, force_W)
    np.testing.assert_allclose(got, np.append(rates.a_WL, rates.dw_WL_L), atol=1e-10)


def test_forces_without_moment_leave_the_turning_load_to_euler(rng, make):
    team, load = make.team(rng, 3, "rigid"), team_state_load(rng)
    w, J = load[10:], team.payload.J_L
    got = load_acceleration(team, load, np.zeros((3, 3)))
    np.testing.assert_allclose(got[:3], [0.0, 0.0, -9.81])
    np.testing.assert_allclose(J * got[3:] + np.cross(w, J * w), 0.0, atol=1e-15)


def team_state_load(rng):
    q = quat_exp(rng.normal(size=3))
    return np.concatenate([rng.normal(size=3), q, rng.normal(size=3), rng.normal(size=3)])


def test_load_derivative_is_the_tangent_of_the_motion(rng, make):
    team, load, force_W = make.team(rng, 3, "rigid"), team_state_load(rng), rng.normal(size=(3, 3))
    h, w = 1e-6, load[10:]
    dx = load_derivative(team, load, force_W)
    turned = quat_mul(load[3:7], quat_exp(h * w)) - quat_mul(load[3:7], quat_exp(-h * w))
    np.testing.assert_allclose(dx[:3], load[7:10])
    np.testing.assert_allclose(dx[3:7], turned / (2 * h), atol=1e-9)
    np.testing.assert_allclose(dx[7:], load_acceleration(team, load, force_W))


def test_a_point_mass_does_not_turn(rng, make):
    team, load = make.team(rng, 3, "point"), team_state_load(rng)
    dx = load_derivative(team, load, rng.normal(size=(3, 3)))
    np.testing.assert_array_equal(dx[3:7], 0.0)
    np.testing.assert_array_equal(dx[10:], 0.0)


def test_packing_round_trip(rng, make):
    state = make.state(rng, 3, "rigid")
    back = unpack(pack(state))
    for name, value in vars(state).items():
        np.testing.assert_array_equal(getattr(back, name), value)


def test_small_solver_equals_lapack(rng):
    for n in range(1, 9):
        B, b = rng.normal(size=(n, n)), rng.normal(size=n)
        A = B @ B.T + 0.1 * np.eye(n)
        x = b.copy()
        solve_spd(A.copy(), x)
        np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=1e-9, atol=1e-12)


def test_arrays_of_a_team_are_made_once():
    assert arrays_of(Team(count=5)) is arrays_of(Team(count=5))
    assert arrays_of(Team(vehicle=Vehicle(mass_kg=0.3))).m_B[0] == 0.3
