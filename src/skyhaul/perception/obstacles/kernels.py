# SPDX-License-Identifier: Apache-2.0
"""Gate and Kalman update of all tracks, compiled: the same as `polar.innovation` says."""

import math

import numpy as np

from skyhaul.jit import njit
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"

_NEAREST_M = 0.05


@njit
def linearise(p: Array, p_WC: Array, axes: Array, range_m: float, y: Array, H: Array) -> float:
    """Residual (3,) and Jacobian (3, 3) of one measurement at one position; the cosine ahead."""
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
    return axes[2, 0] * u0 + axes[2, 1] * u1 + axes[2, 2] * u2


@njit
def innovation_covariance(
    cov: Array, H: Array, variance: Array, PHt: Array, inverse: Array
) -> float:
    """P H^T, the inverse of S = H P H^T + R, and its determinant; cov is (a, a), a >= 3."""
    for i in range(cov.shape[0]):
        for r in range(3):
            PHt[i, r] = cov[i, 0] * H[r, 0] + cov[i, 1] * H[r, 1] + cov[i, 2] * H[r, 2]
    S = inverse
    for r in range(3):
        for s in range(3):
            S[r, s] = H[r, 0] * PHt[0, s] + H[r, 1] * PHt[1, s] + H[r, 2] * PHt[2, s]
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
    p: Array, cov: Array, p_WC: Array, axes: Array, range_m: Array, variance: Array,
    squared: Array, log_det: Array,
) -> None:  # fmt: skip
    """Every track (n) against every measurement (k)."""
    y, H, PHt, inverse = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(p.shape[0]):
        for j in range(range_m.shape[0]):
            ahead = linearise(p[i], p_WC[j], axes[j], range_m[j], y, H)
            det = innovation_covariance(cov[i], H, variance[j], PHt, inverse)
            squared[i, j] = squared_length(y, inverse) if ahead > 0.0 else np.inf
            log_det[i, j] = math.log(det)


@njit
def update_all(
    x: Array, cov: Array, log_likelihood: Array, p_WC: Array, axes: Array, range_m: Array,
    variance: Array,
) -> None:  # fmt: skip
    """Extended Kalman update of every track (n) and model (m) with its measurement, in place.

    Joseph form, expanded: P - K (P H^T)^T - (P H^T) K^T + K S K^T, with S = H P H^T + R.
    """
    a = x.shape[2]
    y, H, inverse = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    PHt, gain, KS = np.empty((a, 3)), np.empty((a, 3)), np.empty((a, 3))
    for i in range(x.shape[0]):
        for m in range(x.shape[1]):
            P = cov[i, m]
            linearise(x[i, m], p_WC[i], axes[i], range_m[i], y, H)
            det = innovation_covariance(P, H, variance[i], PHt, inverse)
            log_likelihood[i, m] = -0.5 * (squared_length(y, inverse) + math.log(det))
            _gains(PHt, inverse, H, variance[i], gain, KS)
            for r in range(a):
                x[i, m, r] += gain[r, 0] * y[0] + gain[r, 1] * y[1] + gain[r, 2] * y[2]
            for r in range(a):
                for s in range(r, a):
                    change = 0.0
                    for c in range(3):
                        change += KS[r, c] * gain[s, c]
                        change -= gain[r, c] * PHt[s, c] + PHt[r, c] * gain[s, c]
                    P[r, s] += change
                    P[s, r] = P[r, s]


@njit
def _gains(PHt: Array, inverse: Array, H: Array, variance: Array, gain: Array, KS: Array) -> None:
    """K = P H^T S^-1, and K S with S = H P H^T + R."""
    for r in range(PHt.shape[0]):
        for c in range(3):
            gain[r, c] = (
                PHt[r, 0] * inverse[0, c] + PHt[r, 1] * inverse[1, c] + PHt[r, 2] * inverse[2, c]
            )
    for r in range(PHt.shape[0]):
        for c in range(3):
            total = gain[r, c] * variance[c]
            for d in range(3):
                S = H[d, 0] * PHt[0, c] + H[d, 1] * PHt[1, c] + H[d, 2] * PHt[2, c]
                total += gain[r, d] * S
            KS[r, c] = total
