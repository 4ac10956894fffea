# SPDX-License-Identifier: Apache-2.0
"""Ways past a blocked place, and places to wait near a taken goal."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.shapes import Sphere
from skyhaul.mapping.api import OccupancyGrid
from skyhaul.mapping.mapper import static_map
from skyhaul.model.envelope import TeamShape
from skyhaul.perception.api import Track
from skyhaul.planning.detours import detours, posts

PATH = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 6.0, 3.0]])
SHAPE = TeamShape(radius_m=0.5, above_m=0.9, below_m=0.2)
GOAL = np.array([6.0, 6.0, 4.0])
EMPTY = static_map(OccupancyGrid(np.zeros((100, 100, 100), np.bool_), np.zeros(3), 0.1), SHAPE)


def mover(p_WO, v_WO=(0.0, 0.0, 0.0), growth_mps=0.05):
    return Track(
        0, 0, Sphere(radius_m=0.15), np.array(p_WO), np.eye(3), np.array(v_WO, np.float64),
        np.zeros((6, 6)), growth_mps, 0.0,
    )  # fmt: skip


@pytest.mark.parametrize("way_m", [1.0, 2.0, 6.0])
def test_detours_pass_a_place_at_the_distance_asked_for_on_all_sides(way_m):
    place = (
        [way_m, 0.0, 0.0]
        if way_m < 4.0
        else PATH[1] + (way_m - 4.0) / 45**0.5 * (PATH[2] - PATH[1])
    )
    found = detours(PATH, way_m, (0.7, 1.5), 8)
    assert len(found) == 16
    for path, aside in zip(found, [0.7] * 8 + [1.5] * 8, strict=True):
        np.testing.assert_array_equal(path[[0, -1]], PATH[[0, -1]])
        off = np.linalg.norm(path - place, axis=1)
        assert np.isclose(off, aside).sum() == 1
    vias = np.array([p[np.argmin(np.abs(np.linalg.norm(p - place, axis=1) - 0.7))]
                     for p in found[:8]])  # fmt: skip
    np.testing.assert_allclose(vias.mean(axis=0), place, atol=1e-9)


def test_a_detour_drops_the_corners_beside_the_place_and_keeps_those_farther_off():
    near = detours(PATH, 3.8, (0.5,), 4)
    assert all(not (p == PATH[1]).all(axis=1).any() for p in near)
    far = detours(PATH, 1.0, (0.5,), 4)
    assert all((p == PATH[1]).all(axis=1).any() for p in far)


def test_posts_are_clear_for_as_long_as_the_tubes_reach_and_the_handiest_comes_first():
    m = replace(EMPTY, tracks=(mover(GOAL),), tube_horizon_s=5.0)
    p_WS = np.array([1.0, 1.0, 1.0])
    found = posts(m, p_WS, GOAL, (0.4, 0.8, 1.2), 1.0)
    assert len(found) > 3
    times = np.linspace(1.0, 5.0, 30) * 1e6
    for place in found:
        assert m.clearance(np.tile(place, (30, 1)), times).min() > 0.05
    off = np.linalg.norm(found - GOAL, axis=1)
    assert off[0] <= off.min() + 0.41
    assert found[0] @ (p_WS - GOAL) > found[-1] @ (p_WS - GOAL) or off[0] < off[-1]


def test_a_flat_team_waits_above_a_goal_where_it_can_be_nearer_than_beside_it():
    wide = TeamShape(radius_m=1.0, above_m=0.9, below_m=0.2)
    m = replace(EMPTY, tracks=(mover(GOAL),), tube_horizon_s=5.0, shape=wide)
    place = posts(m, np.array([2.0, 2.0, 2.0]), GOAL, (0.4, 0.8, 1.2), 1.0)[0]
    assert place[2] > GOAL[2]


def test_no_post_lies_where_a_mover_is_going():
    coming = replace(
        EMPTY, tracks=(mover(GOAL - [2.0, 0, 0], (0.5, 0.0, 0.0)),), tube_horizon_s=5.0
    )
    for place in posts(coming, np.array([6.0, 1.0, 4.0]), GOAL, (0.4, 0.8, 1.2), 2.0):
        assert abs(place[1] - GOAL[1]) + abs(place[2] - GOAL[2]) > 0.3
