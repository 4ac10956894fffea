# SPDX-License-Identifier: Apache-2.0
"""Triples for the control kernels: what `geometry.kernels` does not have. Tuples in, tuples out."""

import math

from skyhaul.geometry.kernels import Vec, Vec3Out, dot, norm
from skyhaul.jit import njit
from skyhaul.types import Array


@njit
def row(A: Array, i: int) -> Vec3Out:
    """Row i of an array (m, 3)."""
    return A[i, 0], A[i, 1], A[i, 2]


@njit
def put(A: Array, i: int, v: Vec) -> None:
    """Write a triple into row i of an array (m, 3)."""
    A[i, 0], A[i, 1], A[i, 2] = v[0], v[1], v[2]


@njit
def add(a: Vec, b: Vec) -> Vec3Out:
    """Sum a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit
def sub(a: Vec, b: Vec) -> Vec3Out:
    """Difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit
def scaled(s: float, a: Vec) -> Vec3Out:
    """Multiple s a."""
    return s * a[0], s * a[1], s * a[2]


@njit
def axpy(s: float, a: Vec, b: Vec) -> Vec3Out:
    """Multiple and sum s a + b."""
    return s * a[0] + b[0], s * a[1] + b[1], s * a[2] + b[2]


@njit
def across(a: Vec, unit: Vec) -> Vec3Out:
    """Part of a normal to a unit vector."""
    return axpy(-dot(a, unit), unit, a)


@njit
def capped(a: Vec, longest: float) -> Vec3Out:
    """A vector, shortened to `longest` when it is longer."""
    n = norm(a)
    return scaled(longest / n, a) if n > longest else (a[0], a[1], a[2])


@njit
def decay(dt: float, tau: float) -> float:
    """Share 1 - exp(-dt / tau) of the way that a first-order lag goes in dt; 1 without lag."""
    return 1.0 - math.exp(-dt / tau) if tau > 0.0 else 1.0
