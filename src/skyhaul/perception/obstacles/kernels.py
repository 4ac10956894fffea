# SPDX-License-Identifier: Apache-2.0
"""Gate and Kalman update of all tracks, compiled: the same as `polar.innovation` says."""

import math

import numpy as np

from skyhaul.jit import njit
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"

SIZE = 9
"""Place of ln radius in a track's state."""
_NEAREST_M = 0.05
_ITERATIONS = 3
_FAR_EXTENT = 4.0
"""Squared standard deviations beyond which an extent counts for less."""


@njit
def linearise(
    p: Array, p_WC: Array, axes: Array, range_m: float, y: Array, H: Array
) -> tuple[float, float]:
    """Residual (3,) and Jacobian (3, 3) at one position; the cosine ahead, the distance [m]."""
    x0, x1, x2 = p[0] - p_WC[0], p[1] - p_WC[1], p[2] - p_WC[2]
    rho = max(math.sqrt(x0 * x0 + x1 * x1 + x2 * x2), _NEAREST_M)
    u0, u1, u2 = x0 / rho, x1 / rho, x2 / rho
    for r in range(2):
        along = axes[r, 0] * u0 + axes[r, 1] * u1 + axes[r, 2] * u2
        y[r] = -along
        H[r, 0] = (axes[r, 0] - along * u0) / rho
        H[r, 1] = (axes[r, 1] - along * u1) / rho
        H[r, 2] = (axes[r, 2] - along * u2) / rho
    y[2] = range_m - rho if range_m > 0.0 else 0.0
    H[2, 0], H[2, 1], H[2, 2] = u0, u1, u2
    return axes[2, 0] * u0 + axes[2, 1] * u1 + axes[2, 2] * u2, rho


@njit
def innovation_covariance(
    cov: Array, age_s: float, H: Array, variance: Array, PHt: Array, inverse: Array
) -> float:
    """P G^T, the inverse of S = G P G^T + R, and its determinant.

    G = (H, -age H, 0): what was measured is the place p - age v; cov is (a, a), a >= 6.
    """
    for i in range(cov.shape[0]):
        c0, c1 = cov[i, 0] - age_s * cov[i, 3], cov[i, 1] - age_s * cov[i, 4]
        c2 = cov[i, 2] - age_s * cov[i, 5]
        for r in range(3):
            PHt[i, r] = c0 * H[r, 0] + c1 * H[r, 1] + c2 * H[r, 2]
    S = inverse
    for r in range(3):
        for s in range(3):
            S[r, s] = 0.0
            for c in range(3):
                S[r, s] += H[r, c] * (PHt[c, s] - age_s * PHt[3 + c, s])
        S[r, r] += variance[r]
    a, b, c, d, e, f = S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * A + b * B + c * C
    inverse[0, 0], inverse[1, 1], inverse[2, 2] = (
        A / det,
        (a * f - c * c) / det,
        (a * d - b * b) / det,
    )
    inverse[0, 1] = inverse[1, 0] = B / det
    inverse[0, 2] = inverse[2, 0] = C / det
    inverse[1, 2] = inverse[2, 1] = (b * c - a * e) / det
    return det


@njit
def squared_length(y: Array, inverse: Array) -> float:
    """y^T S^-1 y."""
    total = 0.0
    for r in range(3):
        for s in range(3):
            total += y[r] * inverse[r, s] * y[s]
    return total


@njit
def gate_all(
    x: Array, cov: Array, p_WC: Array, axes: Array, range_m: Array, variance: Array,
    age_s: Array, squared: Array, log_det: Array,
) -> None:  # fmt: skip
    """Every track (n), x (n, 6) and cov (n, 6, 6), against every measurement (k)."""
    y, H, PHt, inverse = np.empty(3), np.empty((3, 3)), np.empty((6, 3)), np.empty((3, 3))
    then = np.empty(3)
    for i in range(x.shape[0]):
        for j in range(range_m.shape[0]):
            for c in range(3):
                then[c] = x[i, c] - age_s[j] * x[i, 3 + c]
            ahead, _ = linearise(then, p_WC[j], axes[j], range_m[j], y, H)
            det = innovation_covariance(cov[i], age_s[j], H, variance[j], PHt, inverse)
            squared[i, j] = squared_length(y, inverse) if ahead > 0.0 else np.inf
            log_det[i, j] = math.log(det)


