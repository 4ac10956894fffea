# SPDX-License-Identifier: Apache-2.0
"""Arithmetic on functions of time and their derivatives, for numba kernels.

A jet is a truncated Taylor series: row k is the k-th derivative over k!. Scalars are (K,),
vectors (K, 3), matrices (K, 3, 3); a result is as long as its shorter operand.

Source: Griewank, Walther, "Evaluating Derivatives" (2008), ch. 13.
"""

import math

import numpy as np

from skyhaul.jit import njit
from skyhaul.types import Array


def jet_from_derivatives(d: Array) -> Array:
    """Jet of a function from its derivatives 0.., (K, ...); not for kernels."""
    jet: Array = d / factorials(d)
    return jet


def factorials(a: Array) -> Array:
    """0! 1! 2! .. along the first axis of an array, to be broadcast with it."""
    rows = np.array([math.factorial(k) for k in range(len(a))], dtype=np.float64)
    return rows.reshape((-1,) + (1,) * (np.ndim(a) - 1))


@njit
def jet_rate(a: Array) -> Array:
    """Time derivative of a vector, one shorter: (K, 3) -> (K - 1, 3)."""
    size = a.shape[0] - 1
    out = np.empty((size, 3))
    for k in range(size):
        for c in range(3):
            out[k, c] = (k + 1.0) * a[k + 1, c]
    return out


@njit
def jet_scale(s: Array, v: Array) -> Array:
    """Scalar times vector: (K,), (K, 3) -> (K, 3)."""
    size = min(s.shape[0], v.shape[0])
    out = np.zeros((size, 3))
    for k in range(size):
        for j in range(k + 1):
            for c in range(3):
                out[k, c] += s[j] * v[k - j, c]
    return out


@njit
def jet_dot(a: Array, b: Array) -> Array:
    """Scalar product: (K, 3), (K, 3) -> (K,)."""
    size = min(a.shape[0], b.shape[0])
    out = np.zeros(size)
    for k in range(size):
        for j in range(k + 1):
            for c in range(3):
                out[k] += a[j, c] * b[k - j, c]
    return out


@njit
def jet_cross(a: Array, b: Array) -> Array:
    """Vector product: (K, 3), (K, 3) -> (K, 3)."""
    size = min(a.shape[0], b.shape[0])
    out = np.zeros((size, 3))
    for k in range(size):
        for j in range(k + 1):
            i = k - j
            out[k, 0] += a[j, 1] * b[i, 2] - a[j, 2] * b[i, 1]
            out[k, 1] += a[j, 2] * b[i, 0] - a[j, 0] * b[i, 2]
            out[k, 2] += a[j, 0] * b[i, 1] - a[j, 1] * b[i, 0]
    return out


@njit
def jet_mat_vec(M: Array, v: Array) -> Array:
    """M v: (K, 3, 3), (K, 3) -> (K, 3)."""
    size = min(M.shape[0], v.shape[0])
    out = np.zeros((size, 3))
    for k in range(size):
        for j in range(k + 1):
            for r in range(3):
                for c in range(3):
                    out[k, r] += M[j, r, c] * v[k - j, c]
    return out


@njit
def jet_mat_t_vec(M: Array, v: Array) -> Array:
    """M^T v: (K, 3, 3), (K, 3) -> (K, 3)."""
    size = min(M.shape[0], v.shape[0])
    out = np.zeros((size, 3))
    for k in range(size):
        for j in range(k + 1):
            for r in range(3):
                for c in range(3):
                    out[k, r] += M[j, c, r] * v[k - j, c]
    return out


@njit
def jet_body_rate(R: Array) -> Array:
    """Angular velocity in body axes, vee(R^T dR/dt): (K, 3, 3) -> (K - 1, 3)."""
    size = R.shape[0] - 1
    out = np.zeros((size, 3))
    for k in range(size):
        for j in range(k + 1):
            i = k - j + 1  # the rate of row i - 1 is i times row i
            for c in range(3):
                x, y = (c + 1) % 3, (c + 2) % 3
                for r in range(3):
                    turn = R[j, r, y] * R[i, r, x] - R[j, r, x] * R[i, r, y]
                    out[k, c] += 0.5 * i * turn
    return out


@njit
def jet_euler(J: Array, w: Array) -> Array:
    """Moment that a turning body needs, J dw + w x J w: (3,), (K, 3) -> (K - 1, 3)."""
    dw, Jw = jet_rate(w), np.empty_like(w)
    for k in range(w.shape[0]):
        for c in range(3):
            Jw[k, c] = J[c] * w[k, c]
    spin = jet_cross(w, Jw)
    for k in range(dw.shape[0]):
        for c in range(3):
            dw[k, c] = J[c] * dw[k, c] + spin[k, c]
    return dw


@njit
def jet_sqrt(a: Array) -> Array:
    """Square root, (K,); a[0] > 0."""
    out = np.empty_like(a)
    out[0] = math.sqrt(a[0])
    for k in range(1, a.shape[0]):
        s = a[k]
        for j in range(1, k):
            s -= out[j] * out[k - j]
        out[k] = 0.5 * s / out[0]
    return out


@njit
def jet_reciprocal(a: Array) -> Array:
    """One over a scalar, (K,); a[0] != 0."""
    out = np.empty_like(a)
    out[0] = 1.0 / a[0]
    for k in range(1, a.shape[0]):
        s = 0.0
        for j in range(k):
            s += out[j] * a[k - j]
        out[k] = -s * out[0]
    return out


@njit
def jet_norm(v: Array) -> Array:
    """Length of a vector: (K, 3) -> (K,); nan where it is zero."""
    square = jet_dot(v, v)
    if square[0] == 0.0:
        square[:] = np.nan
    return jet_sqrt(square)


@njit
def jet_unit(v: Array) -> Array:
    """Direction of a vector, (K, 3); nan where it is zero."""
    return jet_scale(jet_reciprocal(jet_norm(v)), v)


@njit
def jet_heading(angle: Array) -> Array:
    """The vector (cos, sin, 0) of an angle: (K,) -> (K, 3)."""
    out = np.zeros((angle.shape[0], 3))
    out[0, 0], out[0, 1] = math.cos(angle[0]), math.sin(angle[0])
    for k in range(1, angle.shape[0]):
        for j in range(1, k + 1):
            out[k, 0] -= j * angle[j] * out[k - j, 1] / k
            out[k, 1] += j * angle[j] * out[k - j, 0] / k
    return out
