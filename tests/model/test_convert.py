# SPDX-License-Identifier: Apache-2.0
"""Tests of `model.convert`: taut coordinates and poses of all bodies."""

import numpy as np
import pytest

from skyhaul.model import cable_state, step, taut_state, team_state


@pytest.mark.parametrize(("n", "kind"), [(1, "rigid"), (3, "point"), (4, "rigid"), (8, "point")])
def test_taut_states_survive_the_round_trip(rng, make, n, kind):
    team, state = make.team(rng, n, kind), make.state(rng, n, kind)
    back = taut_state(team, team_state(team, state))
    for name, value in vars(state).items():
        np.testing.assert_allclose(getattr(back, name), value, atol=1e-13)


def test_vehicles_stay_one_cable_length_from_their_hooks(rng, make):
    team, state = make.team(rng, 4, "rigid"), make.state(rng, 4, "rigid")
    cables = cable_state(team, team_state(team, state), np.zeros(4))
    np.testing.assert_allclose(cables.length, team.cable_lengths_m(), rtol=1e-14)


def test_velocities_are_the_rates_of_the_positions(rng, make):
    team, state = make.team(rng, 4, "rigid"), make.state(rng, 4, "rigid")
    wrenches, h = make.wrenches(rng, 4), 1e-4
    now, middle = team_state(team, state), team_state(team, step(team, state, wrenches, h))
    ahead = team_state(team, step(team, state, wrenches, 2 * h))
    np.testing.assert_allclose(middle.v_WB, (ahead.p_WB - now.p_WB) / (2 * h), atol=1e-5)


def test_motion_along_a_cable_gives_no_rate(rng, make):
    team, state = make.team(rng, 3, "rigid"), make.state(rng, 3, "rigid")
    poses = team_state(team, state)
    pulled = type(poses)(**{**vars(poses), "v_WB": poses.v_WB + 0.7 * state.cable_dir_W})
    np.testing.assert_allclose(taut_state(team, pulled).cable_w_W, state.cable_w_W, atol=1e-13)
