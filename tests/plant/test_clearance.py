# SPDX-License-Identifier: Apache-2.0
"""Tests of `plant.clearance`."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skyhaul.geometry.distance import bounding_radius, shape_distance
from skyhaul.geometry.shapes import BOX, CAPSULE, SPHERE, ShapeArrays
from skyhaul.model.team import PointPayload, Team
from skyhaul.plant.clearance import (
    LEAVE_M,
    Surroundings,
    room_distance,
    touch_memory,
    update_touches,
)
from skyhaul.plant.observe import team_bodies

N = 3
ATTACHED = np.ones(N, dtype=np.bool_)


def posed_team(rng, team, spread):
    """Bodies of a team at random poses; cables run anywhere."""
    bodies = team_bodies(team)
    rows = len(bodies.kind)
    bodies.p_WO[:] = rng.uniform(-spread, spread, (rows, 3)) + UP
    bodies.R_WO[:] = Rotation.random(rows, rng=rng).as_matrix()
    bodies.size[1 + team.count :, 1] = rng.uniform(0.1, 0.5, team.count)
    return bodies


def random_obstacles(rng, m, spread):
    kind = rng.choice([SPHERE, BOX, CAPSULE], m)
    size = rng.uniform(0.1, 0.6, (m, 3))
    p = rng.uniform(-spread, spread, (m, 3)) + UP
    return ShapeArrays(kind, size, p, Rotation.random(m, rng=rng).as_matrix())


def around(obstacles, present=None):
    m = len(obstacles.kind)
    reach = np.array([bounding_radius(obstacles, j) for j in range(m)])
    there = np.ones(m, dtype=np.bool_) if present is None else present
    return Surroundings(obstacles, reach, there, np.full(3, -50.0), np.full(3, 50.0))


UP = np.array([0.0, 0.0, 10.0])
NOTHING = ShapeArrays(
    np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))
)


def pairs(memory, count):
    return {(int(r), int(c)) for r, c in memory.begun[:count]}


@pytest.mark.parametrize(("spread", "least"), [(0.8, 60), (3.0, 0)])
def test_clearance_and_contacts_are_those_of_all_pairs(spread, least):
    rng = np.random.default_rng(0)
    m, touched = 12, 0
    memory = touch_memory(N, m)
    for _ in range(60):  # one memory all along: the last closest pair must not mislead
        bodies, obstacles = posed_team(rng, Team(count=N), spread), random_obstacles(rng, m, spread)
        present, attached = rng.random(m) < 0.8, rng.random(N) < 0.7
        memory.touching[:] = False
        surroundings = around(obstacles, present)
        clearance, count, gap = update_touches(bodies, attached, surroundings, memory)
        rows = [r for r in range(1 + 2 * N) if r <= N or attached[r - 1 - N]]
        d = {
            (r, j): shape_distance(bodies, r, obstacles, j)
            for r in rows
            for j in np.flatnonzero(present)
        }
        np.testing.assert_allclose(clearance, min(d.values()), atol=1e-8)
        solid = range(1 + N)
        apart = [shape_distance(bodies, r, bodies, k) for r in solid for k in range(r)]
        apart += [d[r, j] for r, j in d if r <= N]
        assert gap <= min([*apart, *(room_distance(bodies, r, surroundings) for r in solid)])
        expected = {pair for pair, value in d.items() if value <= 0.0}
        others = [(r, k) for r in range(1, 1 + N) for k in range(r)]
        others += [(r, k) for r in rows if r > N for k in range(1, 1 + N) if r != k + N]
        expected |= {
            (r, m + 1 + k) for r, k in others if shape_distance(bodies, r, bodies, k) <= 0.0
        }
        assert pairs(memory, count) == expected
        touched += len(expected)
    assert touched >= least


def test_a_contact_is_told_once_until_the_bodies_part():
    bodies = posed_team(np.random.default_rng(1), Team(count=N), 0.0)
    bodies.p_WO[:, 0] = 5.0 * np.arange(1 + 2 * N)
    ball = ShapeArrays(
        np.array([SPHERE]), np.array([[0.3, 0.0, 0.0]]), np.zeros((1, 3)), np.eye(3)[None]
    )
    bodies.R_WO[:] = np.eye(3)
    memory, told = touch_memory(N, 1), []
    half = bodies.size[0, 2]
    for gap in (0.1, 0.0, -0.01, 0.5 * LEAVE_M, -0.01, 2.0 * LEAVE_M, -0.01):
        ball.p_WO[0] = bodies.p_WO[0] + [0.0, 0.0, half + 0.3 + gap]
        clearance, count, _ = update_touches(bodies, ATTACHED, around(ball), memory)
        np.testing.assert_allclose(clearance, gap, atol=1e-9)
        told.append(count)
    assert told == [0, 1, 0, 0, 0, 0, 1]


def test_an_open_cable_is_not_there():
    bodies = posed_team(np.random.default_rng(2), Team(count=N), 0.0)
    bodies.p_WO[:, 0] = 5.0 * np.arange(1 + 2 * N)
    ball = ShapeArrays(
        np.array([SPHERE]),
        np.array([[0.05, 0.0, 0.0]]),
        bodies.p_WO[1 + N : 2 + N].copy(),
        np.eye(3)[None],
    )
    memory = touch_memory(N, 1)
    clearance, count, _ = update_touches(bodies, ATTACHED, around(ball), memory)
    assert clearance < 0.0
    assert pairs(memory, count) == {(1 + N, 0)}
    opened = np.array([False, True, True])
    clearance, count, _ = update_touches(bodies, opened, around(ball), memory)
    assert clearance > 3.0
    assert count == 0


def test_the_room_is_touched_at_its_walls():
    team = Team(count=N, payload=PointPayload())
    bodies = posed_team(np.random.default_rng(3), team, 0.0)
    bodies.R_WO[:] = np.eye(3)
    bodies.p_WO[:, 0] = 5.0 * np.arange(1 + 2 * N)
    for axis in range(3):
        for side in (-50.0, 50.0):
            moved = bodies._replace(p_WO=bodies.p_WO.copy())
            moved.p_WO[0, axis] = side - np.sign(side) * 0.051  # radius 0.05
            memory = touch_memory(N, 0)
            assert update_touches(moved, ATTACHED, around(NOTHING), memory)[1] == 0
            moved.p_WO[0, axis] = side - np.sign(side) * 0.049
            clearance, count, _ = update_touches(moved, ATTACHED, around(NOTHING), memory)
            assert clearance == np.inf
            assert pairs(memory, count) == {(0, 0)}
