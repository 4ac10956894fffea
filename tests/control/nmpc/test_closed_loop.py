# SPDX-License-Identifier: Apache-2.0
"""A load under ideal cables: tracking, movers, wild starts, sparse solves."""

import numpy as np
import pytest

from skyhaul.control.api import SolveStatus
from skyhaul.control.nmpc import Nmpc
from skyhaul.geometry.quaternion import quat_exp
from skyhaul.model import PointPayload, Team

TEAM = Team()


def wild_start(seed, rigid=True):
    rng = np.random.default_rng(seed)
    x = np.zeros(13)
    x[:3] = np.array([0.0, 0.0, 2.0]) + rng.uniform(-1.0, 1.0, 3)
    axis = rng.normal(size=3)
    x[3:7] = quat_exp(axis / np.linalg.norm(axis) * rng.uniform(0.0, 1.0) * rigid)
    x[7:10], x[10:] = rng.uniform(-1.5, 1.5, 3), rng.uniform(-2.0, 2.0, 3) * rigid
    return x


def test_an_eight_is_followed_under_pushes(kind, limits, loop):
    flight = loop.LoadLoop(TEAM, push=(0.05, 0.001)).fly(
        kind().build(TEAM, limits), loop.Eight(), loop.empty_world(TEAM), seconds=6.0
    )
    assert set(flight.statuses) == {SolveStatus.OK}
    assert flight.rmse_m < 0.04


def test_two_solves_a_second_with_feedback_track_like_twenty(limits, loop):
    world, controller = loop.empty_world(TEAM), Nmpc().build(TEAM, limits)
    often = loop.LoadLoop(TEAM, push=(0.05, 0.001)).fly(
        controller, loop.Eight(), world, seconds=8.0
    )
    seldom = loop.LoadLoop(TEAM, solve_s=0.5, sqp_iterations=3, push=(0.05, 0.001)).fly(
        controller, loop.Eight(), world, seconds=8.0
    )
    assert len(seldom.statuses) * 10 == len(often.statuses)
    assert seldom.rmse_m < 1.3 * often.rmse_m + 0.005


def test_six_movers_are_passed_without_a_touch(kind, limits, loop):
    flight = loop.LoadLoop(TEAM).fly(
        kind().build(TEAM, limits),
        loop.Rush(),
        loop.empty_world(TEAM),
        loop.six_movers(),
        seconds=13.0,
    )
    assert flight.clearance_m.min() > -0.02
    assert np.linalg.norm(flight.load[-1, :3] - [9.0, 0.0, 2.0]) < 0.02
    assert SolveStatus.FAILED not in flight.statuses


@pytest.mark.parametrize("lag_s", [0.03, 0.08])
def test_hover_is_regained_behind_a_lag_of_the_forces(lag_s, kind, limits, loop):
    x0 = np.zeros(13)
    x0[:3], x0[3:7] = [0.3, -0.2, 2.1], quat_exp(np.array([0.15, -0.1, 0.2]))
    flight = loop.LoadLoop(TEAM, lag_s=lag_s).fly(
        kind().build(TEAM, limits), loop.Rest(), loop.empty_world(TEAM), seconds=5.0, x0=x0
    )
    assert np.linalg.norm(flight.load[-1, :3] - [0.0, 0.0, 2.0]) < 0.03
    assert np.linalg.norm(flight.load[-1, 4:7]) < 0.03
    assert np.abs(flight.load[-1, 10:]).max() < 0.2


@pytest.mark.parametrize("n", [3, 6, 8])
def test_other_numbers_of_cables_need_no_other_code(n, limits, loop):
    team = Team(count=n)
    flight = loop.LoadLoop(team).fly(
        Nmpc().build(team, limits), loop.Eight(), loop.empty_world(team), seconds=2.0
    )
    assert set(flight.statuses) == {SolveStatus.OK}
    assert flight.rmse_m < 0.03


def test_a_point_load_is_carried(kind, limits, loop):
    team = Team(payload=PointPayload())
    flight = loop.LoadLoop(team).fly(
        kind().build(team, limits), loop.Eight(yaw_rad=0.0), loop.empty_world(team), seconds=3.0
    )
    assert flight.rmse_m < 0.03
    np.testing.assert_array_equal(flight.load[:, 3:7], np.tile([1.0, 0, 0, 0], (60, 1)))


def check_wild_starts(seeds, limits, loop):
    world, controller = loop.empty_world(TEAM), Nmpc().build(TEAM, limits)
    for seed in seeds:
        flight = loop.LoadLoop(TEAM).fly(
            controller, loop.Rest(), world, seconds=3.0, x0=wild_start(seed)
        )
        error = np.linalg.norm(flight.load[:, :3] - flight.reference, axis=1)
        assert len(error) == 60, seed
        assert error.max() < 4.0, seed
        assert error[-1] < 2.0, seed
        assert np.abs(flight.load[-1, 10:]).max() < 1.0, seed
        assert np.linalg.norm(flight.load[-1, 4:6]) < 0.1, seed
        assert SolveStatus.FAILED not in flight.statuses, seed


def test_wild_starts_come_to_rest(limits, loop):
    check_wild_starts(range(8), limits, loop)


@pytest.mark.slow
def test_two_hundred_wild_starts_come_to_rest(limits, loop):
    check_wild_starts(range(200), limits, loop)
