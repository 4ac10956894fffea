# SPDX-License-Identifier: Apache-2.0
"""Pose of a rig from bearings to known points: Tukey's estimator over all cameras at once."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.geometry.kernels import mat_t_vec, mat_vec, so3_exp, so3_log
from skyhaul.jit import njit
from skyhaul.params import Params
from skyhaul.perception.vio.api import CameraRig
from skyhaul.perception.vio.propagation import product, right_jacobian
from skyhaul.types import Array, IntArray, Mask

MEDIAN_TO_SIGMA_2D = 0.8493
"""1 / sqrt(2 ln 2): the median of a 2-D error's length to its standard deviation per axis."""
CUTOFF_2D = 5.12
"""Tukey's cut-off in standard deviations for 95 % efficiency on 2-D errors."""
MEDIAN_TO_SIGMA_1D, CUTOFF_1D = 1.4826, 4.6851
"""The same for scalars; PTAM uses them on lengths of 2-D errors."""


@dataclass(frozen=True, kw_only=True)
class TukeyPose(Params):
    """How the pose update is robust."""

    scale: Literal["two-dim", "ptam"] = "two-dim"
    """Constants for errors in the image (two-dim), or those for scalars that PTAM uses (ptam)."""
    iterations: int = 10
    """Gauss-Newton steps."""
    free_iterations: int = 5
    """Steps that estimate the scale of the errors anew; then it stays as it is."""
    scale_floor: float = 0.5
    """Smallest scale of the errors, in standard deviations of a measurement."""

    def __post_init__(self) -> None:
        if not 1 <= self.free_iterations <= self.iterations:
            raise ValueError(
                f"free_iterations must be 1 to iterations ({self.iterations}), "
                f"got {self.free_iterations}"
            )
        if not self.scale_floor > 0.0:
            raise ValueError(f"scale_floor must be > 0, got {self.scale_floor}")

    def constants(self) -> Array:
        """Median to sigma, cut-off, floor, (3,), as the kernel takes them."""
        pair = {
            "two-dim": (MEDIAN_TO_SIGMA_2D, CUTOFF_2D),
            "ptam": (MEDIAN_TO_SIGMA_1D, CUTOFF_1D),
        }[self.scale]
        return np.array([*pair, self.scale_floor])


class Sights(NamedTuple):
    """Bearings to points that are known."""

    p_WP: Array  # (n, 3) points [m]
    bearing_C: Array  # (n, 3) unit vectors in camera axes
    camera: IntArray  # (n,)
    sigma: Array  # (n,) standard deviation per axis [rad]


@dataclass(frozen=True, eq=False)
class PoseFix:
    """What the pose update found."""

    p_WI: Array  # (3,) [m]
    R_WI: Array  # (3, 3)
    weight: Array  # (n,) Tukey's weights, 0 for what disagrees
    scale: float  # of the errors, in standard deviations of a measurement
    information: Array  # (6, 6) of the error (p, R), prior included

    @property
    def inlier(self) -> Mask:
        """Which bearings agree with the pose, (n,)."""
        agrees: Mask = self.weight > 0.0
        return agrees


def bearings(xy: Array) -> Array:
    """Unit vectors of normalised image points: (n, 2) -> (n, 3)."""
    rays = np.column_stack([xy, np.ones(len(xy))])
    unit: Array = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return unit


def bearing_sigma(xy: Array, sigma: float | Array) -> Array:
    """Standard deviation of bearings [rad] whose images have `sigma`, one or (n,): (n, 2) -> (n,).

    Off the axis the same error in the image is a smaller angle, by 1 + r^2 along the radius and
    its root across; the mean of both in the geometric sense.
    """
    spread: Array = sigma * (1.0 + np.sum(xy * xy, axis=1)) ** -0.75
    return spread


