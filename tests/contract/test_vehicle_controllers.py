# SPDX-License-Identifier: Apache-2.0
"""What every vehicle controller must do. A new one adds one entry to CONTROLLERS."""

import numpy as np
import pytest

from skyhaul.control.api import ForcePlan
from skyhaul.control.vehicle import CableTracking
from skyhaul.model import (
    PointPayload,
    Team,
    cable_state,
    hover_forces,
    hover_state,
    hover_wrenches,
    team_state,
)
from skyhaul.perception.api import TeamEstimate

CONTROLLERS = [CableTracking()]
TEAMS = [Team(count=3), Team(), Team(count=8), Team(count=3, payload=PointPayload())]

every_controller = pytest.mark.parametrize("params", CONTROLLERS, ids=lambda p: p.kind)
every_team = pytest.mark.parametrize("team", TEAMS, ids=lambda t: f"{t.count}-{t.payload.kind}")

PLACE = np.array([0.0, 0.0, 2.0])


def hover_plan(team: Team, active=None) -> ForcePlan:
    n = team.count
    load = np.zeros((2, 13))
    load[:, :3], load[:, 3] = PLACE, 1.0
    force = np.tile(hover_forces(team), (2, 1, 1))
    return ForcePlan(
        stamp_us=0,
        node_s=np.array([0.0, 1.0]),
        load=load,
        accel_W=np.zeros((2, 3)),
        force_W=force,
        dforce_W=np.zeros((2, n, 3)),
        gain=np.zeros((2, n, 3, 12)),
        thrust=np.tile(hover_wrenches(team)[:, 0], (2, 1)),
        active=np.ones(n, dtype=bool) if active is None else active,
    )


def hovering(team: Team, stamp_us: int = 0) -> TeamEstimate:
    state = hover_state(team, PLACE)
    bodies = team_state(team, state)
    tension = np.linalg.norm(hover_forces(team), axis=1)
    return TeamEstimate(
        stamp_us=stamp_us,
        team=bodies,
        cables=cable_state(team, bodies, tension),
        attached=np.ones(team.count, dtype=bool),
        thrust=hover_wrenches(team)[:, 0],
        load_covariance=np.zeros((12, 12)),
    )


def fly(params, team, plan, ticks=1):
    n, controller = team.count, params.build(team)
    memory = controller.init(n)
    for k in range(ticks):
        memory, command = controller.step(memory, hovering(team, 2000 * k), plan, np.zeros(n))
    return command


@every_controller
@every_team
def test_hover_is_held(params, team):
    command = fly(params, team, hover_plan(team), ticks=5)
    np.testing.assert_allclose(command.thrust, hover_wrenches(team)[:, 0], rtol=1e-3)
    np.testing.assert_allclose(command.moment_B, 0.0, atol=1e-4)
    np.testing.assert_allclose(command.force_W, hover_forces(team), atol=1e-6)
    np.testing.assert_allclose(command.dforce_W, 0.0, atol=1e-6)


@every_controller
@every_team
def test_commands_have_the_teams_shape(params, team):
    n, command = team.count, fly(params, team, hover_plan(team))
    shapes = [command.thrust.shape, command.moment_B.shape, command.force_W.shape]
    assert shapes == [(n,), (n, 3), (n, 3)]
    assert command.rotor_cmd.shape in ((n, 4), (0, 4))


@every_controller
@every_team
def test_same_inputs_give_the_same_commands(params, team):
    a, b = (fly(params, team, hover_plan(team), ticks=3) for _ in range(2))
    np.testing.assert_array_equal(a.thrust, b.thrust)
    np.testing.assert_array_equal(a.moment_B, b.moment_B)


@every_controller
def test_a_cable_out_of_the_plan_is_not_pulled(params):
    team = Team(count=5)
    active = np.array([True, True, True, False, True])
    command = fly(params, team, hover_plan(team, active), ticks=3)
    assert np.all(np.isfinite(command.moment_B))
    assert command.thrust[3] == pytest.approx(team.vehicle.mass_kg * 9.81, rel=0.05)


@every_controller
def test_a_plan_that_has_ended_is_held(params):
    team = Team()
    controller, plan = params.build(team), hover_plan(team)
    late = hovering(team, 60_000_000)
    _, command = controller.step(controller.init(4), late, plan, np.zeros(4))
    np.testing.assert_allclose(command.thrust, hover_wrenches(team)[:, 0], rtol=1e-3)
