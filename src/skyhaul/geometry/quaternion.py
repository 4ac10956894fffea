# SPDX-License-Identifier: Apache-2.0
"""Unit quaternions, Hamilton, (w, x, y, z), for stacks of arrays; any leading axes broadcast.

The numba twins are in `geometry.kernels`. q_WB turns B axes into W axes: v_W = R(q_WB) v_B.
"""

import numpy as np

from skyhaul.types import Array


def quat_mul(a: Array, b: Array) -> Array:
    """Hamilton product a (x) b: (..., 4), (..., 4) -> (..., 4); R(a (x) b) = R(a) R(b)."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, dtype=np.float64), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, dtype=np.float64), -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def quat_conj(q: Array) -> Array:
    """Conjugate, the inverse rotation: (..., 4) -> (..., 4)."""
    conjugate: Array = q * np.array([1.0, -1.0, -1.0, -1.0])
    return conjugate


def quat_normalize(q: Array) -> Array:
    """The same direction at unit length: (..., 4) -> (..., 4)."""
    unit: Array = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return unit


def quat_to_R(q: Array) -> Array:
    """Rotation matrices of unit quaternions: (..., 4) -> (..., 3, 3)."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def R_to_quat(R: Array) -> Array:
    """Unit quaternions of rotation matrices, w >= 0: (..., 3, 3) -> (..., 4).

    Each row of 4 q q^T is an unscaled answer; the longest one is taken.
    """
    R = np.asarray(R, dtype=np.float64)
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    wx, wy, wz = (
        R[..., 2, 1] - R[..., 1, 2],
        R[..., 0, 2] - R[..., 2, 0],
        R[..., 1, 0] - R[..., 0, 1],
    )
    xy, xz, yz = (
        R[..., 0, 1] + R[..., 1, 0],
        R[..., 0, 2] + R[..., 2, 0],
        R[..., 1, 2] + R[..., 2, 1],
    )
    rows = [
        [1.0 + xx + yy + zz, wx, wy, wz],
        [wx, 1.0 + xx - yy - zz, xy, xz],
        [wy, xy, 1.0 - xx + yy - zz, yz],
        [wz, xz, yz, 1.0 - xx - yy + zz],
    ]
    K = np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)
    best = np.argmax(np.diagonal(K, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(K, best[..., None, None], axis=-2)[..., 0, :]
    return quat_normalize(np.where(q[..., :1] < 0.0, -q, q))


def quat_rotate(q: Array, v: Array) -> Array:
    """R(q) v: (..., 4), (..., 3) -> (..., 3)."""
    u, w = q[..., 1:], q[..., :1]
    t = 2.0 * np.cross(u, v)
    turned: Array = v + w * t + np.cross(u, t)
    return turned


def quat_exp(phi: Array) -> Array:
    """Exp: rotation vectors [rad] to unit quaternions, (..., 3) -> (..., 4).

    Exp(phi) = (cos(|phi|/2), sin(|phi|/2) phi/|phi|)

    Source: Paper eq. (9), where the half stands outside (PAPER_NOTES 41).
    """
    half = 0.5 * np.asarray(phi, dtype=np.float64)
    angle = np.linalg.norm(half, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle), np.sinc(angle / np.pi) * half], axis=-1)


def quat_log(q: Array) -> Array:
    """Log: rotation vectors [rad] of the shorter way, (..., 4) -> (..., 3).

    q and -q are the same rotation and give the same vector, at most pi long.
    """
    q = np.where(q[..., :1] < 0.0, -q, q)
    w, v = q[..., :1], q[..., 1:]
    n = np.linalg.norm(v, axis=-1, keepdims=True)
    small = n < 1e-8
    safe = np.where(small, 1.0, n)
    scale = np.where(small, 2.0 / np.where(small, w, 1.0), 2.0 * np.arctan2(n, w) / safe)
    phi: Array = scale * v
    return phi
