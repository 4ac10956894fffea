# SPDX-License-Identifier: Apache-2.0
"""The clearance field against brute force over all voxels, and piecewise against all at once."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from skyhaul.geometry.shapes import BOX
from skyhaul.geometry.team_clearance import team_clearances
from skyhaul.mapping.field import lower_envelope, lowering_m, reach_cells, update_field
from skyhaul.model.envelope import TeamShape

SHAPE = TeamShape(radius_m=0.43, above_m=0.61, below_m=0.17)
VOXEL_M, TRUNCATION_M = 0.1, 1.3


def clutter(seed, n=(26, 24, 28), count=6) -> np.ndarray:
    rng = np.random.default_rng(seed)
    occupied = np.zeros(n, np.bool_)
    for _ in range(count):
        a, size = rng.integers(0, n), rng.integers(1, 5, 3)
        occupied[tuple(slice(i, i + s) for i, s in zip(a, size, strict=True))] = True
    return occupied


def field_of(occupied, shape=SHAPE) -> np.ndarray:
    out = np.full(occupied.shape, np.nan, np.float32)
    update_field(out, occupied, shape, VOXEL_M, TRUNCATION_M)
    return out


def brute_force(occupied, shape=SHAPE) -> np.ndarray:
    """Exact distance of the cylinder to the nearest occupied cube at every voxel centre."""
    cubes = VOXEL_M * np.argwhere(occupied)
    m = len(cubes)
    kind, size = np.full(m, BOX), np.full((m, 3), 0.5 * VOXEL_M)
    R = np.tile(np.eye(3), (m, 1, 1))
    dims = (shape.radius_m, shape.above_m, shape.below_m)
    out = [
        team_clearances(dims, VOXEL_M * np.array(c, np.float64), kind, size, cubes, R).min()
        for c in np.ndindex(occupied.shape)
    ]
    return np.array(out).reshape(occupied.shape)


@pytest.mark.parametrize("seed", range(3))
def test_field_is_the_exact_distance_to_the_voxels_less_half_a_diagonal(seed):
    occupied = clutter(seed, n=(18, 16, 20))
    exact, field = brute_force(occupied), field_of(occupied)
    outside = exact > 1e-9
    expected = np.minimum(exact - lowering_m(VOXEL_M), TRUNCATION_M)
    np.testing.assert_allclose(field[outside], expected[outside], atol=2e-6)


@pytest.mark.parametrize("seed", range(3))
def test_inside_the_grown_obstacles_it_is_the_distance_to_the_nearest_free_centre(seed):
    occupied = clutter(seed, n=(18, 16, 20))
    field = field_of(occupied)
    blocked = brute_force(occupied) <= 1e-9
    depth = np.minimum(VOXEL_M * distance_transform_edt(blocked), 1.2)
    np.testing.assert_allclose(field[blocked], -depth[blocked] - lowering_m(VOXEL_M), atol=2e-6)


@pytest.mark.parametrize("seed", range(8))
def test_updating_the_box_that_changed_equals_computing_all(seed):
    rng = np.random.default_rng(seed)
    n = np.array([44, 40, 46])
    occupied = clutter(seed, tuple(n), 5)
    field = field_of(occupied)
    for _ in range(3):
        low = rng.integers(0, n - 4)
        box = np.array([low, low + rng.integers(1, 5, 3)])
        occupied[tuple(slice(a, b) for a, b in box.T)] = rng.random() < 0.6
        grow = reach_cells(SHAPE, TRUNCATION_M, VOXEL_M)
        region = np.array([np.maximum(box[0] - grow, 0), np.minimum(box[1] + grow, n)])
        update_field(field, occupied, SHAPE, VOXEL_M, TRUNCATION_M, region)
    np.testing.assert_array_equal(field, field_of(occupied))


def test_an_empty_grid_is_clear_everywhere():
    np.testing.assert_array_equal(field_of(np.zeros((9, 8, 7), np.bool_)), np.float32(TRUNCATION_M))


def test_turning_the_grid_by_a_quarter_turns_the_field():
    occupied = clutter(3, (20, 20, 24))
    turned = np.ascontiguousarray(np.rot90(occupied, axes=(0, 1)))
    np.testing.assert_allclose(
        field_of(turned), np.rot90(field_of(occupied), axes=(0, 1)), atol=2e-6
    )


def test_the_field_of_two_grids_together_is_the_smaller_one_outside():
    a, b = clutter(4, count=2), clutter(5, count=2)
    both = field_of(a | b)
    smaller = np.minimum(field_of(a), field_of(b))
    outside = both > -lowering_m(VOXEL_M) + 1e-6
    np.testing.assert_array_equal(both[outside], smaller[outside])


@pytest.mark.parametrize("offset", [0.0, 0.5, -0.5, 3.7])
def test_lower_envelope_is_the_smallest_parabola(offset):
    rng = np.random.default_rng(1)
    f = rng.uniform(0.0, 40.0, 30)
    f[rng.random(30) < 0.5] = 1e12
    out = np.full(25, 1e12)
    lower_envelope(f, offset, out, np.empty(30, np.int64), np.empty(31))
    q = np.arange(25)[:, None] + offset
    np.testing.assert_allclose(out, (f + (q - np.arange(30)) ** 2).min(axis=1), rtol=1e-12)
