# SPDX-License-Identifier: Apache-2.0
"""References of the stages, and guesses shifted by any time."""

import numpy as np
import pytest

from skyhaul.control.nmpc.allocation import FreeForces, WrenchShares
from skyhaul.control.nmpc.horizon import shifted_guess, stage_refs
from skyhaul.control.nmpc.stage import Iterate
from skyhaul.geometry.quaternion import quat_conj, quat_exp, quat_log, quat_mul
from skyhaul.model import Team, load_acceleration

TEAM = Team()
DT = np.array([0.05] * 4 + [0.1] * 8)
NODE = np.append(0.0, np.cumsum(DT))
ALL = np.ones(4, dtype=bool)


def refs_at(loop, t_us, controlled=None):
    return stage_refs(
        TEAM,
        controlled or FreeForces(),
        loop.Eight(),
        (t_us + 1e6 * NODE, DT),
        np.zeros(12),
        ALL,
    )


@pytest.mark.parametrize("controlled", [FreeForces(), WrenchShares()])
def test_reference_forces_give_the_reference_acceleration(controlled, loop):
    ref = refs_at(loop, 3_000_000, controlled)
    sample = loop.Eight().sample(3_000_000 + 1e6 * NODE)
    for k in range(len(NODE)):
        accel = load_acceleration(TEAM, ref.x[k], ref.force_W[k])
        np.testing.assert_allclose(accel[:3], sample.p_WD[k, 2], atol=1e-9)
    np.testing.assert_allclose(ref.z[:-1] + DT[:, None] * ref.u, ref.z[1:], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(ref.dir_W, axis=2), 1.0)
    total = ref.z.reshape(len(NODE), -1, 3)
    force = total.sum(axis=1) if total.shape[1] == 4 else total[:, 0]
    np.testing.assert_allclose(force, ref.force_W.sum(axis=1), atol=1e-12)


def test_reference_states_move_as_their_rates_say(loop):
    ref, h = refs_at(loop, 2_000_000), 1e-4
    later = refs_at(loop, 2_000_000 + 1e6 * h)
    turn = quat_log(quat_mul(quat_conj(ref.x[:, 3:7]), later.x[:, 3:7])) / h
    np.testing.assert_allclose(turn, ref.x[:, 10:], atol=1e-3)
    np.testing.assert_allclose((later.x[:, :3] - ref.x[:, :3]) / h, ref.x[:, 7:10], atol=1e-3)


def linear_iterate():
    """States and forces that are linear in time, turning about one axis."""
    x, z = np.zeros((len(NODE), 13)), np.outer(NODE, np.arange(12.0)) + 1.0
    x[:, :3], x[:, 7:10] = np.outer(NODE, [1.0, -2.0, 0.5]), [1.0, -2.0, 0.5]
    x[:, 3:7] = quat_exp(np.outer(NODE, [0.3, -0.2, 0.5]))
    return Iterate(x, z, np.tile(np.arange(12.0), (len(DT), 1)))


@pytest.mark.parametrize("age_s", [0.0, 0.013, 0.05, 0.37, 0.91])
def test_a_shifted_guess_is_the_last_one_later_and_then_the_reference(age_s, loop):
    ref, last = refs_at(loop, 0), linear_iterate()
    x0, z0 = last.x[0] + 0.01, last.z[0] - 0.01
    guess = shifted_guess(last, age_s, (ref, NODE), x0, z0, np.ones(12))
    t = age_s + NODE
    inside = t <= NODE[-1] + 1e-12
    inside[0] = False
    late = ~inside
    late[0] = False
    np.testing.assert_allclose(guess.x[inside, :3], np.outer(t[inside], [1.0, -2.0, 0.5]))
    np.testing.assert_allclose(
        guess.x[inside, 3:7], quat_exp(np.outer(t[inside], [0.3, -0.2, 0.5]))
    )
    np.testing.assert_allclose(guess.z[inside], np.outer(t[inside], np.arange(12.0)) + 1.0)
    np.testing.assert_array_equal(guess.x[late], ref.x[late])
    np.testing.assert_array_equal(guess.z[late], ref.z[late])
    np.testing.assert_array_equal(guess.x[0], x0)
    np.testing.assert_allclose(guess.z[:-1] + DT[:, None] * guess.u, guess.z[1:], atol=1e-12)


def test_forces_that_do_not_move_are_zero_in_a_shifted_guess(loop):
    moves = np.ones(12)
    moves[3:6] = 0.0
    ref, last = refs_at(loop, 0), linear_iterate()
    guess = shifted_guess(last, 0.1, (ref, NODE), last.x[0], last.z[0] * moves, moves)
    np.testing.assert_array_equal(guess.z[:, 3:6], 0.0)
    np.testing.assert_array_equal(guess.u[:, 3:6], 0.0)
