# SPDX-License-Identifier: Apache-2.0
"""Tests of `mission.sensing`: a team flies on what its sensors tell."""

import numpy as np
import pytest

from skyhaul.errors import ConfigError
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.mission.odometers import odometers
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.sensors.api import CameraFrame, ImuReading, VehicleReading
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


@pytest.mark.parametrize("kind", ["ekf", "smoother"])
def test_a_team_hovers_on_its_own_cameras(kind):
    outcome, watch = flown("hover", f"perception.odometry.kind={kind}", "task.duration_s=0.3")
    assert outcome.success, outcome.reason
    assert max(watch.place) < 0.05


def test_odometry_takes_no_look_at_the_truth():
    config = load_config(RunConfig, "hover", (FUSED, "perception.odometry.kind=ekf"))
    own = odometers(config, 0, MujocoPlant(config, 0).truth())
    none = ImuReading(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    readings = [VehicleReading(0, i, none, (), None, None) for i in range(config.team.count)]
    assert own.step(Untouchable(), readings, Untouchable()) == [None] * config.team.count


class Untouchable:
    """Raises at every look."""

    def __getattribute__(self, name):
        raise AssertionError(f"somebody looked at {name}")


def test_an_imu_of_nonsense_costs_its_vehicle_the_odometry_and_nothing_else():
    config = load_config(RunConfig, "hover", (FUSED, "perception.odometry.kind=ekf"))
    own = odometers(config, 0, MujocoPlant(config, 0).truth())
    stamps = np.arange(0, 1_300_000, 2_000)
    for stamp in range(0, 1_300_000, 100_000):
        new = stamps[(stamps > stamp - 100_000) & (stamps <= stamp)]
        bad = ImuReading(new, np.full((len(new), 3), 40.0), np.zeros((len(new), 3)))
        readings = [VehicleReading(stamp, 0, bad, (_black(stamp),), None, None)]
        assert own.step(None, readings, None) == [None]


def _black(stamp_us):
    return CameraFrame(stamp_us, 0, np.zeros((240, 320), np.uint8))


def test_the_same_seed_gives_the_same_estimates():
    a, b = (flown("hover", "time_limit_s=0.3", seed=4)[1].place for _ in range(2))
    assert a == b


def test_a_point_carries_no_tag():
    with pytest.raises(ConfigError, match="kind fused needs a tag"):
        load_config(RunConfig, "hover", (FUSED, "team.payload={kind: point}"))


def test_the_tag_needs_a_camera_that_looks_down():
    with pytest.raises(ConfigError, match=r"camera named down in sensors\.rig, got none"):
        load_config(RunConfig, "hover", (FUSED, "sensors.rig.cameras=[]"))
