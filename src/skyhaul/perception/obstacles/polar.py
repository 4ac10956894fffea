# SPDX-License-Identifier: Apache-2.0
"""Bearings as measurements: residuals, Jacobians, gates, and triangulation from several cameras.

A direction d is measured in its own tangent plane with axes (e1, e2): for an obstacle at p the
residual is -(e1, e2)^T u, u = (p - p_WC) / rho, and its Jacobian (e1, e2)^T (I - u u^T) / rho. A
range adds the row range - rho with the Jacobian u^T.
"""

from typing import NamedTuple

import numpy as np

from skyhaul.perception.obstacles.api import Bearings
from skyhaul.perception.obstacles.kernels import gate_all
from skyhaul.types import Array, IntArray

UNRANGED_VARIANCE = 1e6
"""Variance of a range that was not measured [m^2]: it tells nothing."""

_NEAREST_M = 0.05
_SHAPE_STEPS = 30.0
"""Steps for which a shape's own share of the error of its extent stays the same."""


class Polar(NamedTuple):
    """Measurements in their own axes, one row each."""

    p_WC: Array  # (k, 3) [m]
    v_WC: Array  # (k, 3) [m/s]
    axes: Array  # (k, 3, 3) rows e1, e2, d, W axes
    range_m: Array  # (k,) 0 where there is none [m]
    variance: Array  # (k, 3) of e1, e2 [rad^2] and of the range [m^2]
    half_angle: Array  # (k,) [rad]
    camera: IntArray  # (k,)
    age_s: Array  # (k,) how long before the stamp it was so [s]
    alike: Array  # (k,) successive measurements whose errors are alike


class Innovation(NamedTuple):
    """Residuals of measurements at states, with their linearisation."""

    residual: Array  # (..., 3) e1, e2 [rad], range [m]
    H: Array  # (..., 3, 3) with respect to the position
    ahead: Array  # (...) cosine between predicted and measured direction


def polar(seen: Bearings) -> Polar:
    """A camera's bearings as measurements."""
    d = seen.dir_W
    k = len(d)
    axes = _axes(d)
    ranged = np.isfinite(seen.range_m)
    angle = np.square(seen.sigma_rad)
    range_variance = np.where(ranged, np.square(seen.range_sigma_m), UNRANGED_VARIANCE)
    return Polar(
        p_WC=np.broadcast_to(seen.p_WC, (k, 3)),
        v_WC=np.broadcast_to(seen.v_WC, (k, 3)),
        axes=axes,
        range_m=np.where(ranged, seen.range_m, 0.0),
        variance=np.stack([angle, angle, range_variance], axis=1),
        half_angle=seen.half_angle_rad,
        camera=np.full(k, seen.camera),
        age_s=seen.age_s,
        alike=seen.alike,
    )


def _axes(d: Array) -> Array:
    """Right-handed axes e1, e2, d around unit vectors, (k, 3) -> (k, 3, 3).

    Source: Duff et al., "Building an orthonormal basis, revisited" (JCGT 2017).
    """
    x, y, z = d.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    axes = np.empty((len(d), 3, 3))
    axes[:, 0, 0], axes[:, 0, 1], axes[:, 0, 2] = 1.0 + sign * x * x * a, sign * b, -sign * x
    axes[:, 1, 0], axes[:, 1, 1], axes[:, 1, 2] = b, sign + y * y * a, -y
    axes[:, 2] = d
    return axes


def rows(z: Polar, which: IntArray) -> Polar:
    """Some of the measurements."""
    return Polar._make(a[which] for a in z)


def per_track(z: Polar) -> Polar:
    """Measurements, one for each track, that broadcast with (tracks, models or particles)."""
    return Polar._make(a[:, None] for a in z)


