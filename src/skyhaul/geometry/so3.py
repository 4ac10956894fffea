# SPDX-License-Identifier: Apache-2.0
"""Rotations in 3-D: rotation matrices, rotation vectors and, for display, Euler angles.

For stacks of arrays; the numba twins are in `geometry.kernels`, quaternions in
`geometry.quaternion`.
"""

import numpy as np

from skyhaul.errors import GeometryError
from skyhaul.geometry.quaternion import R_to_quat, quat_exp, quat_log, quat_to_R
from skyhaul.types import Array


def hat(v: Array) -> Array:
    """Skew-symmetric matrices of vectors, S u = v x u: (..., 3) -> (..., 3, 3)."""
    x, y, z = np.moveaxis(np.asarray(v, dtype=np.float64), -1, 0)
    o = np.zeros_like(x)
    rows = [[o, -z, y], [z, o, -x], [-y, x, o]]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def vee(S: Array) -> Array:
    """Vectors of skew-symmetric matrices: (..., 3, 3) -> (..., 3)."""
    return np.stack([S[..., 2, 1], S[..., 0, 2], S[..., 1, 0]], axis=-1)


def so3_exp(phi: Array) -> Array:
    """Rotation matrices of rotation vectors [rad]: (..., 3) -> (..., 3, 3)."""
    return quat_to_R(quat_exp(phi))


def so3_log(R: Array) -> Array:
    """Rotation vectors [rad] of rotation matrices, at most pi long: (..., 3, 3) -> (..., 3)."""
    return quat_log(R_to_quat(R))


def rotation_z(angle: Array | float) -> Array:
    """Rotations about z: (...) [rad] -> (..., 3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    o, i = np.zeros_like(c), np.ones_like(c)
    rows = [[c, -s, o], [s, c, o], [o, o, i]]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def euler_zyx(R: Array) -> Array:
    """Roll, pitch, yaw of rotation matrices, for display: (..., 3, 3) -> (..., 3) [rad].

    Limits: Pitch stays within +-pi/2, where roll and yaw are not unique.
    """
    roll = np.arctan2(R[..., 2, 1], R[..., 2, 2])
    pitch = -np.arcsin(np.clip(R[..., 2, 0], -1.0, 1.0))
    yaw = np.arctan2(R[..., 1, 0], R[..., 0, 0])
    return np.stack([roll, pitch, yaw], axis=-1)


def euler_to_R(roll_pitch_yaw: Array) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll): (..., 3) [rad] -> (..., 3, 3).

    Source:    Paper eq. (3).
    Deviation: Eq. (3) swaps roll and yaw (PAPER_NOTES 1); see `test_yaw_turns_about_the_vertical`.
    """
    x, y, z = np.eye(3)
    roll, pitch, yaw = np.moveaxis(np.asarray(roll_pitch_yaw, dtype=np.float64), -1, 0)[..., None]
    turned: Array = so3_exp(yaw * z) @ so3_exp(pitch * y) @ so3_exp(roll * x)
    return turned


def euler_rate_map(roll_pitch_yaw: Array) -> Array:
    """Gamma: d(roll, pitch, yaw)/dt = Gamma w_B, for display: (..., 3) -> (..., 3, 3).

    Source:    Paper eq. (4).
    Deviation: Attitude is integrated as a quaternion; Gamma is singular at pitch +-pi/2
        (PAPER_NOTES 2). See `test_gamma_maps_body_rates_to_euler_rates`.
    """
    roll, pitch, _ = np.moveaxis(np.asarray(roll_pitch_yaw, dtype=np.float64), -1, 0)
    s, c, t = np.sin(roll), np.cos(roll), np.tan(pitch)
    sec = 1.0 / np.cos(pitch)
    o, i = np.zeros_like(roll), np.ones_like(roll)
    rows = [[i, s * t, c * t], [o, c, -s], [o, s * sec, c * sec]]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def check_rotation(R: Array, name: str) -> None:
    """Refuse what is no rotation matrix, (..., 3, 3).

    Raises:
        GeometryError: when R^T R differs from the identity or R mirrors.
    """
    error = float(np.max(np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3))))
    if not error < 1e-6:
        raise GeometryError(
            f"{name} is no rotation: R^T R differs from the identity by {error:.2g}"
        )
    if float(np.min(np.linalg.det(R))) < 0.0:
        raise GeometryError(f"{name} mirrors: its determinant is -1, a rotation has +1")
