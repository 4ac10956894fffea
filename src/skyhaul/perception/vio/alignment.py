# SPDX-License-Identifier: Apache-2.0
"""Gyroscope bias, scale, gravity and velocities from poses up to scale and the IMU between them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyhaul.geometry.so3 import so3_log
from skyhaul.perception.vio.api import R
from skyhaul.perception.vio.preintegration import Preintegrated
from skyhaul.types import GRAVITY_MPS2, Array, frozen


@dataclass(frozen=True, eq=False)
class Alignment:
    """What makes poses up to scale metric and upright, in the axes S of the poses."""

    scale: float
    gravity_S: Array  # (3,) [m/s^2], of length g
    v_SI: Array  # (n, 3) [m/s]
    scale_sigma: float  # of the scale, as a share of it
    gravity_free_mps2: float  # length of gravity before it was set to g

    def __post_init__(self) -> None:
        frozen(self.gravity_S, self.v_SI)


def gyro_bias_step(motions: Sequence[Preintegrated], R_SI: Array) -> Array:
    """Change of the gyroscope's bias that brings its turns onto those of the poses, (3,) [rad/s].

    Least squares over pairs: Log(R_ij^T R_i^T R_j) = (d turn / d bias) change.
    """
    A: Array = np.zeros((3, 3))
    b: Array = np.zeros(3)
    for i, motion in enumerate(motions):
        J = motion.by_bias[R, 0:3]
        e = so3_log(motion.R_ij.T @ R_SI[i].T @ R_SI[i + 1])
        A += J.T @ J
        b += J.T @ e
    return np.asarray(np.linalg.solve(A, b), dtype=np.float64)


def align_poses(
    motions: Sequence[Preintegrated], R_SI: Array, p_SC: Array, p_IC: Array
) -> Alignment | None:
    """Scale, gravity and velocities; None where the equations are singular.

    For each pair, with p_SI = s p_SC - R_SI p_IC:
        v_i dt + 1/2 g dt^2 - s (p_SC_j - p_SC_i) = -R_i dp - (R_j - R_i) p_IC
        v_j - v_i - g dt = R_i dv
    first with g free, then with its length held, where only its direction turns.

    Args:
        motions: Between neighbours, n - 1, the gyroscope's bias taken off.
        R_SI: Attitudes, (n, 3, 3).
        p_SC: Positions of the camera, free scale, (n, 3).
        p_IC: Camera on the body, (3,) [m].

    Source:    Qin, Li and Shen, VINS-Mono (IEEE T-RO 2018), V-B, in our own form.
    """
    A, b, weight = _equations(motions, R_SI, p_SC, p_IC)
    solved = _solve(A, b, weight)
    if solved is None:
        return None
    x, _ = solved
    free = float(np.linalg.norm(x[1:4]))
    if not free > 1e-6:
        return None
    g = GRAVITY_MPS2 * x[1:4] / free
    for _ in range(4):
        plane = np.linalg.svd(g[None])[2][1:].T  # two directions normal to g
        held = np.hstack([A[:, :1], A[:, 1:4] @ plane, A[:, 4:]])
        solved = _solve(held, b - A[:, 1:4] @ g, weight)
        if solved is None:
            return None
        x, covariance = solved
        g = g + plane @ x[1:3]
        g *= GRAVITY_MPS2 / np.linalg.norm(g)
    scale = float(x[0])
    sigma = float(np.sqrt(covariance[0, 0]) / max(abs(scale), 1e-12))
    return Alignment(scale, g, x[3:].reshape(-1, 3), sigma, free)


def _equations(
    motions: Sequence[Preintegrated], R_SI: Array, p_SC: Array, p_IC: Array
) -> tuple[Array, Array, Array]:
    """A x = b for x = (s, g, v_0 .. v_n-1), and the standard deviation of each row."""
    n = len(R_SI)
    A, b, sigma = np.zeros((6 * (n - 1), 4 + 3 * n)), np.zeros(6 * (n - 1)), np.zeros(6 * (n - 1))
    for i, motion in enumerate(motions):
        h, p, v = motion.dt_s, slice(6 * i, 6 * i + 3), slice(6 * i + 3, 6 * i + 6)
        at = 4 + 3 * i
        A[p, 0] = -(p_SC[i + 1] - p_SC[i])
        A[p, 1:4] = 0.5 * h * h * np.eye(3)
        A[p, at : at + 3] = h * np.eye(3)
        b[p] = -R_SI[i] @ motion.dp - (R_SI[i + 1] - R_SI[i]) @ p_IC
        A[v, 1:4] = -h * np.eye(3)
        A[v, at : at + 3] = -np.eye(3)
        A[v, at + 3 : at + 6] = np.eye(3)
        b[v] = R_SI[i] @ motion.dv
        # A bias of 0.1 m/s^2 that is not known adds to what the noise does.
        sigma[p] = np.hypot(0.05 * h * h, np.sqrt(motion.covariance[0, 0])) + 0.005
        sigma[v] = np.hypot(0.1 * h, np.sqrt(motion.covariance[6, 6]))
    return A, b, sigma


def _solve(A: Array, b: Array, sigma: Array) -> tuple[Array, Array] | None:
    """Weighted least squares and its covariance."""
    weighted = A / sigma[:, None]
    information = weighted.T @ weighted
    if not np.linalg.cond(information) < 1e14:
        return None
    x: Array = np.linalg.solve(information, weighted.T @ (b / sigma)).astype(np.float64)
    return x, np.linalg.inv(information).astype(np.float64)