def stacked(parts: list[Polar]) -> Polar:
    """Measurements of several cameras as one."""
    return Polar._make(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def innovation(p_WO: Array, z: Polar) -> Innovation:
    """Residuals at positions (..., 3) that broadcast with the rows of z (...)."""
    rel = p_WO - z.p_WC
    rho = np.maximum(np.sqrt(np.sum(rel * rel, axis=-1)), _NEAREST_M)
    u = rel / rho[..., None]
    along = (z.axes @ u[..., None])[..., 0]  # e1 u, e2 u, d u
    H = (z.axes - along[..., None] * u[..., None, :]) / rho[..., None, None]
    H[..., 2, :] = u
    residual = -along
    # without a range its row is zero, and its variance large
    ranged = z.range_m > 0.0
    residual[..., 2] = np.where(ranged, z.range_m - rho, 0.0)
    return Innovation(residual, H, along[..., 2])


def gate(x: Array, covariance: Array, z: Polar) -> tuple[Array, Array]:
    """Squared Mahalanobis distance and ln det S of every track to every measurement, (n, k).

    The distance is infinite where the measurement looks the other way.

    Args:
        x: Predicted positions and velocities, (n, 6) [m, m/s].
        covariance: Theirs, (n, 6, 6).
        z: Measurements, k rows.
    """
    shape = len(x), len(z.camera)
    squared, log_det = np.empty(shape), np.empty(shape)
    cov = np.ascontiguousarray(covariance)
    gate_all(np.ascontiguousarray(x), cov, *measured(z), squared, log_det)
    return squared, log_det


def as_one_of_many(z: Polar) -> Polar:
    """Measurements that count for so much less as there are others whose errors are alike."""
    return z._replace(variance=z.variance * z.alike[:, None])


def measured(z: Polar) -> tuple[Array, Array, Array, Array, Array]:
    """Places, axes, ranges, variances and ages, as the kernels take them."""
    return np.ascontiguousarray(z.p_WC), z.axes, z.range_m, z.variance, z.age_s


def extents(z: Polar, extent_sigma: float) -> tuple[Array, Array]:
    """Ln sin(half angle) and its variance, (k,) each.

    The edges are as uncertain as the middle; on top comes what a shape that is no ball looks like
    from elsewhere.
    """
    half = np.clip(z.half_angle, 1e-4, 0.5 * np.pi)
    variance = np.square(extent_sigma) + z.variance[:, 0] / z.alike / half**2
    return np.log(np.sin(half)), variance * np.where(z.alike > 1.0, _SHAPE_STEPS, 1.0)


def triangulate(z: Polar, p_guess: Array) -> tuple[Array, Array]:
    """Position (3,) and covariance (3, 3) from the rows of z, by Gauss-Newton from a guess.

    The covariance is the inverse of the information H^T R^-1 H of all rows.
    """
    p = p_guess
    for _ in range(3):
        found = innovation(p, z)
        weighted = found.H / z.variance[..., None]
        information = np.einsum("kij,kil->jl", weighted, found.H)
        p = p + np.linalg.solve(information, np.einsum("kij,ki->j", weighted, found.residual))
    return p, np.linalg.inv(information)


def closest_points(z: Polar) -> tuple[Array, Array, Array]:
    """Between the rays of all pairs of rows: distances along the first, middle points, gaps.

    Returns:
        s: Along ray i to where it is closest to ray j, (k, k) [m]; NaN for parallel rays.
        middle: Between the closest points, (k, k, 3) [m].
        gap: Between them, (k, k) [m].
    """
    d = z.axes[:, 2]
    w = z.p_WC[:, None] - z.p_WC[None, :]  # from camera j to camera i
    cosine = d @ d.T
    denominator = 1.0 - cosine**2
    di_w = np.einsum("id,ijd->ij", d, w)
    dj_w = np.einsum("jd,ijd->ij", d, w)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (cosine * dj_w - di_w) / np.where(denominator > 1e-9, denominator, np.nan)
    t = s.T
    on_i = z.p_WC[:, None] + s[..., None] * d[:, None]
    on_j = z.p_WC[None, :] + t[..., None] * d[None, :]
    return s, 0.5 * (on_i + on_j), np.linalg.norm(on_i - on_j, axis=-1)
