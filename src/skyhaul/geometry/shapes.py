# SPDX-License-Identifier: Apache-2.0
"""Shapes of obstacles and bodies, and their array form for the kernels."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.params import Params
from skyhaul.types import Array, IntArray, Vec3

SPHERE, BOX, CAPSULE, CYLINDER = 0, 1, 2, 3
"""Codes of `ShapeArrays.kind`. Cylinders are vehicles, never obstacles."""


@dataclass(frozen=True, kw_only=True)
class Sphere(Params):
    """A ball."""

    kind: Literal["sphere"] = "sphere"
    radius_m: float
    """Radius [m]."""

    def __post_init__(self) -> None:
        if not self.radius_m > 0.0:
            raise ValueError(f"radius_m must be > 0, got {self.radius_m}")


@dataclass(frozen=True, kw_only=True)
class Box(Params):
    """An upright box; it may be turned about the vertical."""

    kind: Literal["box"] = "box"
    size_m: Vec3
    """Edge lengths [m]."""
    yaw_deg: float = 0.0
    """Turn about z [deg]."""

    def __post_init__(self) -> None:
        if not min(self.size_m) > 0.0:
            raise ValueError(f"size_m must be > 0, got {self.size_m}")


@dataclass(frozen=True, kw_only=True)
class Capsule(Params):
    """A cylinder with round ends."""

    kind: Literal["capsule"] = "capsule"
    radius_m: float
    """Radius [m]."""
    length_m: float
    """Length of the axis between the centres of the two ends [m]."""
    axis: Vec3 = (0.0, 0.0, 1.0)
    """Direction of the axis, W axes; need not be unit."""

    def __post_init__(self) -> None:
        if not (self.radius_m > 0.0 and self.length_m > 0.0):
            raise ValueError(
                f"radius_m and length_m must be > 0, got {self.radius_m}, {self.length_m}"
            )
        if not any(self.axis):
            raise ValueError("axis must not be zero")


Shape = Sphere | Box | Capsule


class ShapeArrays(NamedTuple):
    """Posed shapes as struct of arrays, row j is shape j."""

    kind: IntArray  # (m,) SPHERE, BOX, CAPSULE or CYLINDER
    size: Array  # (m, 3) sphere: r, 0, 0; box: half edges; capsule, cylinder: r, half length, 0
    p_WO: Array  # (m, 3) centre [m]
    R_WO: Array  # (m, 3, 3); the axis of capsules and cylinders is O's z


def shape_size(shape: Shape) -> tuple[int, Array, Array]:
    """Code, size (3,) and rotation R_WO (3, 3) of a shape at rest, as `ShapeArrays` holds them."""
    match shape:
        case Sphere():
            return SPHERE, np.array([shape.radius_m, 0.0, 0.0]), np.eye(3)
        case Box():
            c, s = np.cos(np.radians(shape.yaw_deg)), np.sin(np.radians(shape.yaw_deg))
            R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            return BOX, 0.5 * np.array(shape.size_m), R
        case Capsule():
            z = np.array(shape.axis) / np.linalg.norm(shape.axis)
            x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
            x /= np.linalg.norm(x)
            size = np.array([shape.radius_m, 0.5 * shape.length_m, 0.0])
            return CAPSULE, size, np.column_stack([x, np.cross(z, x), z])


def pose_shapes(shapes: list[Shape], p_WO: Array) -> ShapeArrays:
    """Shapes at the given centres, (m, 3) [m]."""
    rows = [shape_size(s) for s in shapes]
    m = len(rows)
    return ShapeArrays(
        kind=np.array([k for k, _, _ in rows], dtype=np.int64),
        size=np.array([s for _, s, _ in rows]).reshape(m, 3),
        p_WO=np.asarray(p_WO, dtype=np.float64).reshape(m, 3),
        R_WO=np.array([R for _, _, R in rows]).reshape(m, 3, 3),
    )