@njit
def update_all(
    x: Array, cov: Array, log_likelihood: Array, p_WC: Array, axes: Array, range_m: Array,
    variance: Array, age_s: Array, log_extent: Array, extent_variance: Array,
) -> None:  # fmt: skip
    """Kalman update of every track (n) and model (m) with its measurement, in place.

    Direction and range first, iterated: a track placed by one camera is uncertain by a third of
    its distance, over which a second camera's ray is far from linear. Then the extent.
    """
    a = x.shape[2]
    for i in range(x.shape[0]):
        for m in range(x.shape[1]):
            log_likelihood[i, m] = _update_place(
                x[i, m], cov[i, m], p_WC[i], axes[i], range_m[i], variance[i], age_s[i], a
            )
            _update_size(x[i, m], cov[i, m], p_WC[i], age_s[i], log_extent[i], extent_variance[i])


@njit
def _update_place(
    x: Array, P: Array, p_WC: Array, axes: Array, range_m: float, variance: Array, age_s: float,
    a: int,
) -> float:  # fmt: skip
    """Iterated extended Kalman update with direction and range; the log likelihood.

    x_{i+1} = x_0 + K_i (y_i - G_i (x_0 - x_i)); the covariance in Joseph form, expanded:
    P - K (P G^T)^T - (P G^T) K^T + K S K^T, with S = G P G^T + R.
    """
    y, H, inverse = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    PHt, gain, KS = np.empty((a, 3)), np.empty((a, 3)), np.empty((a, 3))
    start, then, likelihood = x.copy(), np.empty(3), 0.0
    for turn in range(_ITERATIONS):
        for c in range(3):
            then[c] = x[c] - age_s * x[3 + c]
        linearise(then, p_WC, axes, range_m, y, H)
        det = innovation_covariance(P, age_s, H, variance, PHt, inverse)
        if turn == 0:
            likelihood = -0.5 * (squared_length(y, inverse) + math.log(det))
        for r in range(3):
            for c in range(3):
                y[r] -= H[r, c] * (start[c] - x[c] - age_s * (start[3 + c] - x[3 + c]))
        _gains(PHt, inverse, H, variance, age_s, gain, KS)
        for r in range(a):
            x[r] = start[r] + gain[r, 0] * y[0] + gain[r, 1] * y[1] + gain[r, 2] * y[2]
    for r in range(a):
        for s in range(r, a):
            change = 0.0
            for c in range(3):
                change += KS[r, c] * gain[s, c]
                change -= gain[r, c] * PHt[s, c] + PHt[r, c] * gain[s, c]
            P[r, s] += change
            P[s, r] = P[r, s]
    return likelihood


@njit
def _update_size(
    x: Array, P: Array, p_WC: Array, age_s: float, log_extent: float, variance: float
) -> None:
    """Extended Kalman update with the extent: ln sin(half angle) = x_9 - ln rho.

    An extent far off, of a part or of two at once, counts for as much less.
    """
    a = x.shape[0]
    g, Pg = np.zeros(a), np.empty(a)
    rel, square = np.empty(3), 0.0
    for c in range(3):
        rel[c] = x[c] - age_s * x[3 + c] - p_WC[c]
        square += rel[c] * rel[c]
    square = max(square, _NEAREST_M * _NEAREST_M)
    for c in range(3):
        g[c] = -rel[c] / square
        g[3 + c] = -age_s * g[c]
    g[SIZE] = 1.0
    s = variance
    for r in range(a):
        Pg[r] = 0.0
        for c in range(a):
            Pg[r] += P[r, c] * g[c]
        s += g[r] * Pg[r]
    y = log_extent - x[SIZE] + 0.5 * math.log(square)
    s = max(s, y * y / _FAR_EXTENT)
    for r in range(a):
        x[r] += Pg[r] / s * y
    for r in range(a):
        for c in range(a):
            P[r, c] -= Pg[r] * Pg[c] / s


@njit
def _gains(
    PHt: Array, inverse: Array, H: Array, variance: Array, age_s: float, gain: Array, KS: Array
) -> None:
    """K = P G^T S^-1, and K S with S = G P G^T + R."""
    for r in range(PHt.shape[0]):
        for c in range(3):
            gain[r, c] = (
                PHt[r, 0] * inverse[0, c] + PHt[r, 1] * inverse[1, c] + PHt[r, 2] * inverse[2, c]
            )
    for r in range(PHt.shape[0]):
        for c in range(3):
            total = gain[r, c] * variance[c]
            for d in range(3):
                S = 0.0
                for e in range(3):
                    S += H[d, e] * (PHt[e, c] - age_s * PHt[3 + e, c])
                total += gain[r, d] * S
            KS[r, c] = total