def update_pose(
    params: TukeyPose,
    rig: CameraRig,
    guess: tuple[Array, Array],
    sights: Sights,
    prior: Array | None = None,
) -> PoseFix:
    """Pose from bearings of all cameras, pooled: Gauss-Newton on Tukey's weights.

    Minimises sum_j rho(|e_j| / s) + 1/2 d^T prior d, where e_j is the error of bearing j in its
    tangent plane over its standard deviation, s the scale of all errors, d the pose minus the
    guess. T_CW is updated from the left, T_CW <- Exp(x) T_CW, which is T_WI from the right.

    Args:
        params: Constants.
        rig: The cameras.
        guess: p_WI (3,) [m] and R_WI (3, 3) to start from.
        sights: The bearings.
        prior: Information of the guess as an error (p, R), (6, 6); none: bearings alone.

    Source:    Paper eqs (12), (13); Klein and Murray, PTAM (ISMAR 2007).
    Deviation: Side of the update, scale and constants: PAPER_NOTES 44.
    Limits:    Without a prior three bearings at least, not all to one point.
    """
    p, R = np.array(guess[0], dtype=np.float64), np.array(guess[1], dtype=np.float64)
    R_CI = np.ascontiguousarray(np.swapaxes(rig.R_IC, 1, 2))
    p_CI = -np.einsum("cij,cj->ci", R_CI, rig.p_IC)
    weight, H = np.zeros(len(sights.camera)), np.zeros((6, 6))
    counts = np.array([params.iterations, params.free_iterations])
    held = np.zeros((6, 6)) if prior is None else np.ascontiguousarray(prior)
    scale = _tukey(p, R, R_CI, p_CI, sights, held, params.constants(), counts, weight, H)
    return PoseFix(p, R, weight, scale, H)


@njit
def sight_error(
    p: Array, R: Array, R_CI: Array, p_CI: Array, p_WP: Array, seen: Array, e: Array, J: Array
) -> bool:
    """Error of a bearing and its derivative by the pose, (p, R); false behind the camera.

    Two axes of the plane tangent to the seen bearing hold the error: b_hat in them.

    Args:
        p: p_WI, (3,) [m].
        R: R_WI, (3, 3).
        R_CI: (3, 3).
        p_CI: (3,) [m].
        p_WP: The point, (3,) [m].
        seen: The bearing, (3,) unit vector in camera axes.
        e: Out, (2,) [rad].
        J: Out, (2, 6).
    """
    d = (p_WP[0] - p[0], p_WP[1] - p[1], p_WP[2] - p[2])
    i = mat_t_vec(R, d)  # the point in I
    c = mat_vec(R_CI, i)
    c0, c1, c2 = c[0] + p_CI[0], c[1] + p_CI[1], c[2] + p_CI[2]
    far = math.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
    if c0 * seen[0] + c1 * seen[1] + c2 * seen[2] <= 0.05 * far or far < 1e-3:
        return False
    b0, b1, b2 = c0 / far, c1 / far, c2 / far
    for row in range(2):
        t0, t1, t2 = tangent(seen, row)
        e[row] = t0 * b0 + t1 * b1 + t2 * b2
        # d e / d c = (t - (t . b) b) / far, then to axes of I, then to the pose.
        g0, g1, g2 = (t0 - e[row] * b0) / far, (t1 - e[row] * b1) / far, (t2 - e[row] * b2) / far
        h = mat_t_vec(R_CI, (g0, g1, g2))
        w = mat_vec(R, h)
        for k in range(3):
            J[row, k] = -w[k]
        J[row, 3] = h[1] * i[2] - h[2] * i[1]  # h x i: the point turns by -x
        J[row, 4] = h[2] * i[0] - h[0] * i[2]
        J[row, 5] = h[0] * i[1] - h[1] * i[0]
    return True


@njit
def tangent(b: Array, row: int) -> tuple[float, float, float]:
    """First (row 0) or second unit vector of a plane normal to the unit vector b."""
    if abs(b[0]) < 0.7:  # u = b x (x axis)
        u0, u1, u2 = 0.0, b[2], -b[1]
    else:  # u = b x (y axis)
        u0, u1, u2 = -b[2], 0.0, b[0]
    n = math.sqrt(u0 * u0 + u1 * u1 + u2 * u2)
    u0, u1, u2 = u0 / n, u1 / n, u2 / n
    if row == 0:
        return u0, u1, u2
    return b[1] * u2 - b[2] * u1, b[2] * u0 - b[0] * u2, b[0] * u1 - b[1] * u0


