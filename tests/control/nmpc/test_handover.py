# SPDX-License-Identifier: Apache-2.0
"""From one plan to the next: what is commanded has no break."""

from dataclasses import replace

import numpy as np

from skyhaul.control.api import ControlRequest
from skyhaul.control.force_plan import load_error, sample_plan
from skyhaul.control.nmpc import Nmpc
from skyhaul.control.nmpc.handover import SETTLE_S, starting_point
from skyhaul.geometry.quaternion import quat_exp, quat_mul
from skyhaul.model import Team, hover_forces

TEAM = Team()


def first_request(loop):
    load = np.zeros(13)
    load[:3], load[3], load[7:10] = [0.3, 0.1, 2.1], 1.0, [0.2, 0.0, -0.1]
    return ControlRequest(
        stamp_us=0,
        load=load,
        force_W=hover_forces(TEAM),
        dforce_W=np.zeros((4, 3)),
        active=np.ones(4, dtype=bool),
        reference=loop.Rest(),
        world_map=loop.empty_world(TEAM),
    )


def error(load, planned):
    e = np.empty(12)
    load_error(load, planned, e)
    return e


def later_request(request, plan, age_us, seed=0, turn=0.05, shift=0.02):
    """The load a little off its plan, the forces as the feedback commands them."""
    rng = np.random.default_rng(seed)
    now = sample_plan(plan, age_us)
    load = now.load.copy()
    load[:3] += shift * rng.normal(size=3)
    load[3:7] = quat_mul(load[3:7], quat_exp(turn * rng.normal(size=3)))
    load[7:10] += shift * rng.normal(size=3)
    load[10:] += 10.0 * turn * rng.normal(size=3)
    force = now.force_W + now.gain @ error(load, now.load)
    return replace(request, stamp_us=age_us, load=load, force_W=force, dforce_W=now.dforce_W)


def test_the_commanded_force_has_no_break_at_a_solve(kind, limits, loop):
    controller, request = kind().build(TEAM, limits), first_request(loop)
    for age_us in (50_000, 300_000):
        memory, solution = controller.solve(controller.init(), request)
        later = later_request(request, solution.plan, age_us)
        _, solution = controller.solve(memory, later)
        new = sample_plan(solution.plan, age_us)
        commanded = new.force_W + new.gain @ error(later.load, new.load)
        jump = np.abs(commanded - later.force_W).max()
        assert jump < 0.1 * np.abs(later.force_W - sample_plan(memory.plan, age_us).force_W).max()


def test_position_is_taken_as_measured_and_attitude_by_and_by(limits, loop):
    controller, request = Nmpc().build(TEAM, limits), first_request(loop)
    _, solution = controller.solve(controller.init(), request)
    for age_us in (20_000, 500_000):
        later = later_request(request, solution.plan, age_us)
        start = starting_point(solution.plan, later)
        before = error(later.load, sample_plan(solution.plan, age_us).load)
        after = error(later.load, start.load)
        kept = np.exp(-1e-6 * age_us / SETTLE_S)
        np.testing.assert_allclose(after[3:6], kept * before[3:6], atol=1e-9)
        np.testing.assert_allclose(after[9:], kept * before[9:], atol=1e-9)
        np.testing.assert_allclose(after[[0, 1, 2, 6, 7, 8]], 0.0, atol=1e-12)


def test_without_a_plan_that_holds_all_is_taken_as_measured(limits, loop):
    controller, request = Nmpc().build(TEAM, limits), first_request(loop)
    _, solution = controller.solve(controller.init(), request)
    plan = solution.plan
    late = replace(later_request(request, plan, 100_000), stamp_us=plan.end_us)
    lost = replace(
        later_request(request, plan, 100_000), active=np.array([True, True, False, True])
    )
    early = replace(request, stamp_us=-1)
    for r, p in ((late, plan), (lost, plan), (early, plan), (request, None)):
        start = starting_point(p, r)
        np.testing.assert_array_equal(start.load, r.load)
        np.testing.assert_array_equal(start.force_W, r.force_W * r.active[:, None])
