# SPDX-License-Identifier: Apache-2.0
"""Derivatives of every measurement and of the motion against finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.camera import project_points
from skyhaul.geometry.kernels import norm
from skyhaul.geometry.quaternion import quat_conj, quat_log, quat_mul, quat_to_R
from skyhaul.perception.team import cables, layout, motion, sights
from skyhaul.perception.team.api import TeamReports
from skyhaul.perception.team.layout import LOAD_NE, VEHICLE_NE

H = 1e-6


@pytest.fixture(scope="module")
def started(flight):
    """A filter in mid flight: parameters and state."""
    made = flight(2, 1.2)
    estimator = made.estimator()
    memory = estimator.init()
    for reading in made.reports:
        memory, _ = estimator.step(memory, reading)
    s = memory.state
    s.offset[:, :6] = 0.03 * np.random.default_rng(1).standard_normal((4, 6))
    s.taut[:, 0] = 1.0
    return estimator.kernel, s


def moved(s, j, h):
    """The state with error j raised by h."""
    out, dx = layout.copied(s), np.zeros(len(s.P))
    dx[j] = h
    sights.apply(out, dx)
    return out


def slopes(s, value):
    """Derivative of a function of the state by its error, column by column."""
    columns = [(value(moved(s, j, H)) - value(moved(s, j, -H))) / (2 * H) for j in range(len(s.P))]
    return np.array(columns).T


def test_tag_rows_are_the_derivatives_of_the_pixels(started):
    p, s = started
    rows, h = np.empty((8, len(s.P))), np.empty(8)
    t_us = s.load_us[0]

    def pixels(state):
        out = np.empty(8)
        load, vehicle = motion.load_at(p, state, t_us), motion.vehicle_at(p, state, 1, t_us)
        sights.tag_rows(p, load, vehicle, 0.0, 1, out, np.empty_like(rows))
        return out

    load, vehicle = motion.load_at(p, s, t_us), motion.vehicle_at(p, s, 1, t_us)
    assert sights.tag_rows(p, load, vehicle, 0.0, 1, h, rows)
    np.testing.assert_allclose(rows, slopes(s, pixels), atol=2e-3)


def test_tag_corners_are_projected_as_the_camera_does(started, flight):
    p, s = started
    load, vehicle, h = s.load.copy(), motion.in_team_frame(s, 0, s.nav[0]), np.empty(8)
    sights.tag_rows(p, load, vehicle, 0.0, 0, h, np.empty((8, len(s.P))))
    corners = load[:3] + p.corners_L @ quat_to_R(load[3:7]).T
    at = (corners - vehicle[:3]) @ quat_to_R(vehicle[3:7]) - p.p_IC
    down = flight(2, 1.2).sensors.rig.cameras[3].model
    np.testing.assert_allclose(h.reshape(4, 2), project_points(down, at @ p.R_IC)[0], atol=1e-9)


def test_length_and_direction_rows_are_their_derivatives(started):
    p, s = started
    i, N = 2, len(s.P)
    load, vehicle = s.load, motion.in_team_frame(s, i, s.nav[i])
    parts = cables.cable_line(p, load, vehicle, i)
    F0 = cables.force_now(p, s, i)

    def line(state):
        at = motion.in_team_frame(state, i, state.nav[i])
        return np.array(cables.cable_line(p, state.load, at, i)[0])

    rows, r, variance = np.zeros((3, N)), np.zeros(3), np.empty(3)
    cables._length_row(p, load, parts, i, rows, r, variance)
    lengths = slopes(s, lambda x: np.array([np.linalg.norm(line(x))]))
    np.testing.assert_allclose(rows[:1], lengths, atol=1e-6)

    F = cables.unbiased(p, s, i, F0)
    mean = tuple(np.array(parts[0]) / norm(parts[0]))
    cables._direction_rows(p, s, load, parts, mean, F, i, rows, r, variance)

    def gap(state):
        f = np.array(cables.unbiased(p, state, i, F0))
        # the part of what the line lacks across the line, scaled as the rows are
        return line(state) / norm(parts[0]) - f / norm(F)

    across = slopes(s, gap)
    n = np.array(mean)
    np.testing.assert_allclose(
        np.einsum("ki,kj->ij", rows[:2], rows[:2]),
        across.T @ (np.eye(3) - np.outer(n, n)) @ across,
        atol=1e-5,
    )


def test_balance_rows_are_the_derivatives_of_what_is_left_over(started):
    p, s = started
    every = np.ones(4, np.bool_)
    start = layout.copied(s)
    start.load_us[1] = -1e9
    for i in range(4):
        start.balance[i, :3] = cables.force_now(p, s, i)
        start.balance[i, 3] = 1.0
    start.sums[:] = 0.0

    def left(state):
        x = layout.copied(state)
        cables.add_balance(p, x, every)
        return x.sums[:6].copy()

    rows = np.zeros((6, len(s.P)))
    for i in range(4):
        cables._balance_part(p, start, i, rows)
    expected = slopes(start, left)
    columns = [LOAD_NE + VEHICLE_NE * i + c for i in range(4) for c in range(3, 9)]
    np.testing.assert_allclose(rows[:, columns], expected[:, columns], atol=1e-5)


def test_load_transition_is_the_derivative_of_its_motion(started):
    p, s = started
    gyro, accel = np.array([0.3, -0.4, 0.2]), np.array([0.5, -0.2, 9.6])

    def after(state):
        x = layout.copied(state)
        motion.advance_load(p, x, x.load_us[0] + 1e4, tuple(gyro), tuple(accel), 1.0)
        return x

    middle = after(s).load
    n = LOAD_NE
    F = np.empty((n, n))
    for j in range(n):
        ends = []
        for h in (H, -H):
            x = after(moved(s, j, h)).load
            turn = quat_log(quat_mul(quat_conj(middle[3:7]), x[3:7]))
            ends.append(np.concatenate([x[:3] - middle[:3], turn, x[7:] - middle[7:]]))
        F[:, j] = (ends[0] - ends[1]) / (2 * H)
    before = layout.copied(s)
    P0 = before.P.copy()
    motion.advance_load(p, before, s.load_us[0] + 1e4, tuple(gyro), tuple(accel), 1.0)
    Q = before.P[:n, :n] - F @ P0[:n, :n] @ F.T
    d, dt = p.load_noise, 1e-2
    expected = np.repeat(
        [d[1] ** 2 * dt**3 / 3, d[0] ** 2 * dt, d[1] ** 2 * dt, d[2] ** 2 * dt, d[3] ** 2 * dt], 3
    )
    np.testing.assert_allclose(Q, np.diag(expected), atol=2e-9)
    np.testing.assert_allclose(before.P[:n, n:], F @ P0[:n, n:], atol=1e-8)


def test_the_past_of_a_vehicle_is_where_it_was(flight):
    made = flight(3, 0.6)
    estimator = made.estimator()
    memory, states = estimator.init(), []
    for reading in made.reports[:100]:
        memory, _ = estimator.step(memory, reading)
        states.append(memory.state)
    k, s = estimator.kernel, states[48]
    back = motion.vehicle_at(k, s, 0, 2_000.0 * 30)
    np.testing.assert_allclose(
        back[:10], motion.in_team_frame(s, 0, states[30].nav[0])[:10], atol=1e-9
    )


def test_late_odometry_ends_where_timely_odometry_does(flight):
    made = flight(4, 0.8)
    late, held = [], {}
    for k, reading in enumerate(made.reports):
        vehicles = []
        for i, v in enumerate(reading.vehicles):
            if v.vio is not None and k > 60:
                held[k + 20, i] = v.vio
                v = replace(v, vio=None)
            vehicles.append(replace(v, vio=held.pop((k, i), v.vio), tag=None))
        late.append(TeamReports(reading.stamp_us, tuple(vehicles), reading.load_imu))
    ends = []
    for readings in (made.reports, late):
        estimator = made.estimator()
        memory = estimator.init()
        for k in range(383):  # until the late estimate of row 362 has come
            memory, _ = estimator.step(memory, readings[k])
        ends.append(memory.state.nav[1, :10])
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_a_frame_is_forgotten_when_odometry_finds_its_place_again(started):
    p, s0 = started
    s = layout.copied(s0)
    b = LOAD_NE
    s.vio_cov[0] = np.diag(np.full(6, 0.04))
    s.P[b, b] += 0.04
    sure = np.diag(np.full(6, 1e-4))
    motion.take_odometry(p, s, 0, s.vio[0, 3] + 1e5, s.nav[0].copy(), sure)
    np.testing.assert_array_equal(s.offset[0, :6], 0.0)
    np.testing.assert_allclose(s.P[b : b + 6, b : b + 6], sure, atol=1e-7)
    np.testing.assert_array_equal(s.P[:b, b : b + 6], 0.0)


def test_a_yaw_error_turns_the_way_flown(started):
    p, s0 = started
    s = layout.copied(s0)
    s.offset[0, :6] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.01]
    pose = s.nav[0].copy()
    pose[:3] = s.vio[0, :3] + np.array([2.0, 0.0, 0.0])
    motion.take_odometry(p, s, 0, s.vio[0, 3] + 1e5, pose, s.vio_cov[0].copy())
    np.testing.assert_allclose(s.offset[0, :3], [0.0, 0.02, 0.0], atol=1e-12)
