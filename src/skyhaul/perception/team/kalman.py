# SPDX-License-Identifier: Apache-2.0
"""Kalman update with a chi-square gate: covariance by Joseph's form, one row at a time."""

import math

import numpy as np

from skyhaul.jit import njit
from skyhaul.types import Array

CHI2_999 = np.array([0.0, 10.83, 13.82, 16.27, 18.47, 20.52, 22.46, 24.32, 26.12])
"""Bound that the squared Mahalanobis distance of m rows keeps in 99.9 %."""


@njit
def mahalanobis2(P: Array, H: Array, r: Array, variance: Array) -> float:
    """Squared distance r^T (H P H^T + diag(variance))^-1 r of m rows.

    Args:
        P: Covariance, (N, N).
        H: Derivatives, (m, N).
        r: Innovations, (m,).
        variance: Of the measurements, (m,).
    """
    m, n = H.shape
    S, y = np.empty((m, m)), np.empty(m)
    u = np.empty(n)
    for a in range(m):
        _times(P, H[a], u)
        for b in range(a + 1):
            s = 0.0
            for k in range(n):
                s += H[b, k] * u[k]
            S[a, b] = s
        S[a, a] += variance[a]
    total = 0.0
    for a in range(m):  # Cholesky S = L L^T and L y = r, row by row
        for b in range(a + 1):
            s = S[a, b]
            for k in range(b):
                s -= S[a, k] * S[b, k]
            S[a, b] = math.sqrt(max(s, 1e-30)) if a == b else s / S[b, b]
        s = r[a]
        for k in range(a):
            s -= S[a, k] * y[k]
        y[a] = s / S[a, a]
        total += y[a] * y[a]
    return total


@njit
def update(P: Array, H: Array, r: Array, variance: Array, dx: Array) -> bool:
    """Take m rows in, or none of them when they are farther off than 99.9 % are.

    For each row h with variance s: u = P h, S = h u + s, k = u / S,
    dx += k (r - h dx),  P <- P - k u^T - u k^T + k S k^T, which is Joseph's form.

    Args:
        P: Covariance, (N, N); changed in place.
        H: Derivatives of the measurement by the error, (m, N), m <= 8.
        r: Innovations, (m,).
        variance: Of the measurements, (m,), independent of each other.
        dx: Correction, (N,); overwritten.

    Source:    Paper eqs (16)-(18).
    Deviation: (18) as printed loses the symmetry of P (PAPER_NOTES 47).
    """
    dx[:] = 0.0
    if mahalanobis2(P, H, r, variance) > CHI2_999[H.shape[0]]:
        return False
    n = P.shape[0]
    u = np.empty(n)
    for a in range(H.shape[0]):
        _times(P, H[a], u)
        S, gap = variance[a], r[a]
        for k in range(n):
            S += H[a, k] * u[k]
            gap -= H[a, k] * dx[k]
        for i in range(n):
            ki = u[i] / S
            dx[i] += ki * gap
            for j in range(i + 1):
                kj = u[j] / S
                P[i, j] += ki * kj * S - ki * u[j] - u[i] * kj
                P[j, i] = P[i, j]
    return True


@njit
def _times(P: Array, h: Array, u: Array) -> None:
    """U = P h, of which most entries are zero."""
    n = P.shape[0]
    u[:] = 0.0
    for k in range(n):
        if h[k] != 0.0:
            for i in range(n):
                u[i] += P[k, i] * h[k]
