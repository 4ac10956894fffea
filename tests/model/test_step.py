# SPDX-License-Identifier: Apache-2.0
"""Tests of `model.step`: exactness, conservation and invariance of the one-step map."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skyhaul.errors import SkyhaulError
from skyhaul.geometry.quaternion import quat_exp, quat_mul, quat_rotate
from skyhaul.model import (
    TautState,
    Team,
    TeamState,
    energy,
    hover_state,
    hover_wrenches,
    momentum,
    step,
    taut_state,
    team_state,
)
from skyhaul.model.dynamics import arrays_of, pack, taut_derivative, taut_work, vehicle_motion
from skyhaul.model.step import project

SIZES = [(n, kind) for n in (1, 2, 3, 4, 8) for kind in ("point", "rigid")]


def assert_close(a: TautState, b: TautState, atol):
    for name, value in vars(a).items():
        np.testing.assert_allclose(getattr(b, name), value, rtol=0, atol=atol, err_msg=name)


@pytest.mark.parametrize(("n", "kind"), SIZES)
def test_10_ms_equal_a_high_order_reference_to_1e_8(rng, make, n, kind):
    for _ in range(5):
        team, state = make.team(rng, n, kind), make.state(rng, n, kind)
        wrenches, arrays, work = make.wrenches(rng, n), team.arrays(), taut_work(n)

        def rate(_, x, arrays=arrays, wrenches=wrenches, work=work):
            dx = np.empty_like(x)
            taut_derivative(arrays, x, wrenches, work, dx)
            return dx

        exact = solve_ivp(rate, (0, 0.01), pack(state), method="DOP853", rtol=1e-13, atol=1e-14)
        ours = pack(step(team, state, wrenches, 0.01))
        np.testing.assert_allclose(ours, exact.y[:, -1], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("n", "kind"), [(1, "rigid"), (2, "point"), (3, "rigid"), (4, "rigid")])
def test_10_ms_equal_the_model_in_maximal_coordinates(rng, make, n, kind):
    team, state, wrenches = make.team(rng, n, kind), make.state(rng, n, kind), make.wrenches(rng, n)
    start = team_state(team, state)
    parts = list(vars(start).values())
    sizes = np.cumsum([p.size for p in parts])[:-1]

    def unflatten(y):
        pieces = np.split(y, sizes)
        return TeamState(*(q.reshape(p.shape) for q, p in zip(pieces, parts, strict=True)))

    def rate(_, y):
        s = unflatten(y)
        r = make.maximal_rates(team, s, wrenches)
        pieces = (s.v_WL, r.dq_WL, r.a_WL, r.dw_WL_L, s.v_WB, r.dq_WB, r.a_WB, r.dw_WB_B)
        return np.concatenate([np.ravel(p) for p in pieces])

    y0 = np.concatenate([p.ravel() for p in parts])
    exact = solve_ivp(rate, (0, 0.01), y0, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    assert_close(step(team, state, wrenches, 0.01), taut_state(team, unflatten(exact)), 1e-9)


@pytest.mark.parametrize(("n", "kind"), SIZES)
def test_free_swing_keeps_energy_and_momentum(rng, make, n, kind):
    team, state = make.team(rng, n, kind), make.state(rng, n, kind)
    a, idle, duration = team.arrays(), np.zeros((n, 4)), 1.0
    mass = a.m_L + a.m_B.sum()
    end = state
    for _ in range(50):
        end = step(team, end, idle, duration / 50)
    assert sum(energy(team, end)) == pytest.approx(sum(energy(team, state)), abs=1e-8)
    fallen = momentum(team, state)[0] - [0.0, 0.0, mass * a.g * duration]
    np.testing.assert_allclose(momentum(team, end)[0], fallen, atol=1e-9)
    np.testing.assert_allclose(
        spin_about_center(team, end), spin_about_center(team, state), atol=1e-8
    )


def spin_about_center(team, state):
    """Angular momentum about the centre of mass of the whole team."""
    a = team.arrays()
    p_WB, _ = vehicle_motion(team, state)
    linear, angular = momentum(team, state)
    mass = a.m_L + a.m_B.sum()
    center = (a.m_L * state.p_WL + np.sum(a.m_B[:, None] * p_WB, axis=0)) / mass
    return angular - np.cross(center, linear)


def turned(state, phi, shift):
    q = quat_exp(phi)
    return TautState(
        p_WL=quat_rotate(q, state.p_WL) + shift,
        q_WL=quat_mul(q, state.q_WL),
        v_WL=quat_rotate(q, state.v_WL),
        w_WL_L=state.w_WL_L,
        cable_dir_W=quat_rotate(q, state.cable_dir_W),
        cable_w_W=quat_rotate(q, state.cable_w_W),
        q_WB=quat_mul(q, state.q_WB),
        w_WB_B=state.w_WB_B,
    )


@pytest.mark.parametrize(
    ("phi", "g"), [(np.array([0.0, 0.0, 1.3]), 9.81), (np.array([0.7, -1.1, 0.4]), 0.0)]
)
def test_motion_does_not_depend_on_the_choice_of_world_frame(rng, make, phi, g):
    state, wrenches = make.state(rng, 4, "rigid"), make.wrenches(rng, 4)
    team, shift = make.team(rng, 4, "rigid").arrays()._replace(g=g), np.array([3.0, -2.0, 7.0])
    moved = turned(step(team, state, wrenches, 0.05), phi, shift)
    assert_close(step(team, turned(state, phi, shift), wrenches, 0.05), moved, 1e-9)


def test_numbering_of_the_cables_does_not_matter(rng, make):
    team, state, wrenches = (
        make.team(rng, 4, "rigid"),
        make.state(rng, 4, "rigid"),
        make.wrenches(rng, 4),
    )
    order, a = [2, 0, 3, 1], team.arrays()
    rows = {k: getattr(a, k)[order] for k in ("p_LA", "m_B", "J_B", "length")}
    per_cable = ("cable_dir_W", "cable_w_W", "q_WB", "w_WB_B")
    shuffle = lambda s: TautState(**{**vars(s), **{k: getattr(s, k)[order] for k in per_cable}})  # noqa: E731
    got = step(a._replace(**rows), shuffle(state), wrenches[order], 0.05)
    assert_close(got, shuffle(step(team, state, wrenches, 0.05)), 1e-9)


@pytest.mark.parametrize("kind", ["point", "rigid"])
def test_one_long_step_equals_many_short_ones(rng, make, kind):
    team, state, wrenches = make.team(rng, 3, kind), make.state(rng, 3, kind), make.wrenches(rng, 3)
    many = state
    for _ in range(60):
        many = step(team, many, wrenches, 0.005)
    assert_close(step(team, state, wrenches, 0.3), many, 2e-7)


def test_reversed_rates_lead_back(rng, make):
    team, state, wrenches = (
        make.team(rng, 4, "rigid"),
        make.state(rng, 4, "rigid"),
        make.wrenches(rng, 4),
    )
    back = lambda s: TautState(  # noqa: E731
        **{**vars(s), **{k: -getattr(s, k) for k in ("v_WL", "w_WL_L", "cable_w_W", "w_WB_B")}}
    )
    returned = back(step(team, back(step(team, state, wrenches, 0.05)), wrenches, 0.05))
    assert_close(returned, state, 1e-9)


@pytest.mark.parametrize(("n", "kind"), [(1, "rigid"), (2, "rigid"), (4, "rigid"), (8, "point")])
def test_hover_stays_where_it_is(n, kind, make, rng):
    team = make.team(rng, n, kind)
    state = hover_state(team, np.array([1.0, 2.0, 3.0]), yaw=0.4)
    assert_close(step(team, state, hover_wrenches(team), 0.1), state, 1e-10)


def test_unit_vectors_and_normal_rates_hold_exactly(rng, make):
    team, state = make.team(rng, 4, "rigid"), make.state(rng, 4, "rigid")
    end = step(team, state, make.wrenches(rng, 4), 0.5)
    for unit in (end.q_WL, end.q_WB, end.cable_dir_W):
        np.testing.assert_allclose(np.linalg.norm(unit, axis=-1), 1.0, atol=1e-15)
    np.testing.assert_allclose(np.sum(end.cable_dir_W * end.cable_w_W, axis=1), 0.0, atol=1e-14)


def test_projection_scales_to_unit_length_and_drops_the_spin_of_a_cable(rng, make):
    state = make.state(rng, 2, "rigid")
    stretched = TautState(
        **{
            **vars(state),
            "q_WL": 1.1 * state.q_WL,
            "q_WB": 0.9 * state.q_WB,
            "cable_dir_W": 1.2 * state.cable_dir_W,
            "cable_w_W": state.cable_w_W + 0.3 * state.cable_dir_W,
        }
    )
    x = pack(stretched)
    project(x, 2)
    np.testing.assert_allclose(x, pack(state), atol=1e-15)


def test_inputs_stay_as_they_were(rng, make):
    team, state, wrenches = (
        make.team(rng, 3, "rigid"),
        make.state(rng, 3, "rigid"),
        make.wrenches(rng, 3),
    )
    before, held = pack(state), wrenches.copy()
    step(team, state, wrenches, 0.01)
    np.testing.assert_array_equal(pack(state), before)
    np.testing.assert_array_equal(wrenches, held)


@pytest.mark.parametrize(
    ("dt", "wrenches", "message"),
    [
        (0.0, np.zeros((4, 4)), "dt > 0"),
        (np.nan, np.zeros((4, 4)), "dt > 0"),
        (0.01, np.full((4, 4), np.nan), "finite"),
        (0.01, np.zeros((3, 4)), r"\(4, 4\).*\(3, 4\)"),
        (0.01, np.full((4, 4), 1e12), "sub-steps below 1 ns"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(dt, wrenches, message):
    team = Team()
    with pytest.raises(SkyhaulError, match=message):
        step(team, hover_state(team, np.zeros(3)), wrenches, dt)


def test_team_and_its_arrays_are_interchangeable(rng, make):
    team, state, wrenches = (
        make.team(rng, 3, "rigid"),
        make.state(rng, 3, "rigid"),
        make.wrenches(rng, 3),
    )
    a, b = step(team, state, wrenches, 0.01), step(arrays_of(team), state, wrenches, 0.01)
    np.testing.assert_array_equal(pack(a), pack(b))
