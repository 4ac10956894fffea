# SPDX-License-Identifier: Apache-2.0
"""The first guess: it obeys the model and comes to its reference from anywhere."""

import numpy as np
import pytest

from skyhaul.control.nmpc.load_step import LoadParams
from skyhaul.control.nmpc.rollout import LEAD, roll_out
from skyhaul.geometry.quaternion import quat_conj, quat_exp, quat_log, quat_mul, quat_to_R
from skyhaul.model import Team

TEAM = Team()
LOAD = LoadParams(TEAM.payload.mass_kg, TEAM.payload.J_L, True, TEAM.arrays().g)
NODE = np.linspace(0.0, 5.0, 101)


def rest(attitude=(0.0, 0.0, 0.0)):
    x, wrench = np.zeros((101, 13)), np.zeros((101, 6))
    x[:, 3:7] = quat_exp(np.array(attitude))
    wrench[:, 2] = LOAD.m * LOAD.g
    return x, wrench


def run(start, reference, load=LOAD):
    out = np.empty((101, 13)), np.empty((101, 6))
    roll_out(load, LEAD, reference, (start, reference[1][0]), NODE, out)
    return out


@pytest.mark.parametrize("seed", range(6))
def test_it_comes_to_rest_at_its_reference(seed):
    rng = np.random.default_rng(seed)
    start = np.concatenate([rng.uniform(-1, 1, 3), np.zeros(4), rng.uniform(-1.5, 1.5, 6)])
    start[3:7] = quat_exp(rng.uniform(-0.8, 0.8, 3))
    reference = rest((0.1, -0.1, 0.4))
    x, wrench = run(start, reference)
    np.testing.assert_allclose(x[-1, :3], 0.0, atol=0.01)
    turn = quat_log(quat_mul(quat_conj(reference[0][-1, 3:7]), x[-1, 3:7]))
    np.testing.assert_allclose(turn, 0.0, atol=0.01)
    np.testing.assert_allclose(x[-1, 7:], 0.0, atol=0.05)
    np.testing.assert_allclose(wrench[-1], reference[1][-1], atol=0.02)


def test_momentum_changes_by_the_wrench_along_it():
    start = rest()[0][0].copy()
    start[:3], start[3:7], start[10:] = (
        [0.5, -0.3, 0.2],
        quat_exp(np.array([0.4, 0.2, 0])),
        [1, 0, 2],
    )
    x, wrench = run(start, rest())
    force = 0.5 * (wrench[1:, :3] + wrench[:-1, :3]) - [0.0, 0.0, LOAD.m * LOAD.g]
    change = LOAD.m * np.diff(x[:, 7:10], axis=0)
    np.testing.assert_allclose(change, 0.05 * force, atol=2e-3)
    spin = np.einsum("kab,kb->ka", quat_to_R(x[:, 3:7]), LOAD.J * x[:, 10:])
    R = quat_to_R(x[:, 3:7])
    moment = np.einsum("kab,kb->ka", R, wrench[:, 3:])
    np.testing.assert_allclose(np.diff(spin, axis=0), 0.025 * (moment[1:] + moment[:-1]), atol=3e-4)


def test_acceleration_asked_for_is_bounded():
    start = rest()[0][0].copy()
    start[:3] = [20.0, 0.0, 0.0]
    _, wrench = run(start, rest())
    assert np.abs(wrench[:, 0]).max() <= LOAD.m * LEAD.accel_max + 1e-9


def test_a_point_mass_keeps_its_attitude():
    start = rest()[0][0].copy()
    start[:3] = [0.5, 0.0, 0.0]
    x, wrench = run(start, rest(), LOAD._replace(rigid=False))
    np.testing.assert_array_equal(x[:, 3:7], np.tile([1.0, 0, 0, 0], (101, 1)))
    np.testing.assert_array_equal(wrench[1:, 3:], 0.0)
