# SPDX-License-Identifier: Apache-2.0
"""Tests of `mission.looking`: where a flight's obstacles come from."""

import numpy as np
import pytest

from skyhaul.errors import ConfigError
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.mission.looking import OBSTACLE_PERIOD_US, CameraLook, PerfectLook, obstacle_look
from skyhaul.mission.sensing import PerfectSensing
from skyhaul.mission.stopwatch import Stopwatch
from skyhaul.perception.team.truth import TruthTeam
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.sensors.api import CameraFrame, ImuReading, VehicleReading
from skyhaul.world.load import load_config

SEEING = ("perception.team.kind=fused", "perception.obstacles.kind=cameras")
NO_IMU = ImuReading(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
GREY = np.full((240, 320), 120, np.uint8)


class Untouchable:
    def __getattr__(self, name):
        raise AssertionError(f"{name} of the truth was looked at")


def reading(vehicle, *frames):
    images = tuple(CameraFrame(t_us, camera, GREY) for camera, t_us in frames)
    return VehicleReading(0, vehicle, NO_IMU, images, None, None)


@pytest.fixture(scope="module")
def config():
    return load_config(RunConfig, "hover", SEEING)


@pytest.fixture(scope="module")
def estimate(config):
    truth = MujocoPlant(config, 0).truth()
    return PerfectSensing(config, TruthTeam()).estimate(truth)


def test_cameras_take_no_look_at_the_truth(config, estimate):
    look = obstacle_look(config, Stopwatch())
    obstacles = look.look(Untouchable(), estimate, [reading(0, (0, 0), (1, 0))])
    assert obstacles.stamp_us == estimate.stamp_us
    assert (obstacles.statics, obstacles.tracks) == ((), ())
    assert not obstacles.voxels.occupied.any()


def test_a_pair_counts_only_with_both_images_of_one_time(config, estimate):
    look = obstacle_look(config, Stopwatch())
    readings = [
        reading(0, (0, 0), (1, 0)), reading(1, (0, 0)), reading(2, (0, 0), (1, 4_000)), reading(3)
    ]  # fmt: skip
    assert [v.vehicle for v in look._views(estimate, readings)] == [0]


def test_the_configuration_says_who_looks(config):
    assert isinstance(obstacle_look(config, Stopwatch()), CameraLook)
    exact = load_config(RunConfig, "hover")
    assert isinstance(obstacle_look(exact, Stopwatch()), PerfectLook)


def test_perfect_obstacles_come_every_20_ms():
    config = load_config(RunConfig, "crossing")
    truth = MujocoPlant(config, 0).truth()
    look = obstacle_look(config, Stopwatch())
    estimate = PerfectSensing(config, TruthTeam()).estimate(truth)
    assert look.look(truth, estimate, ()).stamp_us == truth.stamp_us == 0
    assert OBSTACLE_PERIOD_US == 20_000


@pytest.mark.parametrize(
    ("scenario", "entries", "what"),
    [
        ("hover", SEEING[1:], "needs perception.team of kind fused"),
        ("paper-metres", SEEING, "needs a map that stays"),
    ],
)
def test_what_cameras_need_is_said_before_the_flight(scenario, entries, what):
    with pytest.raises(ConfigError, match=what):
        load_config(RunConfig, scenario, entries)


def test_a_team_that_sees_hovers_and_its_map_stays_empty():
    class Maps:
        last = None

        def map(self, world_map):
            self.last = world_map

        def __getattr__(self, name):
            return lambda *args: None

    maps = Maps()
    config = load_config(RunConfig, "hover", (*SEEING, "task.duration_s=1"))
    outcome = fly(config, 0, maps)
    assert outcome.success, outcome.reason
    assert outcome.cpu_s["scene"] > 0.0
    assert not maps.last.grid.occupied.any()
    assert maps.last.tracks == ()
