# SPDX-License-Identifier: Apache-2.0
"""Tests of `model.flatness`: the inputs it finds make the model fly the motion it was given."""

import numpy as np
import pytest

from skyhaul.geometry.quaternion import R_to_quat, quat_to_R
from skyhaul.geometry.so3 import so3_exp
from skyhaul.model import (
    PointPayload,
    TautState,
    Team,
    accelerations,
    flat_outputs,
    formation_forces,
    hover_forces,
    hover_state,
    hover_wrenches,
    load_acceleration,
    step,
)
from skyhaul.model.jets import jet_from_derivatives

ORDER = 7


class Motion:
    """A smooth motion: sums of sines for position, rotation vector and headings."""

    def __init__(self, rng, n, turns=True):
        self.amplitude = rng.normal(size=(3, 3)) * [[0.5], [0.3], [0.1]]
        self.turn = rng.normal(size=(2, 3)) * 0.15 * turns
        self.phase = rng.uniform(0, 6, size=(3, 3))
        self.yaw = rng.uniform(-1, 1, size=(n, 3))

    def position(self, t):
        """Derivatives 0..6, (7, 3)."""
        rates = np.array([0.7, 1.3, 2.1])[:, None]
        rows = [
            np.sum(
                self.amplitude * rates**k * np.sin(rates * t + self.phase + k * np.pi / 2), axis=0
            )
            for k in range(ORDER)
        ]
        return np.array(rows)

    def attitude(self, t):
        """R = Exp(a sin t) Exp(b sin 1.7 t), derivatives 0..6 by Leibniz, (7, 3, 3)."""
        return leibniz(swing(self.turn[0], 1.0, t), swing(self.turn[1], 1.7, t))

    def heading(self, t):
        """Derivatives 0..2 of the headings, (n, 3)."""
        a, b, c = self.yaw.T
        return np.column_stack([a + b * t + c * t * t, b + 2 * c * t, 2 * c])

    def sample(self, times):
        return (
            np.array([self.position(t) for t in times]),
            np.array([self.attitude(t) for t in times]),
            np.array([self.heading(t) for t in times]),
        )


def swing(axis, rate, t):
    """Derivatives 0..6 of Exp(axis sin(rate t)): dR = R S s', S and s' one-parameter."""
    S = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    s = [rate**k * np.sin(rate * t + k * np.pi / 2) for k in range(ORDER + 1)]
    R = [so3_exp(axis * s[0])]
    for k in range(ORDER - 1):
        R.append(sum(binomial(k, j) * R[j] @ S * s[k - j + 1] for j in range(k + 1)))
    return np.array(R)


def binomial(k, j):
    return float(np.prod(np.arange(k - j + 1, k + 1)) / np.prod(np.arange(1, j + 1)))


def leibniz(A, B):
    return np.array(
        [sum(binomial(k, j) * A[j] @ B[k - j] for j in range(k + 1)) for k in range(ORDER)]
    )


def flat_state(motion, flat, t):
    """The taut state that flatness says the team is in, from outputs at one time."""
    p, R = motion.position(t), motion.attitude(t)
    return TautState(
        p_WL=p[0],
        q_WL=R_to_quat(R[0]),
        v_WL=p[1],
        w_WL_L=flat.w_WL_L,
        cable_dir_W=flat.cable_dir_W[0],
        cable_w_W=flat.cable_w_W,
        q_WB=flat.q_WB,
        w_WB_B=flat.w_WB_B,
    )


CASES = [(1, "point"), (2, "point"), (3, "rigid"), (4, "point"), (4, "rigid"), (8, "rigid")]


