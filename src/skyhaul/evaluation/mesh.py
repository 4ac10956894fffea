# SPDX-License-Identifier: Apache-2.0
"""Triangle meshes of the shapes that a flight is drawn with."""

from typing import NamedTuple

import numpy as np

from skyhaul.geometry.shapes import BOX, CAPSULE, SPHERE
from skyhaul.types import Array


class Mesh(NamedTuple):
    """Triangles with a normal at each corner."""

    p: Array  # (t, 3, 3) [m]
    n: Array  # (t, 3, 3) unit

    def placed(self, R: Array, p: Array) -> "Mesh":
        """Turned by R (3, 3) and moved by p (3,) [m]."""
        return Mesh(self.p @ R.T + p, self.n @ R.T)


def box(half: Array) -> Mesh:
    """A box about the origin with half edges (3,) [m]."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, -1], [1, 1], [-1, 1]], dtype=np.float64)
    points, normals = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            face = np.insert(square, axis, sign, axis=1)
            points.append(face.reshape(2, 3, 3))
            normals.append(np.broadcast_to(sign * np.eye(3)[axis], (2, 3, 3)))
    return Mesh(np.concatenate(points) * half, np.concatenate(normals))


def turned(profile: Array, sides: int = 24) -> Mesh:
    """Surface of revolution about z; rows of the profile: radius, z, normal radius, normal z."""
    a = 2.0 * np.pi * np.arange(sides + 1) / sides
    c, s = np.cos(a), np.sin(a)
    r, z, nr, nz = profile.T[:, :, None]
    p = np.stack([r * c, r * s, z + 0.0 * c], axis=-1)
    n = np.stack([nr * c, nr * s, nz + 0.0 * c], axis=-1)
    return Mesh(_quads(p), _quads(n))


def capsule(radius: float, half: float, rows: int = 8) -> Mesh:
    """A capsule along z; half = 0 is a sphere [m]."""
    a = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * rows + 1)
    a = np.insert(a, rows, 0.0)
    shift = np.where(np.arange(len(a)) <= rows, -half, half)
    c, s = np.cos(a), np.sin(a)
    return turned(np.column_stack([radius * c, radius * s + shift, c, s]))


def cylinder(radius: float, half: float, sides: int = 20) -> Mesh:
    """An upright cylinder [m]."""
    rows = [
        (0.0, -half, 0.0, -1.0),
        (radius, -half, 0.0, -1.0),
        (radius, -half, 1.0, 0.0),
        (radius, half, 1.0, 0.0),
        (radius, half, 0.0, 1.0),
        (0.0, half, 0.0, 1.0),
    ]
    return turned(np.array(rows), sides)


def solid(kind: int, size: Array) -> Mesh:
    """Mesh of an obstacle, its code and size as in `geometry.shapes.ShapeArrays`."""
    if kind == BOX:
        return box(size)
    assert kind in (SPHERE, CAPSULE), "obstacles are boxes, spheres or capsules"
    return capsule(float(size[0]), float(size[1]) if kind == CAPSULE else 0.0)


def _quads(grid: Array) -> Array:
    """Two triangles for each cell of a grid of points, (rows, columns, 3)."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    cells = np.stack([a, b, c, a, c, d], axis=2)
    return np.ascontiguousarray(cells.reshape(-1, 3, 3))