@njit
def _tukey(
    p: Array,
    R: Array,
    R_CI: Array,
    p_CI: Array,
    sights: Sights,
    prior: Array,
    constants: Array,
    counts: IntArray,
    weight: Array,
    H: Array,
) -> float:
    n = len(sights.camera)
    p0, R0, Rn, E = p.copy(), R.copy(), np.empty((3, 3)), np.empty((3, 3))
    e, J, length = np.zeros((n, 2)), np.zeros((n, 2, 6)), np.empty(n)
    g, turn = np.empty(6), np.empty(3)
    scale = float(constants[2])
    for it in range(counts[0]):
        for j in range(n):
            c = sights.camera[j]
            ok = sight_error(
                p, R, R_CI[c], p_CI[c], sights.p_WP[j], sights.bearing_C[j], e[j], J[j]
            )
            e[j] /= sights.sigma[j]
            J[j] /= sights.sigma[j]
            length[j] = math.sqrt(e[j, 0] ** 2 + e[j, 1] ** 2) if ok else np.inf
        if it < counts[1] and n > 0:
            scale = max(float(constants[2]), float(constants[0] * few(n) * np.median(length)))
        if not scale < np.inf:
            weight[:] = 0.0
            return scale
        _normal_equations(e, J, length, constants[1] * scale, scale, weight, H, g)
        _add_prior(p, R, p0, R0, prior, H, g)
        for k in range(6):
            H[k, k] += 1e-9
        x = np.linalg.solve(H, g)
        for k in range(3):
            p[k] -= x[k]
            turn[k] = -x[3 + k]
        so3_exp(turn, E)
        product(R, E, Rn)
        R[:] = Rn
    return scale


@njit
def few(n: int) -> float:
    """Factor on the scale of n 2-D errors of a fit with six unknowns: few points fit too well."""
    return 1.0 + 5.0 / max(1.0, 2.0 * n - 6.0)


@njit
def _normal_equations(
    e: Array,
    J: Array,
    length: Array,
    cutoff: float,
    scale: float,
    weight: Array,
    H: Array,
    g: Array,
) -> None:
    H[:] = 0.0
    g[:] = 0.0
    for j in range(len(length)):
        weight[j] = (1.0 - (length[j] / cutoff) ** 2) ** 2 if length[j] < cutoff else 0.0
        if weight[j] == 0.0:
            continue
        w = weight[j] / (scale * scale)
        for row in range(2):
            for a in range(6):
                g[a] += w * J[j, row, a] * e[j, row]
                for b in range(6):
                    H[a, b] += w * J[j, row, a] * J[j, row, b]


@njit
def _add_prior(p: Array, R: Array, p0: Array, R0: Array, prior: Array, H: Array, g: Array) -> None:
    d, D, Jr, full = np.empty(6), np.empty((3, 3)), np.empty((3, 3)), np.zeros((6, 6))
    for i in range(3):
        for j in range(3):
            D[i, j] = R0[0, i] * R[0, j] + R0[1, i] * R[1, j] + R0[2, i] * R[2, j]
        d[i] = p[i] - p0[i]
        full[i, i] = 1.0
    turn = so3_log(D)
    d[3], d[4], d[5] = turn
    right_jacobian(d[3:], Jr)
    full[3:, 3:] = np.linalg.inv(Jr)  # Log(R0^T R Exp(x)) = turn + Jr^-1 x
    for a in range(6):
        for b in range(6):
            for i in range(6):
                for j in range(6):
                    H[a, b] += full[i, a] * prior[i, j] * full[j, b]
        for i in range(6):
            for j in range(6):
                g[a] += full[i, a] * prior[i, j] * d[j]
