# SPDX-License-Identifier: Apache-2.0
"""Tests of `mission.odometry`: errors are as large as the covariance says, and none when asked."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_conj, quat_log, quat_mul, quat_rotate
from skyhaul.mission.odometry import ModelledOdometry, without_errors
from skyhaul.model import Team, hover_state, team_state
from skyhaul.model.convert import cable_state
from skyhaul.plant.api import Truth
from skyhaul.sensors.imu import Imu
from skyhaul.world.load import load_config
from skyhaul.world.motion import obstacle_field
from skyhaul.world.scenario import Scenario

IMU = Imu().calibration()
BIAS = np.array([1e-3, -2e-3, 1e-3, 0.02, -0.03, 0.01])


@pytest.fixture(scope="module")
def way():
    """True states of a team that flies along a bent way, 0.1 s apart."""
    field = obstacle_field(load_config(Scenario, "hover").world, 0, None)
    team, out = Team(), []
    for k in range(60):
        s = hover_state(team, np.array([0.1 * k, 2.0 * np.sin(0.05 * k), 1.0]))
        state = team_state(team, s)
        out.append(
            Truth(
                stamp_us=100_000 * k, team=state, cables=cable_state(team, state, np.zeros(4)),
                attached=np.ones(4, np.bool_), alive=np.ones(4, np.bool_),
                rotor_thrust=np.ones((4, 4)), accel_W=np.zeros((5, 3)),
                obstacles=field.shapes_at(0), v_WO=field.velocities_at(0),
                present=np.zeros(0, np.bool_), wind_W=np.zeros(3), clearance_m=np.inf,
                contacts=(),
            )
        )  # fmt: skip
    return out


def last(model, way, seed):
    memory, estimate = model.init(seed, 0, 4), None
    for truth in way:
        memory, estimate = model.step(memory, truth, IMU, BIAS)
    return estimate


def error(estimate, truth):
    """Of position and attitude, (6,), layout of the covariance."""
    q, x = truth.team.q_WB[0], estimate.state
    p = truth.team.p_WB[0] + quat_rotate(q, IMU.p_BI)
    return np.concatenate([p - x.p_WI, quat_log(quat_mul(quat_conj(x.q_WI), q))])


def test_errors_are_as_large_as_the_covariance_says(way):
    model, nees = ModelledOdometry(), []
    for seed in range(200):
        estimate = last(model, way, seed)
        e = error(estimate, way[-1])
        nees.append(e @ np.linalg.solve(estimate.covariance[:6, :6], e))
    assert np.mean(nees) == pytest.approx(6.0, abs=4 * np.sqrt(12 / 200))


def test_without_errors_it_is_the_truth(way):
    estimate = last(without_errors(ModelledOdometry()), way, 3)
    np.testing.assert_allclose(error(estimate, way[-1]), 0.0, atol=1e-12)
    np.testing.assert_array_equal(estimate.state.gyro_bias, BIAS[:3])


def test_the_same_seed_gives_the_same_bytes_and_steps_are_pure(way):
    model = ModelledOdometry()
    a, b = last(model, way, 5), last(model, way, 5)
    np.testing.assert_array_equal(a.state.p_WI, b.state.p_WI)
    memory = model.init(5, 0, 4)
    first, again = (model.step(memory, way[0], IMU, BIAS)[1] for _ in range(2))
    np.testing.assert_array_equal(first.state.q_WI, again.state.q_WI)
    assert not np.array_equal(a.state.p_WI, last(model, way, 6).state.p_WI)


def test_vehicles_speak_in_turn_ten_times_a_second(way):
    model = ModelledOdometry()
    for vehicle in range(4):
        memory, spoken = model.init(0, vehicle, 4), []
        for k in range(100):
            memory, estimate = model.step(memory, replace(way[0], stamp_us=2_000 * k), IMU, BIAS)
            spoken += [k] if estimate is not None else []
        assert spoken == [12 * vehicle + vehicle // 2, 50 + 12 * vehicle + vehicle // 2]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rate_hz": 7}, "rate_hz must divide 500, got 7"),
        ({"tilt_time_s": 0.0}, "tilt_time_s and velocity_time_s must be > 0"),
        ({"jitter_m": -1.0}, "jitter_m must be >= 0, got -1"),
    ],
)
def test_numbers_out_of_range_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        ModelledOdometry(**changes)
