# SPDX-License-Identifier: Apache-2.0
"""Tests of `control.geometric`. Each name states the property it checks."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skyhaul.control.api import ControlRequest, SolveStatus
from skyhaul.control.geometric import Geometric, feedback_gains, hold_plan
from skyhaul.model import PointPayload, Team, flat_outputs, hover_forces, load_acceleration
from skyhaul.types import GRAVITY_MPS2
from skyhaul.world.scenario import Limits

GAINS = Geometric()


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def request_for(team, reference, t_us=0, active=None):
    n = team.count
    return ControlRequest(
        stamp_us=t_us,
        load=np.zeros(13),
        force_W=np.zeros((n, 3)),
        dforce_W=np.zeros((n, 3)),
        active=np.ones(n, dtype=bool) if active is None else np.array(active),
        reference=reference,
        world_map=None,
    )


def solve(team, reference, **more):
    controller = GAINS.build(team, Limits())
    return controller.solve(controller.init(), request_for(team, reference, **more))[1]


def test_plan_accelerates_the_load_as_the_reference_does(references):
    team, circle = Team(), references[0](period_s=5.0)
    solution = solve(team, circle, t_us=700_000)
    plan = solution.plan
    assert solution.status is SolveStatus.OK
    for k, t in enumerate(plan.node_s):
        sample = circle.sample(np.array([700_000 + 1e6 * t]))
        got = load_acceleration(team, plan.load[k], plan.force_W[k])
        np.testing.assert_allclose(got[:3], sample.p_WD[0, 2], atol=1e-9)
        np.testing.assert_allclose(got[3:], 0.0, atol=1e-9)
        np.testing.assert_allclose(plan.load[k, 7:10], sample.p_WD[0, 1], atol=1e-9)


def test_predicted_thrust_is_that_of_flatness(references):
    team, circle = Team(), references[0](period_s=5.0)
    plan = solve(team, circle).plan
    sample = circle.sample(1e6 * plan.node_s)
    flat = flat_outputs(team, sample.p_WD, sample.R_WD, np.zeros((4, 3)))
    np.testing.assert_allclose(plan.thrust, flat.wrench[:, :, 0])


def test_feedback_gives_the_pd_wrench(rng):
    team = Team(count=5)
    R, e = Rotation.random(rng=rng).as_matrix(), 0.1 * rng.normal(size=12)
    arrays, active = team.arrays(), np.array([True, True, False, True, True])
    force = feedback_gains(team, R[None], active, GAINS)[0] @ e
    np.testing.assert_allclose(
        force.sum(axis=0),
        -arrays.m_L * (GAINS.position_stiffness * e[:3] + GAINS.position_damping * e[6:9]),
        atol=1e-9,
    )
    moment = np.cross(arrays.p_LA, force @ R).sum(axis=0)
    expected = GAINS.attitude_stiffness * e[3:6] + GAINS.attitude_damping * e[9:]
    np.testing.assert_allclose(moment, -arrays.J_L * expected, atol=1e-9)
    np.testing.assert_array_equal(force[2], 0.0)


def test_a_point_mass_is_not_turned(rng):
    team = Team(payload=PointPayload())
    K = feedback_gains(team, np.eye(3)[None], np.ones(4, dtype=bool), GAINS)
    np.testing.assert_array_equal(K[..., 3:6], 0.0)
    np.testing.assert_array_equal(K[..., 9:], 0.0)


def test_hold_plan_carries_the_weight_for_good():
    team = Team()
    plan = hold_plan(team, 5, np.array([1.0, 2.0, 3.0]), np.eye(3), np.ones(4, dtype=bool), GAINS)
    np.testing.assert_allclose(plan.force_W[0], hover_forces(team), atol=1e-12)
    assert plan.force_W[0].sum(axis=0)[2] == pytest.approx(team.payload.mass_kg * GRAVITY_MPS2)
    assert plan.end_us == 5


def test_lost_cables_carry_nothing(references):
    team = Team(count=5)
    plan = solve(team, references[1](), active=[True, True, True, True, False]).plan
    np.testing.assert_array_equal(plan.force_W[:, 4], 0.0)
    np.testing.assert_array_equal(plan.gain[:, 4], 0.0)
    np.testing.assert_allclose(
        plan.force_W[0].sum(axis=0), [0.0, 0.0, team.payload.mass_kg * GRAVITY_MPS2], atol=1e-9
    )


def test_bad_gains_are_refused():
    with pytest.raises(ValueError, match="node_s lie in"):
        Geometric(node_s=5.0)
    with pytest.raises(ValueError, match="position_damping must be > 0, got 0"):
        Geometric(position_damping=0.0)
