# SPDX-License-Identifier: Apache-2.0
"""Voxels hold every point of a shape, and only voxels that the shape reaches into."""

import numpy as np
import pytest

from skyhaul.geometry.distance import shape_distance
from skyhaul.geometry.shapes import Box, Capsule, ShapeArrays, Sphere, pose_shapes
from skyhaul.geometry.so3 import so3_exp
from skyhaul.mapping.voxels import mark, shape_extent
from skyhaul.perception.api import StaticObject

P_WO, VOXEL_M, N = np.array([-0.3, 0.2, 0.1]), 0.1, (24, 25, 26)
SHAPES = [
    Sphere(radius_m=0.33),
    Box(size_m=(0.5, 0.31, 0.77)),
    Capsule(radius_m=0.12, length_m=0.9),
]


def posed(shape, seed) -> StaticObject:
    rng = np.random.default_rng(seed)
    p_WO = P_WO + VOXEL_M * rng.uniform(8, 16, 3)
    return StaticObject(0, shape, p_WO, so3_exp(rng.normal(size=3)))


def arrays(obj: StaticObject) -> ShapeArrays:
    rows = pose_shapes([obj.shape], obj.p_WO)
    return rows._replace(R_WO=obj.R_WO[None])


def points_inside(obj: StaticObject, rng, count: int = 20_000) -> np.ndarray:
    """Rejection sampling, from definitions of the shapes."""
    s, p = obj.shape, rng.uniform(-0.6, 0.6, (count, 3))
    match s:
        case Sphere():
            inside = np.linalg.norm(p, axis=1) < s.radius_m
        case Box():
            inside = np.all(np.abs(p) < 0.5 * np.array(s.size_m), axis=1)
        case Capsule():
            off = p.copy()
            off[:, 2] -= np.clip(p[:, 2], -0.5 * s.length_m, 0.5 * s.length_m)
            inside = np.linalg.norm(off, axis=1) < s.radius_m
    return obj.p_WO + p[inside] @ obj.R_WO.T


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.kind)
@pytest.mark.parametrize("seed", range(4))
def test_every_point_of_a_shape_lies_in_an_occupied_voxel(shape, seed):
    obj, occupied = posed(shape, seed), np.zeros(N, np.bool_)
    mark(occupied, P_WO, VOXEL_M, obj)
    p = points_inside(obj, np.random.default_rng(seed))
    assert len(p) > 50
    cells = np.rint((p - P_WO) / VOXEL_M).astype(int)
    assert np.all(occupied[tuple(cells.T)])


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.kind)
@pytest.mark.parametrize("seed", range(4))
def test_occupied_voxels_are_those_whose_cube_overlaps_the_shape(shape, seed):
    obj, occupied = posed(shape, seed), np.zeros(N, np.bool_)
    mark(occupied, P_WO, VOXEL_M, obj)
    cube, other = pose_shapes([Box(size_m=(VOXEL_M,) * 3)], np.zeros(3)), arrays(obj)
    near = np.argwhere(np.ones(N, np.bool_))
    near = near[np.linalg.norm(P_WO + VOXEL_M * near - obj.p_WO, axis=1) < 0.75][::11]
    for cell in near:
        cube.p_WO[0] = P_WO + VOXEL_M * cell
        gap = shape_distance(cube, 0, other, 0)
        touching = abs(gap) < 1e-6
        assert touching or occupied[tuple(cell)] == (gap < 0.0)


def test_a_cube_on_the_grid_fills_its_own_voxels_only():
    occupied = np.zeros((10, 10, 10), np.bool_)
    cube = StaticObject(0, Box(size_m=(0.4, 0.4, 0.4)), np.array([0.4, 0.4, 0.4]), np.eye(3))
    mark(occupied, np.full(3, 0.05), 0.1, cube)
    expected = np.zeros_like(occupied)
    expected[2:6, 2:6, 2:6] = True
    np.testing.assert_array_equal(occupied, expected)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.kind)
def test_the_extent_is_the_tightest_upright_box(shape):
    obj = posed(shape, 5)
    p = points_inside(obj, np.random.default_rng(0), 200_000)
    low, high = shape_extent(obj)
    assert np.all(p > low)
    assert np.all(p < high)
    np.testing.assert_allclose(p.min(axis=0), low, atol=0.04)
    np.testing.assert_allclose(p.max(axis=0), high, atol=0.04)


def test_marking_a_part_of_the_grid_leaves_the_rest_alone():
    obj, whole, part = posed(SHAPES[0], 1), np.zeros(N, np.bool_), np.zeros(N, np.bool_)
    mark(whole, P_WO, VOXEL_M, obj)
    mark(part, P_WO, VOXEL_M, obj, np.array([[0, 0, 0], [12, 25, 26]]))
    np.testing.assert_array_equal(part[:12], whole[:12])
    assert not part[12:].any()
