# SPDX-License-Identifier: Apache-2.0
"""One solve: optimality, limits, reference forces, warm start, plans."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

from skyhaul.control.api import ControlRequest, SolveStatus
from skyhaul.control.force_plan import sample_plan
from skyhaul.control.nmpc import Nmpc
from skyhaul.control.nmpc.sqp import step_size
from skyhaul.model import (
    PointPayload,
    RigidPayload,
    Team,
    flat_outputs,
    hover_forces,
    load_acceleration,
)
from skyhaul.world.scenario import Limits

TEAM = Team()


def make_request(team, reference, world, load=None, t_us=0, **changes):
    start = reference.sample(np.array([t_us]))
    x = np.zeros(13)
    x[:3], x[3], x[7:10] = start.p_WD[0, 0], 1.0, start.p_WD[0, 1]
    return ControlRequest(
        **{
            "stamp_us": t_us,
            "load": x if load is None else load,
            "force_W": hover_forces(team),
            "dforce_W": np.zeros((team.count, 3)),
            "active": np.ones(team.count, dtype=bool),
            "reference": reference,
            "world_map": world,
            "sqp_iterations": 3,
        }
        | changes
    )


TEAMS = {f"n{n}": Team(count=n) for n in range(3, 9)}
TEAMS["point"] = Team(payload=PointPayload())
TEAMS["heavy"] = Team(payload=RigidPayload(mass_kg=0.5))


@pytest.mark.parametrize("team", TEAMS.values(), ids=TEAMS.keys())
def test_rest_is_kept_with_the_forces_of_hover(kind, team, limits, loop):
    controller = kind().build(team, limits)
    request = make_request(team, loop.Rest(), loop.empty_world(team))
    _, solution = controller.solve(controller.init(), request)
    assert solution.status is SolveStatus.OK
    nodes = len(solution.plan.node_s)
    np.testing.assert_allclose(solution.plan.load, np.tile(request.load, (nodes, 1)), atol=1e-4)
    wanted = np.broadcast_to(hover_forces(team), solution.plan.force_W.shape)
    np.testing.assert_allclose(solution.plan.force_W, wanted, atol=1e-4)
    thrust = np.linalg.norm(hover_forces(team) + team.arrays().m_B[:, None] * [0, 0, 9.81], axis=1)
    np.testing.assert_allclose(solution.plan.thrust[0], thrust, rtol=1e-4)


def test_on_its_reference_the_plan_is_the_flat_motion(kind, limits, loop):
    """The load starts on a turning eight with the flat forces: nothing is to be corrected."""
    team, reference = TEAM, loop.Eight()
    controller, t_us = kind().build(team, limits), 2_000_000
    sample = reference.sample(t_us + np.linspace(0.0, 2e6, 21))
    flat = flat_outputs(team, sample.p_WD, sample.R_WD, np.zeros((4, 3)))
    load = np.zeros(13)
    load[:3], load[7:10], load[10:] = sample.p_WD[0, 0], sample.p_WD[0, 1], flat.w_WL_L[0]
    R = sample.R_WD[0, 0]
    yaw = np.arctan2(R[1, 0], R[0, 0])
    load[3], load[6] = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    request = make_request(
        team,
        reference,
        loop.empty_world(team),
        load,
        t_us,
        force_W=flat.force_W[0, 0],
        dforce_W=flat.force_W[0, 1],
    )
    _, solution = controller.solve(controller.init(), request)
    plan = solution.plan
    wanted = reference.sample(t_us + 1e6 * plan.node_s)
    assert np.abs(plan.load[:, :3] - wanted.p_WD[:, 0]).max() < 2e-3
    there = flat_outputs(team, wanted.p_WD, wanted.R_WD, np.zeros((4, 3)))
    assert np.abs(plan.force_W - there.force_W[:, 0]).max() < 0.02
    assert np.abs(plan.thrust[2:-2] / there.wrench[2:-2, :, 0] - 1.0).max() < 0.01
    np.testing.assert_allclose(plan.accel_W, wanted.p_WD[:, 2], atol=0.06)


def test_the_plan_obeys_the_model_between_its_nodes(kind, limits, loop):
    controller = kind().build(TEAM, limits)
    load = np.zeros(13)
    load[:3], load[3], load[7] = [0.4, -0.3, 1.8], 1.0, 0.3
    request = make_request(
        TEAM, loop.Rest(), loop.empty_world(TEAM), load, dforce_W=np.full((4, 3), 0.1)
    )
    _, solution = controller.solve(controller.init(), request)
    plan = solution.plan
    x = plan.load[0].copy()
    for k in range(len(plan.node_s) - 1):
        h = plan.node_s[k + 1] - plan.node_s[k]
        v = plan.load[k, 7:10] + 0.5 * h * (plan.accel_W[k] + plan.accel_W[k + 1])
        np.testing.assert_allclose(plan.load[k + 1, 7:10], v, atol=0.02)
        accel = load_acceleration(TEAM, plan.load[k], plan.force_W[k])[:3]
        np.testing.assert_allclose(plan.accel_W[k], accel, atol=1e-9)
    np.testing.assert_allclose(plan.load[0], x)
    np.testing.assert_allclose(plan.force_W[0], request.force_W, atol=1e-9)
    first = sample_plan(plan, 0)
    np.testing.assert_allclose(first.dforce_W, plan.dforce_W[0], atol=1e-9)


def test_forces_start_with_the_commanded_rate(limits, loop):
    controller = Nmpc().build(TEAM, limits)
    rate = np.random.default_rng(0).normal(size=(4, 3))
    request = make_request(TEAM, loop.Rest(), loop.empty_world(TEAM), dforce_W=rate)
    _, solution = controller.solve(controller.init(), request)
    np.testing.assert_allclose(solution.plan.dforce_W[0], rate, atol=1e-8)


def test_limits_hold_in_the_plan(limits, loop):
    """A far goal, vehicles with little thrust: tension, thrust and speed stay within limits."""
    team = replace(TEAM, vehicle=replace(TEAM.vehicle, thrust_max_n=3.45))
    controller = Nmpc().build(team, limits)
    load = np.zeros(13)
    load[:3], load[3] = [-0.7, 0.4, 1.5], 1.0
    request = make_request(team, loop.Rest(), loop.empty_world(team), load, sqp_iterations=6)
    memory, solution = controller.solve(controller.init(), request)
    _, solution = controller.solve(memory, request)
    plan = solution.plan
    assert solution.status is SolveStatus.OK
    tension = np.linalg.norm(plan.force_W, axis=2)
    assert tension.min() > 0.95 * team.tension_min_n
    assert np.linalg.norm(plan.load[:, 7:10], axis=1).max() < 1.3 * limits.v_max_mps + 0.02
    assert plan.thrust[3:-1].max() < 1.05 * 3.45


def test_later_iterations_end_in_a_point_that_stays(kind, limits, loop):
    """The fixed point of the iterations: one more changes nothing."""
    controller = kind().build(TEAM, limits)
    load = np.zeros(13)
    load[:3], load[3:7], load[7:10] = [0.5, 0.5, 2.3], [0.995, 0.08, -0.05, 0.03], [0.3, -0.5, 0.1]
    load[3:7] /= np.linalg.norm(load[3:7])
    request = make_request(TEAM, loop.Rest(), loop.empty_world(TEAM), load, sqp_iterations=15)
    memory, _ = controller.solve(controller.init(), request)
    memory, a = controller.solve(memory, request)
    _, b = controller.solve(memory, replace(request, sqp_iterations=1))
    np.testing.assert_allclose(a.plan.load, b.plan.load, atol=2e-3)
    np.testing.assert_allclose(a.plan.force_W, b.plan.force_W, atol=5e-3)


@pytest.mark.parametrize("age_us", [0, 13_000, 370_000, 1_900_000, 30_000_000])
def test_a_warm_start_of_any_age_leads_to_the_plan_of_a_fresh_one(age_us, kind, limits, loop):
    controller, world = kind().build(TEAM, limits), loop.empty_world(TEAM)
    reference = loop.Eight(yaw_rad=0.0)
    memory, _ = controller.solve(
        controller.init(), make_request(TEAM, reference, world, sqp_iterations=5)
    )
    request = make_request(TEAM, reference, world, t_us=age_us, sqp_iterations=8)
    _, warm = controller.solve(replace(memory, plan=None), request)
    _, fresh = controller.solve(controller.init(), request)
    assert warm.status is fresh.status is SolveStatus.OK
    np.testing.assert_allclose(warm.plan.load, fresh.plan.load, atol=3e-3)


def test_a_mover_in_the_way_is_left_room(kind, limits, loop):
    controller = kind().build(TEAM, limits)
    world = loop.moved(
        loop.empty_world(TEAM), (loop.mover(0, (2.6, 0.1, 2.4), (-0.8, 0.0, 0.0)),), 0
    )
    request = make_request(TEAM, loop.Rest(), world, sqp_iterations=10)
    memory, _ = controller.solve(controller.init(), request)
    _, solution = controller.solve(memory, request)
    plan = solution.plan
    clear = world.clearance(plan.load[:, :3].copy(), 1e6 * plan.node_s)
    stay = world.clearance(np.tile(plan.load[0, :3], (len(clear), 1)), 1e6 * plan.node_s)
    assert stay.min() < -0.1
    assert clear.min() > -0.02
    assert solution.slack_m < 0.02


def test_slack_tells_how_far_a_plan_cuts_in(limits, loop):
    controller = Nmpc().build(TEAM, limits)
    track = loop.mover(0, (1.0, 0.0, 2.5), (0.0, 0.0, 0.0))
    world = loop.moved(loop.empty_world(TEAM), (track,), 0)
    _, solution = controller.solve(controller.init(), make_request(TEAM, loop.Rest(), world))
    inside = -float(world.clearance(solution.plan.load[1:2, :3].copy(), np.array([5e4]))[0])
    assert inside > 0.03
    assert solution.slack_m == pytest.approx(inside, abs=0.02)


def test_a_lost_cable_carries_nothing_and_the_load_stays_up(limits, loop):
    team = Team(count=5)
    controller, world = Nmpc().build(team, limits), loop.empty_world(team)
    request = make_request(team, loop.Rest(), world)
    memory, _ = controller.solve(controller.init(), request)
    active = np.array([True, True, False, True, True])
    later = replace(request, stamp_us=100_000, active=active, force_W=hover_forces(team, active))
    _, solution = controller.solve(memory, later)
    plan = solution.plan
    np.testing.assert_allclose(plan.force_W[:, 2], 0.0, atol=1e-12)
    np.testing.assert_array_equal(plan.gain[:, 2], 0.0)
    np.testing.assert_array_equal(plan.active, active)
    assert np.abs(plan.load[:, :3] - [0.0, 0.0, 2.0]).max() < 0.12
    weight = team.payload.mass_kg * 9.81
    np.testing.assert_allclose(plan.force_W[5:, :, 2].sum(axis=1), weight, rtol=0.2)


def test_solve_is_a_function_of_memory_and_request(kind, limits, loop):
    controller, world = kind().build(TEAM, limits), loop.empty_world(TEAM)
    request = make_request(TEAM, loop.Eight(), world)
    memory, _ = controller.solve(controller.init(), request)
    later = replace(request, stamp_us=70_000, load=request.load + 0.01)
    other = replace(request, stamp_us=500_000, load=request.load - 0.2)
    _, a = controller.solve(memory, later)
    controller.solve(memory, other)
    _, b = controller.solve(memory, later)
    for name in ("load", "force_W", "gain", "thrust"):
        np.testing.assert_array_equal(getattr(a.plan, name), getattr(b.plan, name))


def test_turning_the_world_turns_the_plan(limits, loop):
    """World axes have no meaning but the vertical: a quarter turn about it changes nothing."""
    controller, world = Nmpc().build(TEAM, limits), loop.empty_world(TEAM)
    load = np.zeros(13)
    load[:3], load[3:7], load[7:10] = [0.4, 0.1, 2.1], [0.998, 0.05, 0.0, 0.03], [0.2, 0.1, 0.0]
    load[3:7] /= np.linalg.norm(load[3:7])
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    request = make_request(TEAM, loop.Rest(), world, load)
    _, a = controller.solve(controller.init(), request)
    # the team is square: the turned load, whose hooks fall on one another's places
    other = load.copy()
    other[:3], other[7:10] = turn @ load[:3], turn @ load[7:10]
    other[4:7] = turn @ load[4:7]
    _, b = controller.solve(controller.init(), replace(request, load=other))
    np.testing.assert_allclose(b.plan.load[:, :3], a.plan.load[:, :3] @ turn.T, atol=1e-3)
    np.testing.assert_allclose(
        b.plan.force_W, np.roll(a.plan.force_W @ turn.T, 1, axis=1), atol=2e-3
    )


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"step_s": ()}, "step_s"),
        ({"cone_deg": 95.0}, "cone_deg"),
        ({"thrust_share": 1.2}, "thrust_share"),
        ({"movers": -1}, "movers"),
        ({"tolerance": 0.0}, "tolerance"),
    ],
)
def test_bad_parameters_are_refused_by_name(kind, change, word):
    with pytest.raises(ValueError, match=word):
        kind(**change)


def test_limits_of_speed_come_from_the_scenario(loop):
    slow = Nmpc().build(TEAM, Limits(v_max_mps=0.5))
    load = np.zeros(13)
    load[:3], load[3] = [-1.5, 0.0, 2.0], 1.0
    request = make_request(TEAM, loop.Rest(), loop.empty_world(TEAM), load, sqp_iterations=5)
    memory, _ = slow.solve(slow.init(), request)
    _, solution = slow.solve(memory, request)
    assert np.linalg.norm(solution.plan.load[:, 7:10], axis=1).max() < 0.75


def test_a_controller_is_let_go_after_its_last_use(limits, loop):
    controller = Nmpc().build(TEAM, limits)
    request = make_request(TEAM, loop.Rest(), loop.empty_world(TEAM), sqp_iterations=1)
    controller.solve(controller.init(), request)
    used = weakref.ref(controller)
    del controller
    gc.collect()
    assert used() is None


def test_iterations_end_with_a_small_step_and_the_plan_is_that_of_all_of_them(limits, loop):
    """Every step is about the square of the one before: nothing is lost by leaving the last out."""
    world, reference = loop.empty_world(TEAM), loop.Eight(yaw_rad=0.0)
    first, later = (
        make_request(TEAM, reference, world, t_us=t_us, sqp_iterations=3) for t_us in (0, 200_000)
    )
    plans, counts = [], []
    for small_step in (Nmpc().small_step, 1e-300):
        controller = Nmpc(small_step=small_step).build(TEAM, limits)
        memory, _ = controller.solve(controller.init(), first)
        _, solution = controller.solve(memory, later)
        plans.append(solution.plan)
        counts.append(solution.iterations)
    assert counts[0] <= 0.7 * counts[1]
    np.testing.assert_allclose(plans[0].force_W, plans[1].force_W, atol=1e-4)
    np.testing.assert_allclose(plans[0].load, plans[1].load, atol=1e-5)


def test_the_size_of_a_step_is_its_largest_entry_and_forces_count_in_hover_forces():
    dx, hover = np.zeros((5, 12 + 6 + 3)), np.full(6, 0.5)
    dx[2, 4], dx[3, 13], dx[4, 20] = -0.01, 0.02, 7.0  # the rate of the whole force is no part
    assert step_size(dx, hover) == pytest.approx(0.04)
    dx[0, 11] = 0.05
    assert step_size(dx, hover) == pytest.approx(0.05)
