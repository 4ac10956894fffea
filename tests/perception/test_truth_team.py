# SPDX-License-Identifier: Apache-2.0
"""The team's state from perfect readings is the reading, without doubt."""

import numpy as np

from skyhaul.model import Team, cable_state, hover_state, team_state
from skyhaul.perception.team.truth import TruthTeam
from skyhaul.sensors.api import TeamReading


def test_the_estimate_is_the_reading_with_no_covariance():
    team = Team()
    state = team_state(team, hover_state(team, np.array([1.0, 2.0, 3.0])))
    cables = cable_state(team, state, np.full(4, 0.6))
    attached = np.array([True, True, False, True])
    reading = TeamReading(40_000, state, cables, attached, np.full(4, 3.0))
    estimator = TruthTeam()
    memory, estimate = estimator.step(estimator.init(), reading)
    assert memory == ()
    assert estimate.stamp_us == 40_000
    assert estimate.team is state
    assert estimate.cables is cables
    np.testing.assert_array_equal(estimate.attached, attached)
    np.testing.assert_array_equal(estimate.thrust, np.full(4, 3.0))
    np.testing.assert_array_equal(estimate.load_covariance, np.zeros((12, 12)))
