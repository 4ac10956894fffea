# SPDX-License-Identifier: Apache-2.0
"""Vectors and rotations for numba kernels: scalar code, no allocation.

Vectors and quaternions may be arrays or tuples and come back as tuples; matrices are written into
`out`, which must not be one of the inputs. Names and conventions are those of `geometry.so3` and
`geometry.quaternion`, whose functions do the same for stacks of arrays.
"""

import math

from skyhaul.jit import njit
from skyhaul.types import Array

Vec = Array | tuple[float, float, float]
Quat = Array | tuple[float, float, float, float]
Vec3Out = tuple[float, float, float]
QuatOut = tuple[float, float, float, float]


@njit
def dot(a: Vec, b: Vec) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def norm(a: Vec) -> float:
    """Euclidean length."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@njit
def cross(a: Vec, b: Vec) -> Vec3Out:
    """Vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@njit
def mat_vec(M: Array, v: Vec) -> Vec3Out:
    """M v."""
    return (
        M[0, 0] * v[0] + M[0, 1] * v[1] + M[0, 2] * v[2],
        M[1, 0] * v[0] + M[1, 1] * v[1] + M[1, 2] * v[2],
        M[2, 0] * v[0] + M[2, 1] * v[1] + M[2, 2] * v[2],
    )


@njit
def mat_t_vec(M: Array, v: Vec) -> Vec3Out:
    """M^T v."""
    return (
        M[0, 0] * v[0] + M[1, 0] * v[1] + M[2, 0] * v[2],
        M[0, 1] * v[0] + M[1, 1] * v[1] + M[2, 1] * v[2],
        M[0, 2] * v[0] + M[1, 2] * v[1] + M[2, 2] * v[2],
    )


@njit
def mat_mul(A: Array, B: Array, out: Array) -> None:
    """Matrix product A B into `out`, (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@njit
def mat_t_mul(A: Array, B: Array, out: Array) -> None:
    """Matrix product A^T B into `out`, (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]


@njit
def hat(v: Vec, out: Array) -> None:
    """Skew-symmetric matrix S of v into `out`: S u = v x u."""
    out[0, 0] = out[1, 1] = out[2, 2] = 0.0
    out[0, 1], out[0, 2], out[1, 2] = -v[2], v[1], -v[0]
    out[1, 0], out[2, 0], out[2, 1] = v[2], -v[1], v[0]


@njit
def vee(S: Array) -> Vec3Out:
    """Vector of a skew-symmetric matrix, inverse of `hat`."""
    return S[2, 1], S[0, 2], S[1, 0]


@njit
def quat_mul(a: Quat, b: Quat) -> QuatOut:
    """Hamilton product a (x) b."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@njit
def quat_conj(q: Quat) -> QuatOut:
    """Conjugate: the inverse rotation."""
    return q[0], -q[1], -q[2], -q[3]


@njit
def quat_to_R(q: Quat, out: Array) -> None:
    """Rotation matrix of a unit quaternion into `out`, (3, 3)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    out[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    out[0, 1] = 2.0 * (x * y - w * z)
    out[0, 2] = 2.0 * (x * z + w * y)
    out[1, 0] = 2.0 * (x * y + w * z)
    out[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    out[1, 2] = 2.0 * (y * z - w * x)
    out[2, 0] = 2.0 * (x * z - w * y)
    out[2, 1] = 2.0 * (y * z + w * x)
    out[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@njit
def quat_rotate(q: Quat, v: Vec) -> Vec3Out:
    """R(q) v: from inner to outer axes."""
    u = (q[1], q[2], q[3])
    t = cross(u, v)
    s = cross(u, t)
    w = 2.0 * q[0]
    return (
        v[0] + w * t[0] + 2.0 * s[0],
        v[1] + w * t[1] + 2.0 * s[1],
        v[2] + w * t[2] + 2.0 * s[2],
    )


@njit
def quat_inv_rotate(q: Quat, v: Vec) -> Vec3Out:
    """R(q)^T v: from outer to inner axes."""
    return quat_rotate((q[0], -q[1], -q[2], -q[3]), v)


@njit
def quat_derivative(q: Quat, w: Vec) -> QuatOut:
    """dq/dt = 1/2 q (x) (0, w) with w in body axes [rad/s]."""
    return (
        -0.5 * (q[1] * w[0] + q[2] * w[1] + q[3] * w[2]),
        0.5 * (q[0] * w[0] + q[2] * w[2] - q[3] * w[1]),
        0.5 * (q[0] * w[1] + q[3] * w[0] - q[1] * w[2]),
        0.5 * (q[0] * w[2] + q[1] * w[1] - q[2] * w[0]),
    )


@njit
def quat_exp(phi: Vec) -> QuatOut:
    """Exp: rotation vector [rad] to unit quaternion, half the angle inside."""
    angle2 = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if angle2 < 1e-8:
        s = 0.5 - angle2 / 48.0
        c = 1.0 - angle2 / 8.0 + angle2 * angle2 / 384.0
    else:
        angle = math.sqrt(angle2)
        s = math.sin(0.5 * angle) / angle
        c = math.cos(0.5 * angle)
    return c, s * phi[0], s * phi[1], s * phi[2]


@njit
def quat_log(q: Quat) -> Vec3Out:
    """Log: rotation vector [rad] of the shorter way; q and -q give the same."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    n = math.sqrt(x * x + y * y + z * z)
    s = 2.0 * math.atan2(n, w) / n if n > 1e-8 else 2.0 / w
    return s * x, s * y, s * z


@njit
def R_to_quat(R: Array) -> QuatOut:
    """Unit quaternion of a rotation matrix, w >= 0."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace >= max(R[0, 0], R[1, 1], R[2, 2]):
        w, x, y, z = 1.0 + trace, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    elif R[0, 0] >= max(R[1, 1], R[2, 2]):
        w, x = R[2, 1] - R[1, 2], 1.0 + R[0, 0] - R[1, 1] - R[2, 2]
        y, z = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]
    elif R[1, 1] >= R[2, 2]:
        w, y = R[0, 2] - R[2, 0], 1.0 + R[1, 1] - R[0, 0] - R[2, 2]
        x, z = R[0, 1] + R[1, 0], R[1, 2] + R[2, 1]
    else:
        w, z = R[1, 0] - R[0, 1], 1.0 + R[2, 2] - R[0, 0] - R[1, 1]
        x, y = R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    if w < 0.0:
        scale = -scale
    return scale * w, scale * x, scale * y, scale * z


@njit
def so3_exp(phi: Vec, out: Array) -> None:
    """Exp: rotation matrix of a rotation vector [rad] into `out`, (3, 3)."""
    quat_to_R(quat_exp(phi), out)


@njit
def so3_log(R: Array) -> Vec3Out:
    """Rotation vector of a rotation matrix [rad]."""
    return quat_log(R_to_quat(R))
