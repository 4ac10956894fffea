# SPDX-License-Identifier: Apache-2.0
"""Tests of `model.formation`: the nominal allocation and hover."""

import numpy as np
import pytest

from skyhaul.errors import SkyhaulError
from skyhaul.geometry.so3 import euler_zyx, so3_exp
from skyhaul.model import (
    PointPayload,
    RigidPayload,
    Team,
    accelerations,
    formation_forces,
    hover_attitude,
    hover_forces,
    hover_state,
    hover_wrenches,
)
from skyhaul.model.formation import FAIR_SHARE, formation

SIZES = [(n, kind) for n in (1, 2, 3, 4, 5, 8) for kind in ("point", "rigid")]


def wrench_of(team, forces_L):
    moment = np.cross(team.hooks_L(), forces_L)
    return np.concatenate([forces_L.sum(axis=-2), moment.sum(axis=-2)], axis=-1)


@pytest.mark.parametrize("n", [3, 4, 5, 8])
def test_forces_give_the_wrench(rng, make, n):
    team, wrench = make.team(rng, n, "rigid"), rng.normal(size=(7, 6))
    forces = formation_forces(team, wrench)
    np.testing.assert_allclose(wrench_of(team, forces), wrench, atol=1e-12)


def test_forces_on_a_point_mass_give_the_force(rng, make):
    team, wrench = make.team(rng, 4, "point"), rng.normal(size=6)
    forces = formation_forces(team, wrench)
    np.testing.assert_allclose(forces.sum(axis=0), wrench[:3], atol=1e-12)
    other_moment = np.append(wrench[:3], rng.normal(size=3))
    np.testing.assert_allclose(formation_forces(team, other_moment), forces)


def test_change_of_wrench_moves_the_forces_least(rng, make):
    team, wrench = make.team(rng, 5, "rigid"), rng.normal(size=6)
    change = formation_forces(team, wrench) - formation_forces(team, np.zeros(6))
    internal = formation_forces(team, np.zeros(6)) - change  # any other null-space motion
    internal -= formation_forces(team, wrench_of(team, internal)) - formation(team).internal_L
    np.testing.assert_allclose(wrench_of(team, internal), 0.0, atol=1e-12)
    assert np.sum(change * internal) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("n", [3, 4, 6])
@pytest.mark.parametrize("payload", [PointPayload(), RigidPayload()])
def test_symmetric_team_hovers_in_its_formation(n, payload):
    team = Team(count=n, payload=payload)
    forces = hover_forces(team)
    along = team.formation_dirs_L()
    tension = payload.mass_kg * 9.81 / (n * np.cos(team.cable_angle_rad))
    np.testing.assert_allclose(forces, tension * along, atol=1e-12)


@pytest.mark.parametrize(("n", "kind"), SIZES)
def test_hover_is_an_equilibrium_with_every_cable_taut(rng, make, n, kind):
    team = make.team(rng, n, kind)
    state = hover_state(team, rng.normal(size=3), yaw=1.1)
    rates = accelerations(team, state, hover_wrenches(team))
    np.testing.assert_allclose(np.concatenate([rates.a_WL, rates.dw_WL_L]), 0.0, atol=1e-9)
    np.testing.assert_allclose(rates.cable_dw_W, 0.0, atol=1e-9)
    np.testing.assert_allclose(rates.tension, np.linalg.norm(hover_forces(team), axis=1))
    assert np.all(rates.tension > team.tension_min_n)


def test_vehicles_and_load_head_where_they_are_told():
    team = Team()
    state = hover_state(team, np.zeros(3), yaw=0.8)
    front = 2.0 * (state.q_WB[:, 1] * state.q_WB[:, 2] + state.q_WB[:, 0] * state.q_WB[:, 3])
    assert np.all(front > 0.0)
    np.testing.assert_allclose(state.q_WL, [np.cos(0.4), 0, 0, np.sin(0.4)], atol=1e-14)


@pytest.mark.parametrize("count", [4, 5, 6])
def test_intact_symmetric_team_hovers_level(count):
    np.testing.assert_array_equal(hover_attitude(Team(count=count)), np.eye(3))


def test_square_plate_that_lost_a_cable_tilts_until_the_third_carries():
    team, active = Team(count=4), np.array([True, True, True, False])
    R_WL, forces = hover_attitude(team, active), hover_forces(team, active)
    tilt = np.degrees(np.arccos(R_WL[2, 2]))
    assert 15.0 <= tilt <= 20.0  # PAPER_NOTES 33
    np.testing.assert_allclose(np.linalg.norm(forces[1]), 0.5, atol=0.05)
    np.testing.assert_array_equal(forces[3], 0.0)
    np.testing.assert_allclose(forces.sum(axis=0), [0, 0, 0.232 * 9.81], atol=1e-12)
    np.testing.assert_allclose(np.cross(team.hooks_L(), forces @ R_WL).sum(axis=0), 0, atol=1e-12)
    carried = np.sum(forces @ R_WL * team.formation_dirs_L(), axis=1)[active]
    assert carried.min() >= FAIR_SHARE * 0.232 * 9.81 / 3


def test_five_cables_can_lose_any_one_and_stay_level():
    for lost in range(5):
        active = np.arange(5) != lost
        np.testing.assert_array_equal(hover_attitude(Team(count=5), active), np.eye(3))


def test_single_hook_comes_over_the_centre_of_mass():
    team = Team(count=1)
    hook_W = hover_attitude(team) @ team.hooks_L()[0]
    np.testing.assert_allclose(hook_W[:2], 0.0, atol=1e-12)
    assert hook_W[2] > 0.0


def test_two_hooks_beside_the_centre_of_mass_tilt_only_about_their_line():
    hooks = ((-0.1, 0.02, 0.05), (0.1, 0.02, 0.05))
    team = Team(count=2, hooks_m=hooks, azimuths_deg=(180.0, 0.0))
    roll, pitch, yaw = euler_zyx(hover_attitude(team))
    assert roll == pytest.approx(np.arctan2(0.02, 0.05))
    np.testing.assert_allclose([pitch, yaw], 0.0, atol=1e-12)


def test_forces_do_not_depend_on_how_the_load_axes_lie(rng, make):
    # Turned hooks and a turned wrench give turned forces; the formation turns along.
    turn = so3_exp(np.array([0.0, 0.0, 0.9]))
    team, wrench = make.team(rng, 4, "rigid"), rng.normal(size=6)
    other = Team(
        count=4,
        overrides=team.overrides,
        payload=team.payload,
        hooks_m=tuple(map(tuple, team.hooks_L() @ turn.T)),
        azimuths_deg=tuple(np.array(team.azimuths_deg) + np.degrees(0.9)),
        separation_m=team.separation_m,
    )
    turned = np.concatenate([turn @ wrench[:3], turn @ wrench[3:]])
    expected = formation_forces(team, wrench) @ turn.T
    np.testing.assert_allclose(formation_forces(other, turned), expected, atol=1e-12)


def test_lost_cables_pull_nothing(rng, make):
    team, active = make.team(rng, 5, "rigid"), np.array([True, False, True, True, True])
    wrench = rng.normal(size=6)
    forces = formation_forces(team, wrench, active)
    np.testing.assert_array_equal(forces[1], 0.0)
    np.testing.assert_allclose(wrench_of(team, forces), wrench, atol=1e-12)


@pytest.mark.parametrize("active", [np.zeros(4, bool), np.ones(3, bool)])
def test_mask_without_a_carrying_cable_or_of_another_team_is_refused(active):
    with pytest.raises(SkyhaulError, match="each of the 4 cables"):
        hover_forces(Team(), active)
