# SPDX-License-Identifier: Apache-2.0
"""Half-spaces never promise more room than there is, and do not forget the other wall."""

from dataclasses import replace

import numpy as np

from skyhaul.control.nmpc.corridor import REACH_M, STATIC_ROWS, corridor_rows
from skyhaul.mapping.api import OccupancyGrid
from skyhaul.mapping.mapper import static_map
from skyhaul.model import Team
from skyhaul.model.envelope import TeamShape

SMALL = TeamShape(radius_m=0.3, above_m=0.3, below_m=0.3)


def passage(width):
    """Two walls normal to y, `width` apart."""
    occupied = np.zeros((60, 60, 60), dtype=bool)
    y = -3.0 + 0.1 * np.arange(60)
    occupied[:, np.abs(y) > 0.5 * width, :] = True
    return static_map(OccupancyGrid(occupied, np.full(3, -3.0), 0.1), SMALL)


def test_half_spaces_of_movers_are_inside_their_true_clearance(loop):
    rng = np.random.default_rng(0)
    world = loop.empty_world(Team())
    for seed in range(20):
        tracks = tuple(
            loop.mover(i, rng.uniform(-2.5, 2.5, 3), rng.uniform(-1.0, 1.0, 3)) for i in range(3)
        )
        view = loop.moved(world, tracks, 0)
        p, t = rng.uniform(-1.0, 1.0, (8, 3)), rng.uniform(0.0, 2e6, 8)
        rows = corridor_rows(view, p, t, 3)
        step = 0.3 * rng.normal(size=(8, 3))
        promised = rows.clearance + np.einsum("kra,ka->kr", rows.normal_W, step)
        there = view.clearance(p + step, t)
        inside = np.where(rows.active > 0.0, promised, np.inf)[:, STATIC_ROWS:].min(axis=1)
        clear = inside >= 0.0
        outside = there >= -1e-9
        near = rows.clearance[:, STATIC_ROWS:].min(axis=1) > 0.0  # linearised from outside
        assert not np.any(clear & near & ~outside & np.isfinite(inside)), seed


def test_normal_is_the_gradient_of_the_clearance(loop):
    tracks = (loop.mover(0, (1.5, 0.2, 0.4), (0.0, 0.0, 0.0)),)
    view = loop.moved(loop.empty_world(Team()), tracks, 0)
    p, t, h = np.zeros((1, 3)), np.zeros(1), 1e-5
    rows = corridor_rows(view, p, t, 2)
    slope = [
        (view.clearance(p + h * a, t) - view.clearance(p - h * a, t))[0] / (2 * h)
        for a in np.eye(3)
    ]
    np.testing.assert_allclose(rows.normal_W[0, STATIC_ROWS], slope, atol=1e-6)
    assert rows.active[0, STATIC_ROWS + 1] == 0.0


def test_both_walls_of_a_passage_are_seen():
    rows = corridor_rows(passage(1.4), np.array([[0.0, 0.15, 0.0]]), np.zeros(1), 0)
    np.testing.assert_array_equal(rows.active[0], 1.0)
    assert rows.normal_W[0, 0, 1] < -0.9
    assert rows.normal_W[0, 1, 1] > 0.9
    room = rows.clearance[0] + rows.normal_W[0, :, 1] * np.array([[-0.15], [-0.7]])
    assert room[0].min() > 0.0  # the middle is free by both
    assert room[1].min() < 0.0  # the other wall is not


def test_far_obstacles_do_not_enter(loop):
    tracks = (loop.mover(0, (REACH_M + 2.0, 0.0, 0.0), (0.0, 0.0, 0.0)),)
    view = loop.moved(loop.empty_world(Team()), tracks, 0)
    rows = corridor_rows(view, np.zeros((2, 3)), np.zeros(2), 6)
    np.testing.assert_array_equal(rows.active, 0.0)


def test_the_nearest_movers_are_taken(loop):
    world = loop.empty_world(Team())
    tracks = tuple(loop.mover(i, (2.4 - 0.2 * i, 0.0, 0.3), (0.0, 0.0, 0.0)) for i in range(5))
    view = loop.moved(world, tracks, 0)
    rows = corridor_rows(view, np.zeros((1, 3)), np.zeros(1), 2)
    gaps = sorted(view.clearance(np.zeros((1, 3)), np.zeros(1)).tolist())
    np.testing.assert_allclose(rows.clearance[0, STATIC_ROWS:].min(), gaps[0], atol=1e-12)
    alone = replace(view, tracks=tracks[3:])
    other = corridor_rows(alone, np.zeros((1, 3)), np.zeros(1), 2)
    np.testing.assert_allclose(
        np.sort(rows.clearance[0, STATIC_ROWS:]), np.sort(other.clearance[0, STATIC_ROWS:])
    )
