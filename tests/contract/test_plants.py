# SPDX-License-Identifier: Apache-2.0
"""What every plant must do. A new one adds one entry to PLANTS."""

import numpy as np
import pytest

from skyhaul.errors import SkyhaulError
from skyhaul.geometry.shapes import Sphere
from skyhaul.model import Team
from skyhaul.plant.api import PLANT_STEP_US
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.world.obstacles import Line, Obstacle
from skyhaul.world.scenario import (
    AirStart,
    GroundStart,
    HoverTask,
    Scenario,
    VehicleDies,
    Wind,
    World,
)

PLANTS = [MujocoPlant]

every_plant = pytest.mark.parametrize("make", PLANTS, ids=lambda p: p.__name__)

BALL = Obstacle(
    name="ball",
    shape=Sphere(radius_m=0.2),
    center_m=(5.0, 5.0, 1.0),
    motion=Line(velocity_mps=(0.5, 0.0, 0.0), length_m=2.0),
)


def scenario(n=4, **more):
    world = World(obstacles=(BALL,), wind=Wind(turbulence_mps=0.3))
    start = AirStart(payload_m=(5.0, 5.0, 5.0))
    return Scenario(**{"team": Team(count=n), "world": world, "start": start,
                       "task": HoverTask()} | more)  # fmt: skip


def fly(plant, steps, command=None):
    command = plant.truth().rotor_thrust if command is None else command
    return [plant.step(command) for _ in range(steps)]


@every_plant
def test_each_step_is_two_milliseconds_and_the_truth_is_that_of_now(make):
    plant = make(scenario(), 0)
    assert plant.truth().stamp_us == 0
    truths = fly(plant, 5)
    assert [t.stamp_us for t in truths] == [PLANT_STEP_US * k for k in range(1, 6)]
    assert plant.truth() is truths[-1]


@every_plant
@pytest.mark.parametrize("n", [1, 3, 8])
def test_rows_are_those_of_the_team_and_of_the_world(make, n):
    truth = make(scenario(n), 0).truth()
    assert truth.team.n == n
    assert truth.rotor_thrust.shape == (n, 4)
    assert truth.accel_W.shape == (1 + n, 3)
    assert truth.cables.dir_W.shape == (n, 3)
    assert len(truth.obstacles.kind) == len(truth.present) == len(truth.v_WO) == 1


@every_plant
def test_same_seed_and_commands_same_truth_and_another_seed_another(make):
    ends = [fly(make(scenario(), seed), 50)[-1] for seed in (3, 3, 4)]
    np.testing.assert_array_equal(ends[0].team.load, ends[1].team.load)
    np.testing.assert_array_equal(ends[0].team.p_WB, ends[1].team.p_WB)
    np.testing.assert_array_equal(ends[0].obstacles.p_WO, ends[1].obstacles.p_WO)
    assert not np.array_equal(ends[0].wind_W, ends[2].wind_W)
    assert not np.array_equal(ends[0].obstacles.p_WO, ends[2].obstacles.p_WO)


@every_plant
def test_a_truth_is_a_record_that_later_steps_do_not_change(make):
    plant = make(scenario(), 0)
    first = plant.truth()
    load, p_WO, thrust = first.team.load, first.obstacles.p_WO.copy(), first.rotor_thrust.copy()
    fly(plant, 50, np.full((4, 4), 1.0))
    np.testing.assert_array_equal(first.team.load, load)
    np.testing.assert_array_equal(first.obstacles.p_WO, p_WO)
    np.testing.assert_array_equal(first.rotor_thrust, thrust)


@every_plant
def test_cables_are_never_longer_than_they_are_and_pull_only_when_taut(make):
    plant = make(scenario(), 0)
    for t in fly(plant, 300, np.zeros((4, 4))):  # everything falls, cables go slack
        assert np.all(t.cables.length <= 1.0 + 0.02)
        assert np.all(t.cables.tension >= 0.0)
        slack = t.cables.length < 1.0 - 0.02
        np.testing.assert_array_equal(t.cables.tension[slack], 0.0)


@every_plant
def test_rotors_give_what_they_can_and_lag(make):
    plant, limit = make(scenario(), 0), Team().vehicle.thrust_max_n / 4
    first = plant.truth().rotor_thrust
    truths = fly(plant, 200, np.full((4, 4), 99.0))
    assert np.all(truths[0].rotor_thrust < 0.5 * (first + limit))
    np.testing.assert_allclose(truths[-1].rotor_thrust, limit, rtol=1e-3)


@every_plant
def test_a_released_hook_carries_nothing_any_more(make):
    plant = make(scenario(), 0)
    plant.release_hook(2)
    truth = fly(plant, 5)[-1]
    np.testing.assert_array_equal(truth.attached, [True, True, False, True])
    assert truth.cables.tension[2] == 0.0


@every_plant
def test_a_hook_closes_only_where_its_cable_ends(make):
    plant = make(scenario(start=GroundStart(payload_m=(8.0, 8.0))), 0)
    plant.release_hook(2)
    assert not fly(plant, 1)[-1].attached[2]
    assert plant.attach_hook(2)  # the cable is slack
    assert fly(plant, 1)[-1].attached.all()
    plant.release_hook(2)
    up = np.zeros((4, 4))
    up[2] = 1.06
    assert fly(plant, 500, up)[-1].cables.length[2] > 1.1
    assert not plant.attach_hook(2)
    assert not fly(plant, 1)[-1].attached[2]


@every_plant
def test_a_dead_vehicle_stays_dead(make):
    plant = make(scenario(events=(VehicleDies(vehicle=1, at_s=0.05),)), 0)
    truths = fly(plant, 250)
    alive = [bool(t.alive[1]) for t in truths]
    assert alive.index(False) == pytest.approx(25, abs=2)
    assert not any(alive[alive.index(False) :])
    assert truths[-1].rotor_thrust[1].max() < 1e-3
    assert truths[-1].alive[[0, 2, 3]].all()


@every_plant
def test_contacts_are_told_once_when_they_begin(make):
    plant = make(scenario(), 0)
    truths = fly(plant, 900, np.zeros((4, 4)))  # down to the floor
    landed = [(c.body_a, c.body_b) for t in truths for c in t.contacts]
    assert ("payload", "room") in landed
    for t in truths:
        assert all(c.stamp_us == t.stamp_us for c in t.contacts)


@every_plant
def test_a_command_of_another_team_is_refused(make):
    with pytest.raises(SkyhaulError, match=r"rotor_cmd must have shape \(4, 4\), got \(3, 4\)"):
        make(scenario(), 0).step(np.zeros((3, 4)))
