# SPDX-License-Identifier: Apache-2.0
"""What every payload controller must do. A new one adds one entry to CONTROLLERS."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.control.api import ControlRequest, SolveStatus
from skyhaul.control.force_plan import sample_plan
from skyhaul.control.geometric import Geometric
from skyhaul.control.nmpc import Nmpc, WrenchNmpc
from skyhaul.mapping.api import OccupancyGrid
from skyhaul.mapping.mapper import static_map
from skyhaul.model import PointPayload, Team, hover_forces, load_acceleration
from skyhaul.model.envelope import team_shape
from skyhaul.planning.api import RefSample
from skyhaul.world.scenario import Limits

CONTROLLERS = [Nmpc(), WrenchNmpc(), Geometric()]
TEAMS = {"four": Team(), "three": Team(count=3), "point": Team(payload=PointPayload())}

every_controller = pytest.mark.parametrize("params", CONTROLLERS, ids=lambda p: p.kind)
every_team = pytest.mark.parametrize("team", TEAMS.values(), ids=TEAMS.keys())


class Sway:
    """A smooth sway along x about a place; a `Reference`."""

    start_us, end_us = 0, 10**9

    def __init__(self, amplitude_m=0.0):
        self.amplitude_m = amplitude_m

    def sample(self, t_us):
        t, w = 1e-6 * np.atleast_1d(t_us).astype(float), 0.8
        p, R = np.zeros((len(t), 7, 3)), np.zeros((len(t), 7, 3, 3))
        for k in range(7):
            p[:, k, 0] = self.amplitude_m * w**k * np.sin(w * t + 0.5 * np.pi * k)
        p[:, 0, 2] = 2.0
        R[:, 0] = np.eye(3)
        return RefSample(p, R)


def free_world(team):
    occupied = np.zeros((40, 40, 40), dtype=bool)
    return static_map(OccupancyGrid(occupied, np.full(3, -10.0), 0.5), team_shape(team, 0.1))


def request_of(team, **changes):
    load = np.zeros(13)
    load[2], load[3] = 2.0, 1.0
    return ControlRequest(
        **{
            "stamp_us": 1_000_000,
            "load": load,
            "force_W": hover_forces(team),
            "dforce_W": np.zeros((team.count, 3)),
            "active": np.ones(team.count, dtype=bool),
            "reference": Sway(),
            "world_map": free_world(team),
        }
        | changes
    )


def solve(params, request, team):
    controller = params.build(team, Limits())
    return controller.solve(controller.init(), request)[1]


@every_controller
@every_team
def test_arrays_have_the_shapes_of_the_plan_and_cannot_be_written(params, team):
    plan = solve(params, request_of(team), team).plan
    K, n = len(plan.node_s), team.count
    assert plan.load.shape == (K, 13)
    assert plan.accel_W.shape == (K, 3)
    assert plan.force_W.shape == plan.dforce_W.shape == (K, n, 3)
    assert plan.gain.shape == (K, n, 3, 12)
    assert plan.thrust.shape == (K, n)
    assert plan.node_s[0] == 0.0
    assert np.diff(plan.node_s).min() > 0.0
    assert not any(a.flags.writeable for a in (plan.load, plan.force_W, plan.gain))


@every_controller
@every_team
def test_a_plan_starts_now_and_reaches_two_seconds(params, team):
    request = request_of(team)
    plan = solve(params, request, team).plan
    assert plan.stamp_us == request.stamp_us
    assert plan.end_us - plan.stamp_us >= 2_000_000


@every_controller
@every_team
def test_at_rest_the_forces_hold_the_load(params, team):
    solution = solve(params, request_of(team), team)
    assert solution.status is SolveStatus.OK
    plan = solution.plan
    for k in range(len(plan.node_s)):
        accel = load_acceleration(team, plan.load[k], plan.force_W[k])
        np.testing.assert_allclose(accel[:3], 0.0, atol=0.01)
        np.testing.assert_allclose(plan.load[k, :3], [0.0, 0.0, 2.0], atol=0.002)


@every_controller
@every_team
def test_planned_acceleration_is_that_of_the_planned_forces(params, team):
    start = Sway(0.5).sample(np.array([1_000_000])).p_WD[0]
    load = np.zeros(13)
    load[:3], load[3], load[7:10] = start[0], 1.0, start[1]
    plan = solve(params, request_of(team, reference=Sway(0.5), load=load), team).plan
    for k in range(len(plan.node_s)):
        accel = load_acceleration(team, plan.load[k], plan.force_W[k])[:3]
        np.testing.assert_allclose(plan.accel_W[k], accel, atol=1e-9)


@every_controller
@every_team
def test_rates_are_those_of_the_forces_between_the_nodes(params, team):
    plan = solve(params, request_of(team, reference=Sway(0.3)), team).plan
    for k in range(1, len(plan.node_s) - 1):
        t = plan.stamp_us + round(1e6 * float(plan.node_s[k]))
        h = 2_000
        slope = (sample_plan(plan, t + h).force_W - sample_plan(plan, t - h).force_W) / (2e-6 * h)
        np.testing.assert_allclose(plan.dforce_W[k], slope, atol=0.05)


@every_controller
@every_team
def test_feedback_pushes_back(params, team):
    """A shove or a turn meets a wrench against it, at every node."""
    plan = solve(params, request_of(team), team).plan
    for k in range(len(plan.node_s)):
        force = plan.gain[k].sum(axis=0)
        assert np.linalg.eigvalsh(force[:, :3] + force[:, :3].T).max() < 0.0
        assert np.linalg.eigvalsh(force[:, 6:9] + force[:, 6:9].T).max() < 0.0
        if team.payload.kind == "rigid":
            moment = np.cross(team.hooks_L()[:, None], plan.gain[k].transpose(0, 2, 1)).sum(axis=0)
            spin = moment[9:].T
            assert np.linalg.eigvalsh(spin + spin.T).max() < 0.0


@every_controller
def test_a_lost_cable_carries_nothing(params):
    team = Team(count=5)
    active = np.array([True, True, True, False, True])
    request = request_of(team, active=active, force_W=hover_forces(team, active))
    plan = solve(params, request, team).plan
    np.testing.assert_allclose(plan.force_W[:, 3], 0.0, atol=1e-12)
    np.testing.assert_array_equal(plan.gain[:, 3], 0.0)
    np.testing.assert_array_equal(plan.thrust[:, 3], 0.0)
    np.testing.assert_array_equal(plan.active, active)


@every_controller
def test_same_inputs_give_the_same_plan(params):
    team = Team()
    request = request_of(team, reference=Sway(0.5))
    controller = params.build(team, Limits())
    memory, _ = controller.solve(controller.init(), request)
    later = replace(request, stamp_us=1_200_000)
    (_, a), (_, b) = controller.solve(memory, later), controller.solve(memory, later)
    np.testing.assert_array_equal(a.plan.force_W, b.plan.force_W)
    np.testing.assert_array_equal(a.plan.gain, b.plan.gain)


@every_controller
@every_team
def test_evidence_comes_with_the_plan(params, team):
    solution = solve(params, request_of(team), team)
    assert solution.wall_ms > 0.0
    assert solution.slack_m == 0.0
    assert 0.0 <= solution.kkt_residual < 1e-3
    assert solution.iterations >= 0