@pytest.mark.parametrize(("n", "kind"), CASES)
def test_model_under_the_flat_inputs_accelerates_as_the_motion(rng, make, n, kind):
    team, motion = make.team(rng, n, kind), Motion(rng, n, turns=kind == "rigid")
    for t in (0.0, 0.9, 2.3):
        p, R, yaw = motion.position(t), motion.attitude(t), motion.heading(t)
        flat = flat_outputs(team, p, R, yaw)
        rates = accelerations(team, flat_state(motion, flat, t), flat.wrench)
        np.testing.assert_allclose(rates.a_WL, p[2], atol=1e-9)
        np.testing.assert_allclose(rates.dw_WL_L, flat.dw_WL_L, atol=1e-8)
        np.testing.assert_allclose(rates.cable_dw_W, flat.cable_dw_W, atol=1e-9)
        np.testing.assert_allclose(rates.dw_WB_B, flat.dw_WB_B, atol=1e-8)
        np.testing.assert_allclose(rates.tension, np.linalg.norm(flat.force_W[0], axis=1))


@pytest.mark.parametrize(("n", "kind"), [(3, "rigid"), (4, "rigid"), (3, "point")])
def test_open_loop_flat_inputs_fly_the_motion(rng, make, n, kind):
    team, motion = make.team(rng, n, kind), Motion(rng, n, turns=kind == "rigid")
    dt, steps = 0.002, 250
    times = dt * np.arange(steps + 1)
    middles = flat_outputs(team, *motion.sample(times[:-1] + 0.5 * dt))
    ends = flat_outputs(team, *motion.sample(times[[0, -1]]))
    state = flat_state(motion, type(ends)(*(a[0] for a in ends)), 0.0)
    for wrench in middles.wrench:
        state = step(team, state, wrench, dt)
    np.testing.assert_allclose(state.p_WL, motion.position(times[-1])[0], atol=2e-5)
    np.testing.assert_allclose(quat_to_R(state.q_WL), motion.attitude(times[-1])[0], atol=2e-4)
    np.testing.assert_allclose(state.cable_dir_W, ends.cable_dir_W[1, 0], atol=2e-4)


@pytest.mark.parametrize(("n", "kind"), [(4, "rigid"), (4, "point")])
def test_derivatives_equal_finite_differences(rng, make, n, kind):
    team, motion, h = make.team(rng, n, kind), Motion(rng, n, turns=kind == "rigid"), 1e-4
    before, now, after = (
        flat_outputs(team, motion.position(t), motion.attitude(t), motion.heading(t))
        for t in (0.6 - h, 0.6, 0.6 + h)
    )
    for name in ("force_W", "cable_dir_W", "p_WB"):
        difference = (getattr(after, name) - getattr(before, name)) / (2 * h)
        np.testing.assert_allclose(getattr(now, name)[1:], difference[:-1], atol=2e-6, err_msg=name)
    for value, rate in (("cable_w_W", "cable_dw_W"), ("w_WB_B", "dw_WB_B"), ("w_WL_L", "dw_WL_L")):
        difference = (getattr(after, value) - getattr(before, value)) / (2 * h)
        np.testing.assert_allclose(getattr(now, rate), difference, atol=2e-6, err_msg=rate)
    R = quat_to_R(now.q_WB)
    dR = (quat_to_R(after.q_WB) - quat_to_R(before.q_WB)) / (2 * h)
    S = np.swapaxes(R, -1, -2) @ dR
    body_rate = np.stack([S[:, 2, 1], S[:, 0, 2], S[:, 1, 0]], axis=-1)
    np.testing.assert_allclose(now.w_WB_B, body_rate, atol=1e-6)


def test_series_of_the_outputs_predicts_them_ahead(rng, make):
    team, motion, h = make.team(rng, 4, "rigid"), Motion(rng, 4), 0.02
    now, ahead = (
        flat_outputs(team, motion.position(t), motion.attitude(t), motion.heading(t))
        for t in (1.0, 1.0 + h)
    )
    powers = h ** np.arange(5)
    for name in ("force_W", "cable_dir_W", "p_WB"):
        series = np.tensordot(powers, jet_from_derivatives(getattr(now, name)), axes=1)
        np.testing.assert_allclose(series, getattr(ahead, name)[0], atol=1e-8, err_msg=name)


