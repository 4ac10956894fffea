# SPDX-License-Identifier: Apache-2.0
"""Pieces of depth images against SciPy's labels and plain sums."""

import numpy as np
import pytest
from scipy.ndimage import label

from skyhaul.perception.scene.pieces import pieces_of


@pytest.mark.parametrize("seed", range(10))
def test_at_one_depth_pieces_are_the_connected_parts(seed):
    use = np.random.default_rng(seed).random((40, 60)) < 0.55
    z = np.full(use.shape, 2.0)
    points = np.random.default_rng(seed + 100).normal(size=(*use.shape, 3))
    free = np.random.default_rng(seed + 200).random(use.shape) < 0.5
    got = pieces_of(points, z, use, free, 0.1, 0.0)
    want, m = label(use)
    assert len(got.size) == m
    np.testing.assert_array_equal(got.label >= 0, use)
    for i in range(m):
        mine = got.label == i
        (name,) = np.unique(want[mine])
        np.testing.assert_array_equal(mine, want == name)
        assert got.size[i] == mine.sum()
        assert got.free[i] == (mine & free).sum()
        np.testing.assert_allclose(got.mean[i], points[mine].mean(axis=0), atol=1e-12)
        where = np.argwhere(mine)
        np.testing.assert_array_equal(got.first[i], where.min(axis=0))
        np.testing.assert_array_equal(got.last[i], where.max(axis=0))


def test_a_step_of_depth_parts_what_touches_in_the_image():
    z = np.full((10, 20), 2.0)
    z[:, 10:] = 2.3
    every, points = np.ones(z.shape, bool), np.zeros((*z.shape, 3))
    assert len(pieces_of(points, z, every, every, 0.2, 0.0).size) == 2
    assert len(pieces_of(points, z, every, every, 0.4, 0.0).size) == 1
    assert len(pieces_of(points, z, every, every, 0.2, 0.03).size) == 1
    assert pieces_of(points, z, every, every, 0.2, 0.0).near.tolist() == [2.0, 2.3]


def test_a_slanted_surface_is_one_piece():
    z = np.tile(np.linspace(1.0, 4.0, 80), (30, 1))
    every = np.ones(z.shape, bool)
    assert len(pieces_of(np.zeros((*z.shape, 3)), z, every, every, 0.1, 0.0).size) == 1


def test_nothing_gives_no_pieces():
    z, none = np.full((5, 5), np.nan), np.zeros((5, 5), bool)
    assert len(pieces_of(np.zeros((5, 5, 3)), z, none, none, 0.1, 0.0).size) == 0
