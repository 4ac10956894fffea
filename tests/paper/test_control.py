# SPDX-License-Identifier: Apache-2.0
"""The paper's control section as settled: eqs. (26)-(29) and its claims on failures."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skyhaul.control.allocation import null_space, pseudo_inverse, wrench_map
from skyhaul.control.attitude import AttitudeGains, AttitudeRef, attitude_moment
from skyhaul.control.cable import cable_goal, cable_thrust_vector
from skyhaul.control.failure import equilibrium_after_loss, single_failure_table
from skyhaul.model import Team, formation_forces, hover_forces, hover_wrenches
from skyhaul.types import GRAVITY_MPS2

WEIGHT = 0.232 * GRAVITY_MPS2


@pytest.mark.parametrize("seed", range(3))
def test_eq_26_cable_forces_from_the_wrench_on_the_load(seed):
    """mu = diag(R) P^+ [R^T F; M], with P as PAPER_NOTES 15 defines it."""
    rng = np.random.default_rng(seed)
    team, R = Team(), Rotation.random(rng=rng).as_matrix()
    F_W, M_L = rng.normal(size=(2, 3))
    mu_L = (pseudo_inverse(team.hooks_L()) @ np.concatenate([R.T @ F_W, M_L])).reshape(4, 3)
    mu_W = mu_L @ R.T
    np.testing.assert_allclose(mu_W.sum(axis=0), F_W, atol=1e-9)
    np.testing.assert_allclose(np.cross(team.hooks_L(), mu_L).sum(axis=0), M_L, atol=1e-9)


def test_eq_26_minimum_norm_alone_lets_cables_hang_straight_down():
    """Why internal forces are added (PAPER_NOTES 16)."""
    team = Team()
    wrench = np.array([0.0, 0.0, WEIGHT, 0.0, 0.0, 0.0])
    least = (pseudo_inverse(team.hooks_L()) @ wrench).reshape(4, 3)
    np.testing.assert_allclose(least[:, :2], 0.0, atol=1e-12)
    lean = formation_forces(team, wrench)
    angle = np.arccos(lean[:, 2] / np.linalg.norm(lean, axis=1))
    np.testing.assert_allclose(angle, team.cable_angle_rad, rtol=0.05)
    N = null_space(team.hooks_L())
    inner = (lean - least).ravel()
    np.testing.assert_allclose(N @ (N.T @ inner), inner, atol=1e-12)


def test_eq_26_minimum_norm_gives_negative_tensions():
    """0.25 N m on a 0.2 m plate pushes on a cable (PAPER_NOTES 17)."""
    hooks = 0.1 * np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    force = (pseudo_inverse(hooks) @ [0.0, 0.0, WEIGHT, 0.25, 0.0, 0.0]).reshape(4, 3)
    assert force[:, 2].min() == pytest.approx(-0.056, abs=0.001)


@pytest.mark.parametrize(("n", "rank"), [(1, 3), (2, 5), (3, 6), (4, 6)])
def test_p_has_full_rank_from_three_hooks_on(n, rank):
    assert np.linalg.matrix_rank(wrench_map(Team(count=n).hooks_L())) == rank


def test_eq_27_desired_cable_direction_points_down_the_wanted_force():
    mu = (0.3, -0.2, 1.1)
    xi = cable_goal(mu, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)).dir_W
    np.testing.assert_allclose(xi, -np.array(mu) / np.linalg.norm(mu))


def test_eq_28_thrust_in_hover_carries_the_vehicle_and_its_share():
    """f_k = u_k . R_k e_3, with the u_k that the paper never gives."""
    team = Team()
    for force, wrench in zip(hover_forces(team), hover_wrenches(team), strict=True):
        goal = cable_goal(tuple(force), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        still = (goal.dir_W, (0.0, 0.0, 0.0))
        up = (0.0, 0.0, GRAVITY_MPS2)
        u = cable_thrust_vector(tuple(force), goal, still, up, (0.25, 1.0), (36.0, 10.0, 0.4))
        np.testing.assert_allclose(u, force + 0.25 * np.array(up), atol=1e-12)
        assert np.linalg.norm(u) == pytest.approx(wrench[0])


def test_eq_29_ten_degrees_off_give_a_restoring_moment():
    """With Lee's errors the paper's plus signs drive the body away (PAPER_NOTES 20)."""
    ref = AttitudeRef(np.eye(3), np.zeros(3), np.zeros(3))
    for axis in np.eye(3):
        R = Rotation.from_rotvec(np.deg2rad(10.0) * axis).as_matrix()
        moment = attitude_moment(R, np.zeros(3), ref, 1e-3 * np.eye(3), AttitudeGains())
        assert moment @ axis < 0.0


def test_claim_the_load_exceeds_any_single_vehicle_but_not_two():
    """One vehicle would need 4.73 N, two 3.59, three 3.21, four 3.02 N of 4.24 (PAPER_NOTES 32)."""
    need = [0.25 * GRAVITY_MPS2 + WEIGHT / n for n in (1, 2, 3, 4)]
    np.testing.assert_allclose(need, [4.73, 3.59, 3.21, 3.02], atol=0.01)
    assert need[0] > Team().vehicle.thrust_max_n > need[1]


def test_claim_the_team_survives_the_loss_of_any_vehicle():
    """15 to 20 deg of tilt with four, level with five (PAPER_NOTES 33)."""
    assert all(r.survivable and 15.0 < r.tilt_deg < 20.0 for r in single_failure_table(Team()))
    five = Team(count=5)
    assert equilibrium_after_loss(five, np.arange(5) != 2).tilt_deg < 1e-6
