# SPDX-License-Identifier: Apache-2.0
"""Tests of `mission.sensing`: a team flies on what its sensors tell."""

import numpy as np
import pytest

from skyhaul.errors import ConfigError
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.world.load import load_config

FUSED = "perception.team.kind=fused"


class Watch:
    """A recorder that keeps the errors of the load's place and of the tensions."""

    def __init__(self):
        self.place, self.pull = [], []

    def tick(self, tick):
        estimate, truth = tick.estimate, tick.truth
        self.place.append(np.linalg.norm(estimate.team.p_WL - truth.team.p_WL))
        self.pull.append(estimate.cables.tension - truth.cables.tension)

    def __getattr__(self, name):
        return lambda *args: None


def flown(scenario, *entries, seed=0):
    watch = Watch()
    return fly(load_config(RunConfig, scenario, (FUSED, *entries)), seed, watch), watch


def test_a_team_hovers_on_its_own_estimates():
    outcome, watch = flown("hover", "task.duration_s=1")
    assert outcome.success, outcome.reason
    assert max(watch.place) < 0.03
    assert np.sqrt(np.mean(np.square(watch.pull))) < 0.05


def test_the_same_seed_gives_the_same_estimates():
    a, b = (flown("hover", "time_limit_s=0.3", seed=4)[1].place for _ in range(2))
    assert a == b


def test_a_point_carries_no_tag():
    with pytest.raises(ConfigError, match="kind fused needs a tag"):
        load_config(RunConfig, "hover", (FUSED, "team.payload={kind: point}"))


def test_the_tag_needs_a_camera_that_looks_down():
    with pytest.raises(ConfigError, match=r"camera named down in sensors\.rig, got none"):
        load_config(RunConfig, "hover", (FUSED, "sensors.rig.cameras=[]"))
