# SPDX-License-Identifier: Apache-2.0
"""What every estimator of the team's state must do. A new one adds one entry to ESTIMATORS."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from skyhaul.model import Team, cable_state, hover_state, team_state
from skyhaul.perception.team.api import SurveyedTeam, TeamReports, VehicleReport
from skyhaul.perception.team.fused import FusedTeam
from skyhaul.perception.team.truth import TruthTeam
from skyhaul.perception.vio.api import NavState, VioEstimate, VioStatus
from skyhaul.sensors.api import ImuReading, TeamReading
from skyhaul.sensors.config import SensorsConfig
from skyhaul.types import GRAVITY_MPS2

RISE_MPS = 0.1
UP = np.array([[0.0, 0.0, GRAVITY_MPS2]])


def state_of(k, n):
    team = Team(count=n)
    state = hover_state(team, np.array([1.0, 2.0, 3.0 + 2e-3 * RISE_MPS * k]))
    return team, team_state(team, state)


def attached_of(k, n):
    return np.arange(n) != (1 if k >= 5 else -1)


def truth_reading(k, n=4):
    """Reading k of a team that rises, cable 1 released from reading 5 on."""
    (team, state), attached = state_of(k, n), attached_of(k, n)
    cables = cable_state(team, state, 0.6 * attached)
    return TeamReading(2_000 * k, state, cables, attached, np.full(n, 3.0))


def sensed_reading(k, n=4):
    """The same of real sensors: samples of IMUs, odometry in the first tick."""
    (_, state), attached, reports = state_of(k, n), attached_of(k, n), []
    imu = ImuReading(np.array([2_000 * k - 1_000]), np.zeros((1, 3)), UP.copy())
    arm = SensorsConfig().imu.calibration().p_BI
    for i in range(n):
        pose = NavState(
            state.p_WB[i] + arm, state.q_WB[i], np.array([0.0, 0.0, RISE_MPS]),
            np.zeros(3), np.zeros(3),
        )  # fmt: skip
        odometry = VioEstimate(0, VioStatus.TRACKING, pose, 1e-6 * np.eye(15), 20, 0)
        first = odometry if k == 0 else None
        reports.append(VehicleReport(imu, first, None, 3.0, bool(attached[i])))
    return TeamReports(2_000 * k, tuple(reports), imu)


@cache
def fused(n):
    team, state = state_of(0, n)
    sensors = SensorsConfig()
    start = SurveyedTeam(state.p_WL, state.q_WL, state.p_WB, state.q_WB)
    imu = sensors.payload_imu.calibration()
    return FusedTeam().build(team, sensors.calibration(), imu, sensors.tag(team), start)


ESTIMATORS = [
    SimpleNamespace(kind="truth", of=lambda n: TruthTeam(), reading=truth_reading),
    SimpleNamespace(kind="fused", of=fused, reading=sensed_reading),
]

every_estimator = pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: e.kind)


def follow(estimator, n=4, steps=10):
    kind = estimator.of(n)
    memory, out = kind.init(), []
    for k in range(steps):
        memory, estimate = kind.step(memory, estimator.reading(k, n))
        out.append(estimate)
    return out


@every_estimator
@pytest.mark.parametrize("n", [3, 4, 8])
def test_there_is_an_estimate_of_every_vehicle_from_the_first_reading_on(estimator, n):
    first = follow(estimator, n, 1)[0]
    assert first.team.n == n
    assert first.cables.tension.shape == first.attached.shape == first.thrust.shape == (n,)


@every_estimator
def test_the_stamp_is_the_time_of_measurement(estimator):
    assert [e.stamp_us for e in follow(estimator)] == [2_000 * k for k in range(10)]


@every_estimator
def test_cables_are_unit_vectors_and_attitudes_unit_quaternions(estimator):
    for e in follow(estimator):
        np.testing.assert_allclose(np.linalg.norm(e.cables.dir_W, axis=1), 1.0)
        np.testing.assert_allclose(np.linalg.norm(e.team.q_WB, axis=1), 1.0)
        assert np.linalg.norm(e.team.q_WL) == pytest.approx(1.0)


@every_estimator
def test_the_covariance_is_symmetric_and_not_negative(estimator):
    for e in follow(estimator):
        np.testing.assert_array_equal(e.load_covariance, e.load_covariance.T)
        assert np.linalg.eigvalsh(e.load_covariance).min() >= -1e-12


@every_estimator
def test_a_released_cable_is_reported(estimator):
    assert [bool(e.attached[1]) for e in follow(estimator)] == [True] * 5 + [False] * 5


@every_estimator
def test_steps_are_pure(estimator):
    kind = estimator.of(4)
    memory = kind.init()
    for k in range(4):
        memory, _ = kind.step(memory, estimator.reading(k))
    a, b = (kind.step(memory, estimator.reading(4))[1] for _ in range(2))
    np.testing.assert_array_equal(a.team.load, b.team.load)
    np.testing.assert_array_equal(a.load_covariance, b.load_covariance)


@every_estimator
def test_what_is_handed_on_cannot_be_written_to(estimator):
    estimate = follow(estimator, steps=1)[0]
    with pytest.raises(ValueError, match="read-only"):
        estimate.load_covariance[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        estimate.attached[0] = False
