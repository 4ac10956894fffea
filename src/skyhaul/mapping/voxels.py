# SPDX-License-Identifier: Apache-2.0
"""Standing shapes -> voxels: a voxel is occupied when a shape reaches into it."""

import math

import numpy as np

from skyhaul.geometry.shapes import BOX, CAPSULE, SPHERE, shape_size
from skyhaul.jit import njit
from skyhaul.perception.api import StaticObject
from skyhaul.types import Array, IntArray, Mask

# mypy: disable-error-code="no-any-return"

TOUCH_M = 1e-9
"""A shape that only touches a voxel does not occupy it [m]."""


def shape_extent(obj: StaticObject) -> tuple[Array, Array]:
    """Smallest and largest corner of a shape, (3,) each [m]."""
    kind, size, _ = shape_size(obj.shape)
    if kind == SPHERE:
        reach = np.full(3, size[0])
    elif kind == CAPSULE:
        reach = size[0] + size[1] * np.abs(obj.R_WO[:, 2])
    else:
        reach = np.abs(obj.R_WO) @ size
    return obj.p_WO - reach, obj.p_WO + reach


def cells_of(low_m: Array, high_m: Array, p_WO: Array, voxel_m: float, n: IntArray) -> IntArray:
    """Voxels that a box of the world overlaps: (2, 3), first and one past the last, clipped."""
    first = np.floor((low_m - p_WO) / voxel_m + 0.5 + TOUCH_M)
    last = np.ceil((high_m - p_WO) / voxel_m + 0.5 - TOUCH_M)
    return np.clip(np.array([first, last]), 0, n).astype(np.int64)


def mark(
    occupied: Mask, p_WO: Array, voxel_m: float, obj: StaticObject, cells: IntArray | None = None
) -> None:
    """Set the voxels that a shape reaches into; changes `occupied`, (nx, ny, nz).

    Args:
        occupied: The grid, written to.
        p_WO: Centre of voxel (0, 0, 0), (3,) [m].
        voxel_m: Edge of a voxel [m].
        obj: The shape.
        cells: Only voxels in this range, (2, 3); None: everywhere.
    """
    own = cells_of(*shape_extent(obj), p_WO, voxel_m, np.array(occupied.shape))
    if cells is not None:
        own = np.array([np.maximum(own[0], cells[0]), np.minimum(own[1], cells[1])])
    if np.all(own[0] < own[1]):
        kind, size, _ = shape_size(obj.shape)
        _mark(occupied, p_WO, voxel_m, own, kind, size, obj.p_WO, obj.R_WO)


@njit
def _mark(
    occupied: Mask,
    p_WG: Array,
    voxel: float,
    cells: IntArray,
    kind: int,
    size: Array,
    p_WO: Array,
    R_WO: Array,
) -> None:
    """`mark` over a range of voxels."""
    half = 0.5 * voxel
    for i in range(cells[0, 0], cells[1, 0]):
        x = p_WG[0] + voxel * i - p_WO[0]
        for j in range(cells[0, 1], cells[1, 1]):
            y = p_WG[1] + voxel * j - p_WO[1]
            for k in range(cells[0, 2], cells[1, 2]):
                z = p_WG[2] + voxel * k - p_WO[2]
                if kind == SPHERE:
                    hit = _gap(x, half) + _gap(y, half) + _gap(z, half) < _reach(size[0])
                elif kind == BOX:
                    hit = _boxes_meet(x, y, z, half - TOUCH_M, size, R_WO)
                else:
                    hit = _axis_gap(x, y, z, half, size[1], R_WO) < _reach(size[0])
                if hit:
                    occupied[i, j, k] = True


@njit
def _reach(radius: float) -> float:
    """Square of a radius, less what counts as touching."""
    return max(radius - TOUCH_M, 0.0) ** 2


@njit
def _gap(x: float, half: float) -> float:
    """Squared distance of 0 to an interval around x, along one axis."""
    d = max(abs(x) - half, 0.0)
    return d * d


@njit
def _axis_gap(x: float, y: float, z: float, half: float, reach: float, R_WO: Array) -> float:
    """Squared distance of a capsule's axis to the voxel at (x, y, z), seen from its centre.

    It is convex along the axis: bisection on the sign of the slope.
    """
    ux, uy, uz = R_WO[0, 2], R_WO[1, 2], R_WO[2, 2]
    low, high = -reach, reach
    for _ in range(40):
        t = 0.5 * (low + high)
        dx, dy, dz = t * ux - x, t * uy - y, t * uz - z
        slope = ux * math.copysign(max(abs(dx) - half, 0.0), dx)
        slope += uy * math.copysign(max(abs(dy) - half, 0.0), dy)
        slope += uz * math.copysign(max(abs(dz) - half, 0.0), dz)
        if slope < 0.0:
            low = t
        else:
            high = t
    t = 0.5 * (low + high)
    return _gap(t * ux - x, half) + _gap(t * uy - y, half) + _gap(t * uz - z, half)


@njit
def _boxes_meet(x: float, y: float, z: float, half: float, e: Array, R: Array) -> bool:
    """Whether a turned box with half edges e overlaps the voxel at (x, y, z) from its centre.

    Separating axes: 3 of the voxel, 3 of the box, 9 products of an edge of each.
    """
    for a in range(3):
        d = x if a == 0 else (y if a == 1 else z)
        if abs(d) >= half + abs(R[a, 0]) * e[0] + abs(R[a, 1]) * e[1] + abs(R[a, 2]) * e[2]:
            return False
        d = x * R[0, a] + y * R[1, a] + z * R[2, a]
        if abs(d) >= e[a] + half * (abs(R[0, a]) + abs(R[1, a]) + abs(R[2, a])):
            return False
    for b in range(3):
        b1, b2 = (b + 1) % 3, (b + 2) % 3
        for a in range(3):
            a1, a2 = (a + 1) % 3, (a + 2) % 3
            # axis = unit vector a x column b of R: components a1: -R[a2, b], a2: R[a1, b]
            n1, n2 = -R[a2, b], R[a1, b]
            if n1 * n1 + n2 * n2 < 1e-12:
                continue
            d1 = x if a1 == 0 else (y if a1 == 1 else z)
            d2 = x if a2 == 0 else (y if a2 == 1 else z)
            box = e[b1] * abs(n1 * R[a1, b1] + n2 * R[a2, b1])
            box += e[b2] * abs(n1 * R[a1, b2] + n2 * R[a2, b2])
            if abs(n1 * d1 + n2 * d2) >= box + half * (abs(n1) + abs(n2)):
                return False
    return True
