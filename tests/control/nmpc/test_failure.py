# SPDX-License-Identifier: Apache-2.0
"""When a solve fails: the last plan, shifted; after its end a safe hover."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.control.api import ControlRequest, SolveStatus
from skyhaul.control.nmpc import Nmpc
from skyhaul.model import PointPayload, Team, hover_forces, load_acceleration
from skyhaul.planning.api import RefSample


class Broken:
    """A reference that gives no numbers."""

    start_us = end_us = 0

    def sample(self, t_us):
        k = len(t_us)
        return RefSample(np.full((k, 7, 3), np.nan), np.full((k, 7, 3, 3), np.nan))


def request_of(team, loop, **changes):
    load = np.zeros(13)
    load[:3], load[3:7], load[7:10] = [1.0, 2.0, 3.0], [0.96, 0.1, -0.1, 0.2], [0.3, 0.0, -0.2]
    load[3:7] /= np.linalg.norm(load[3:7])
    if team.payload.kind == "point":
        load[3:7] = [1.0, 0.0, 0.0, 0.0]
    return ControlRequest(
        **{
            "stamp_us": 0,
            "load": load,
            "force_W": hover_forces(team),
            "dforce_W": np.zeros((team.count, 3)),
            "active": np.ones(team.count, dtype=bool),
            "reference": loop.Rest(p_WD=(1.0, 2.0, 3.0)),
            "world_map": loop.empty_world(team),
        }
        | changes
    )


@pytest.mark.parametrize("team", [Team(), Team(payload=PointPayload())], ids=["rigid", "point"])
def test_without_any_plan_a_failure_means_hover_where_the_load_is(kind, team, limits, loop):
    controller, request = kind().build(team, limits), request_of(team, loop, reference=Broken())
    _, solution = controller.solve(controller.init(), request)
    assert solution.status is SolveStatus.FAILED
    plan = solution.plan
    np.testing.assert_allclose(plan.load[:, :3], np.tile([1.0, 2.0, 3.0], (len(plan.load), 1)))
    np.testing.assert_array_equal(plan.load[:, 7:], 0.0)
    level = plan.load[0]
    np.testing.assert_allclose(load_acceleration(team, level, plan.force_W[0]), 0.0, atol=1e-9)
    assert np.isfinite(plan.gain).all()
    assert np.abs(plan.gain).max() > 0.1
    np.testing.assert_allclose(level[4:6], 0.0, atol=1e-12)  # level, with the present heading


def test_a_failure_flies_the_last_plan_until_its_end(kind, limits, loop):
    team = Team()
    controller, request = kind().build(team, limits), request_of(team, loop)
    memory, good = controller.solve(controller.init(), request)
    broken = replace(request, reference=Broken(), stamp_us=400_000)
    memory, bad = controller.solve(memory, broken)
    assert bad.status is SolveStatus.FAILED
    assert bad.plan is good.plan
    end = replace(broken, stamp_us=good.plan.end_us + 1)
    memory, hover = controller.solve(memory, end)
    assert hover.status is SolveStatus.FAILED
    assert hover.plan.stamp_us == end.stamp_us
    np.testing.assert_array_equal(hover.plan.load[:, 7:], 0.0)
    _, again = controller.solve(memory, replace(request, stamp_us=end.stamp_us))
    assert again.status is SolveStatus.OK


def test_after_a_lost_cable_the_old_plan_is_not_flown_on(limits, loop):
    team = Team(count=5)
    controller, request = Nmpc().build(team, limits), request_of(team, loop)
    memory, _ = controller.solve(controller.init(), request)
    active = np.array([True, False, True, True, True])
    broken = replace(request, reference=Broken(), stamp_us=100_000, active=active)
    _, solution = controller.solve(memory, broken)
    np.testing.assert_allclose(solution.plan.force_W[:, 1], 0.0, atol=1e-12)
    np.testing.assert_array_equal(solution.plan.active, active)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9])
def test_a_hopeless_measurement_is_a_status(kind, value, limits, loop):
    team = Team()
    controller, request = kind().build(team, limits), request_of(team, loop)
    memory, _ = controller.solve(controller.init(), request)
    load = request.load.copy()
    load[8] = value
    _, solution = controller.solve(memory, replace(request, load=load, stamp_us=50_000))
    assert solution.status is SolveStatus.FAILED
    assert np.isfinite(solution.plan.force_W).all()


def test_too_few_iterations_of_the_qp_are_told(limits, loop):
    team = Team()
    controller, request = Nmpc(qp_iterations=2).build(team, limits), request_of(team, loop)
    _, solution = controller.solve(controller.init(), request)
    assert solution.status is SolveStatus.NOT_CONVERGED
    assert solution.kkt_residual > 1e-4
    assert np.isfinite(solution.plan.force_W).all()