def test_cable_forces_are_those_of_the_allocation(rng, make):
    team, motion, t = make.team(rng, 4, "rigid"), Motion(rng, 4), 0.4
    p, R = motion.position(t), motion.attitude(t)
    flat, a = flat_outputs(team, p, R, np.zeros((4, 3))), team.arrays()
    force_L = R[0].T @ (a.m_L * (p[2] + [0, 0, a.g]))
    moment = a.J_L * flat.dw_WL_L + np.cross(flat.w_WL_L, a.J_L * flat.w_WL_L)
    expected = formation_forces(team, np.concatenate([force_L, moment])) @ R[0].T
    np.testing.assert_allclose(flat.force_W[0], expected, atol=1e-12)


def test_standing_still_is_hover(rng, make):
    team = make.team(rng, 4, "rigid")
    p, R = np.zeros((7, 3)), np.zeros((7, 3, 3))
    p[0], R[0] = [1.0, 2.0, 3.0], np.eye(3)
    flat, state = flat_outputs(team, p, R, np.zeros((4, 3))), hover_state(team, p[0])
    np.testing.assert_allclose(flat.force_W[0], hover_forces(team), atol=1e-12)
    np.testing.assert_allclose(flat.force_W[1:], 0.0, atol=1e-12)
    np.testing.assert_allclose(flat.q_WB, state.q_WB, atol=1e-12)
    np.testing.assert_allclose(flat.wrench, hover_wrenches(team), atol=1e-12)


def test_lost_cable_leaves_the_load_to_the_others(rng, make):
    team, motion, t = make.team(rng, 5, "rigid"), Motion(rng, 5), 0.7
    active = np.array([True, True, False, True, True])
    p, R = motion.position(t), motion.attitude(t)
    flat = flat_outputs(team, p, R, motion.heading(t), active)
    state = flat_state(motion, flat, t)
    load = np.concatenate([state.p_WL, state.q_WL, state.v_WL, state.w_WL_L])
    acceleration = load_acceleration(team, load, flat.force_W[0])
    np.testing.assert_allclose(acceleration, np.append(p[2], flat.dw_WL_L), atol=1e-9)
    np.testing.assert_array_equal(flat.force_W[:, 2], 0.0)
    assert np.isnan(flat.wrench[2]).all()
    assert np.isfinite(flat.wrench[active]).all()


def test_all_times_at_once_equal_one_by_one(rng, make):
    team, motion = make.team(rng, 4, "rigid"), Motion(rng, 4)
    p, R, yaw = motion.sample([0.1, 0.5, 2.0])
    together = flat_outputs(team, p, R, yaw)
    for k in range(3):
        alone = flat_outputs(team, p[k], R[k], yaw[k])
        for a, b in zip(alone, together, strict=True):
            np.testing.assert_array_equal(a, b[k])


def test_outputs_turn_with_the_world_frame(rng, make):
    team, motion, angle = make.team(rng, 4, "rigid"), Motion(rng, 4), 0.9
    turn = so3_exp(np.array([0.0, 0.0, angle]))
    p, R, yaw = motion.position(0.3), motion.attitude(0.3), motion.heading(0.3)
    here, there = (
        flat_outputs(team, p, R, yaw),
        flat_outputs(team, p @ turn.T, turn @ R, yaw + np.array([angle, 0.0, 0.0])),
    )
    np.testing.assert_allclose(there.force_W, here.force_W @ turn.T, atol=1e-9)
    np.testing.assert_allclose(there.p_WB, here.p_WB @ turn.T, atol=1e-9)
    np.testing.assert_allclose(there.wrench, here.wrench, atol=1e-9)


def test_free_fall_of_a_single_load_is_nan_not_an_error():
    p = np.zeros((7, 3))
    p[2, 2] = -9.81
    flat = flat_outputs(
        Team(count=1, payload=PointPayload()), p, np.zeros((7, 3, 3)), np.zeros((1, 3))
    )
    assert np.isnan(flat.wrench).all()
