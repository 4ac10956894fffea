# SPDX-License-Identifier: Apache-2.0
"""From an iterate to the plan: thrusts, rates and gains against the model of the whole team."""

import numpy as np
import pytest

from skyhaul.control.nmpc import Nmpc
from skyhaul.control.nmpc.forces import make_scratch
from skyhaul.control.nmpc.plan import force_plan
from skyhaul.control.nmpc.riccati import rotation_gains
from skyhaul.control.nmpc.stage import Iterate
from skyhaul.geometry.quaternion import R_to_quat, quat_exp, quat_to_R
from skyhaul.model import PointPayload, Team, flat_outputs
from skyhaul.world.scenario import Limits

TEAMS = {"four": Team(), "three": Team(count=3), "point": Team(payload=PointPayload())}
every_team = pytest.mark.parametrize("team", TEAMS.values(), ids=TEAMS.keys())


def nodding_reference(t, loop):
    """A load that speeds along a curve and nods about y: derivatives 0..6."""
    k = len(t)
    p, R = np.zeros((k, 7, 3)), np.zeros((k, 7, 3, 3))
    w = 1.4
    for d in range(7):
        p[:, d, 0] = 0.6 * w**d * np.sin(w * t + 0.5 * np.pi * d)
        p[:, d, 1] = 0.4 * (2 * w) ** d * np.sin(2 * w * t + 0.5 * np.pi * d)
        p[:, d, 2] = 0.1 * w**d * np.cos(w * t + 0.5 * np.pi * d)
    c, s = loop._jets_of_turn(0.4, 4.0, t)
    R[:, :, 0, 0], R[:, :, 0, 2], R[:, :, 2, 0], R[:, :, 2, 2] = c, s, -s, c
    R[:, 0, 1, 1] = 1.0
    return p, R @ quat_to_R(quat_exp(np.array([0.3, 0.0, 0.7])))


def flat_plan(team, loop):
    """The plan of the flat motion, sampled at the nodes, and the flat outputs there."""
    controller = Nmpc(step_s=(0.01,) * 20).build(team, Limits())
    model = controller.model((True,) * team.count)
    t = 0.01 * np.arange(21)
    p, R = nodding_reference(t, loop)
    if team.payload.kind == "point":
        R[:], R[:, 0] = 0.0, np.eye(3)
    flat = flat_outputs(team, p, R, np.zeros((team.count, 3)))
    x = np.zeros((21, 13))
    x[:, :3], x[:, 3:7], x[:, 7:10], x[:, 10:] = p[:, 0], R_to_quat(R[:, 0]), p[:, 1], flat.w_WL_L
    z = flat.force_W[:, 0].reshape(21, -1)
    it = Iterate(x, z, np.diff(z, axis=0) / 0.01)
    plan = force_plan(
        0,
        (model.stage, model.im, controller.settings.feedback),
        it,
        flat.force_W[0, 1].ravel(),
        (model.pinv_L, np.ones(team.count, dtype=bool)),
        make_scratch(team.count, z.shape[1]),
    )
    return controller, model, plan, flat, p


@every_team
def test_thrusts_and_accelerations_are_the_flat_ones(team, loop):
    _, _, plan, flat, p = flat_plan(team, loop)
    np.testing.assert_allclose(plan.accel_W, p[:, 2], atol=1e-9)
    np.testing.assert_allclose(plan.dforce_W, flat.force_W[:, 1], atol=2e-3)
    np.testing.assert_allclose(plan.thrust[1:-2], flat.wrench[1:-2, :, 0], atol=3e-3)


@every_team
def test_gains_turn_errors_into_the_wrench_of_the_feedback(team, loop):
    """Sum of the forces: -k e_p - d e_v, W axes; sum of the moments: K (e_R, e_w), L axes."""
    controller, model, plan, _, _ = flat_plan(team, loop)
    feedback, z = controller.settings.feedback, plan.force_W.reshape(21, -1).copy()
    K = np.zeros((21, 3, 6))
    if team.payload.kind == "rigid":
        weights = (feedback.w_R, feedback.w_w)
        load, node = plan.load.copy(), plan.node_s.copy()
        rotation_gains(model.stage, model.im, load, z, node, weights, K)
    e = np.random.default_rng(0).normal(size=12)
    for k in (0, 7, 20):
        force = plan.gain[k] @ e
        wanted = -feedback.stiffness * e[:3] - feedback.damping * e[6:9]
        np.testing.assert_allclose(force.sum(axis=0), wanted, atol=1e-9)
        force_L = force @ quat_to_R(plan.load[k, 3:7])
        moment = np.cross(team.hooks_L(), force_L).sum(axis=0)
        np.testing.assert_allclose(moment, K[k] @ np.append(e[3:6], e[9:]), atol=1e-9)
