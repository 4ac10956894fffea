# SPDX-License-Identifier: Apache-2.0
"""Uniform septic B-splines: pieces of degree 7 whose joints keep derivatives 0..6.

Piece i lasts from knot i to knot i + 1 and depends on control points i .. i + 7; control point j
acts around knot j - 3. A spline is the convolution of its control polygon with a smooth kernel:
its k-th derivative stays within the hull of the k-th differences over dt^k.
"""

from fractions import Fraction
from math import comb, factorial

import numpy as np
from scipy.linalg import solve_banded

from skyhaul.jit import njit
from skyhaul.types import Array

DEGREE = 7
ORDER = DEGREE + 1
"""Control points of one piece; the derivatives 0..6 at a knot fix the first seven of them."""
LEAD = 3
"""Control point j acts around knot j - LEAD."""


def _basis() -> list[list[Fraction]]:
    """Row k, column j: coefficient of u^k in the weight of control point j of a piece."""
    rows = [[Fraction(0)] * ORDER for _ in range(ORDER)]
    for j in range(ORDER):
        for i in range(ORDER - j):
            shift = DEGREE - j - i  # (u + shift)^7 of the truncated powers
            sign = (-1) ** i * comb(ORDER, i)
            for k in range(ORDER):
                power = Fraction(shift) ** (DEGREE - k)
                rows[k][j] += Fraction(sign * comb(DEGREE, k), factorial(DEGREE)) * power
    return rows


def _inverse(a: list[list[Fraction]]) -> list[list[Fraction]]:
    """Inverse of a matrix, exactly (Gauss-Jordan)."""
    n = len(a)
    rows = [row[:] + [Fraction(int(i == j)) for j in range(n)] for i, row in enumerate(a)]
    for c in range(n):
        p = next(r for r in range(c, n) if rows[r][c] != 0)
        rows[c], rows[p] = rows[p], rows[c]
        rows[c] = [x / rows[c][c] for x in rows[c]]
        for r in range(n):
            if r != c and rows[r][c] != 0:
                rows[r] = [x - rows[r][c] * y for x, y in zip(rows[r], rows[c], strict=True)]
    return [row[n:] for row in rows]


_EXACT = _basis()
BASIS = np.array(_EXACT, dtype=np.float64)
"""(8, 8): row k, column j is the coefficient of u^k in the weight of control point j."""
_AT_KNOT = [[factorial(k) * _EXACT[k][j] for j in range(DEGREE)] for k in range(DEGREE)]
KNOT_WEIGHTS = np.array(_AT_KNOT, dtype=np.float64)
"""(7, 7): derivatives 0..6 at a knot, times dt^k, from the seven control points around it."""
FROM_KNOT = np.array(_inverse(_AT_KNOT), dtype=np.float64)
"""(7, 7): its inverse."""


def control_from_derivatives(d: Array, dt_s: float) -> Array:
    """The seven control points that give derivatives 0..6 at a knot.

    They are convex combinations of those that made the motion when its own knot spacing was
    not less than `dt_s`; a longer spacing extrapolates.

    Args:
        d: Derivatives, (7, c).
        dt_s: Knot spacing [s].
    """
    return np.asarray(FROM_KNOT @ (d * dt_s ** np.arange(DEGREE)[:, None]))


def interpolate(values: Array, rest: int = ORDER) -> Array:
    """Control points of the spline through values at its knots, at rest at both ends.

    Args:
        values: One row a knot, (k, c), k > 1.
        rest: The curve rests this many knots before the first and after the last value.

    Returns:
        Control points, (k + 2 rest + 6, c): knot q + rest has values[q].
    """
    padded = np.concatenate(
        [np.repeat(values[:1], rest, 0), values, np.repeat(values[-1:], rest, 0)]
    )
    ends = np.concatenate([np.repeat(values[:1], 3, 0), padded, np.repeat(values[-1:], 3, 0)])
    n = len(ends)
    band = np.zeros((7, n))
    band[3] = 1.0
    weights = KNOT_WEIGHTS[0]
    for offset in range(-3, 4):
        columns = np.arange(3 + offset, n - 3 + offset)
        band[3 - offset, columns] = weights[offset + 3]
    return np.asarray(solve_banded((3, 3), band, ends))


@njit
def evaluate(control: Array, dt: float, time: float, out: Array, basis: Array) -> None:
    """Derivatives 0..6 of every coordinate at a time after the first knot; at rest outside.

    Args:
        control: Control points, (m, c).
        dt: Knot spacing [s].
        time: Since the first knot [s].
        out: (7, c), written to.
        basis: `BASIS`.
    """
    pieces, dims = control.shape[0] - 7, control.shape[1]
    x = time / dt
    i = min(max(int(np.floor(x)), 0), pieces - 1)
    outside = x < 0.0 or x > pieces
    u = min(max(x - i, 0.0), 1.0)
    for c in range(dims):
        for k in range(7):
            out[k, c] = 0.0
        # from the highest power down: Horner for all derivatives at once
        for power in range(7, -1, -1):
            a = 0.0
            for j in range(8):
                a += basis[power, j] * control[i + j, c]
            for k in range(6, 0, -1):
                out[k, c] = out[k, c] * u + out[k - 1, c]
            out[0, c] = out[0, c] * u + a
        scale = 1.0
        for k in range(1, 7):
            scale *= k / dt
            out[k, c] = 0.0 if outside else out[k, c] * scale


@njit
def evaluate_position(control: Array, dt: float, time: float, out: Array, basis: Array) -> None:
    """The first three coordinates at a time after the first knot, (3,)."""
    pieces = control.shape[0] - 7
    x = time / dt
    i = min(max(int(np.floor(x)), 0), pieces - 1)
    u = min(max(x - i, 0.0), 1.0)
    out[0] = out[1] = out[2] = 0.0
    for j in range(8):
        w = 0.0
        for power in range(7, -1, -1):
            w = w * u + basis[power, j]
        for c in range(3):
            out[c] += w * control[i + j, c]


@njit
def largest_derivatives(control: Array, dt: float, basis: Array, per_piece: int) -> Array:
    """Largest norm of position derivatives 1..6 over the whole spline, (7,), entry 0 is 0.

    Args:
        control: Control points, (m, >= 3).
        dt: Knot spacing [s].
        basis: `BASIS`.
        per_piece: Samples a piece.
    """
    out, d = np.zeros(7), np.empty((7, control.shape[1]))
    pieces = control.shape[0] - 7
    for q in range(pieces * per_piece + 1):
        evaluate(control, dt, q * dt / per_piece, d, basis)
        for k in range(1, 7):
            norm = np.sqrt(d[k, 0] ** 2 + d[k, 1] ** 2 + d[k, 2] ** 2)
            out[k] = max(out[k], norm)
    return out
