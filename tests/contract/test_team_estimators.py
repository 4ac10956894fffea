# SPDX-License-Identifier: Apache-2.0
"""What every estimator of the team's state must do. A new one adds one entry to ESTIMATORS."""

import numpy as np
import pytest

from skyhaul.model import Team, cable_state, hover_state, team_state
from skyhaul.perception.team.truth import TruthTeam
from skyhaul.sensors.api import TeamReading

ESTIMATORS = [TruthTeam()]

every_estimator = pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: e.kind)


def reading(k, n=4):
    """Reading k of a team that rises at 0.1 m/s, cable 1 released from reading 5 on."""
    team, t_us = Team(count=n), 2_000 * k
    state = team_state(team, hover_state(team, np.array([1.0, 2.0, 3.0 + 1e-7 * t_us])))
    attached = np.arange(n) != (1 if k >= 5 else -1)
    cables = cable_state(team, state, 0.6 * attached)
    return TeamReading(t_us, state, cables, attached, np.full(n, 3.0))


def follow(estimator, n=4, steps=10):
    memory, out = estimator.init(), []
    for k in range(steps):
        memory, estimate = estimator.step(memory, reading(k, n))
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
    memory = estimator.init()
    for k in range(4):
        memory, _ = estimator.step(memory, reading(k))
    a, b = (estimator.step(memory, reading(4))[1] for _ in range(2))
    np.testing.assert_array_equal(a.team.load, b.team.load)
    np.testing.assert_array_equal(a.load_covariance, b.load_covariance)


@every_estimator
def test_what_is_handed_on_cannot_be_written_to(estimator):
    estimate = follow(estimator, steps=1)[0]
    with pytest.raises(ValueError, match="read-only"):
        estimate.load_covariance[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        estimate.attached[0] = False
