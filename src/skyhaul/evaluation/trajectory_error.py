# SPDX-License-Identifier: Apache-2.0
"""How far an estimated trajectory is from the true one: alignment, ATE, RPE, consistency."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skyhaul.errors import GeometryError
from skyhaul.geometry.quaternion import quat_conj, quat_exp, quat_log, quat_mul, quat_to_R
from skyhaul.geometry.so3 import rotation_z, so3_log
from skyhaul.types import Array, IntArray, frozen

Alignment = Literal["se3", "sim3", "none"]
NS_PER_S = 1_000_000_000


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses over time, by any clock."""

    time_ns: IntArray  # (n,) growing
    p: Array  # (n, 3) [m]
    q: Array  # (n, 4) unit quaternions

    def __post_init__(self) -> None:
        n = len(self.time_ns)
        if self.p.shape != (n, 3) or self.q.shape != (n, 4):
            raise GeometryError(
                f"a trajectory has p (n, 3) and q (n, 4) for n = {n} times, "
                f"got {self.p.shape} and {self.q.shape}"
            )
        if n > 1 and not np.all(np.diff(self.time_ns) > 0):
            raise GeometryError("the times of a trajectory must grow from pose to pose")
        frozen(self.time_ns, self.p, self.q)

    def rows(self, index: IntArray) -> "Trajectory":
        """Some of its poses."""
        return Trajectory(self.time_ns[index], self.p[index], self.q[index])

    def length_m(self) -> float:
        """Length of the path [m]."""
        return float(np.sum(np.linalg.norm(np.diff(self.p, axis=0), axis=1)))


@dataclass(frozen=True, eq=False)
class Matched:
    """An estimate and the truth at the same times."""

    estimate: Trajectory
    truth: Trajectory
    row: IntArray  # (m,) rows of the estimate that have a truth


@dataclass(frozen=True)
class TrajectoryError:
    """Errors of a trajectory and how they were taken."""

    ate_m: float  # RMS of the position error after alignment
    ate_max_m: float
    rpe_m: float  # RMS of the error of the motion over `rpe_delta_s`
    rpe_deg: float
    rpe_delta_s: float
    rpe_pairs: int  # motions that took so long
    matched: int  # pairs
    alignment: Alignment
    scale: float  # of the alignment; 1 unless sim3
    path_m: float  # length of the matched truth


MAX_GAP_S = 0.1
"""A pose of the estimate has a truth where the truth's neighbours are at most this apart [s]."""


def match(estimate: Trajectory, truth: Trajectory, max_gap_s: float = MAX_GAP_S) -> Matched:
    """The truth at the times of the estimate, between neighbours at most `max_gap_s` apart.

    Positions are linear between neighbours, attitudes turn at a constant rate.
    """
    gap_ns = round(max_gap_s * NS_PER_S)
    after = np.searchsorted(truth.time_ns, estimate.time_ns, side="left")
    exact = truth.time_ns[np.minimum(after, len(truth.time_ns) - 1)] == estimate.time_ns
    inside = (after > 0) & (after < len(truth.time_ns))
    b = np.clip(after, 1, len(truth.time_ns) - 1)
    near = truth.time_ns[b] - truth.time_ns[b - 1] <= gap_ns
    row = np.flatnonzero(exact | (inside & near))
    b, t = b[row], estimate.time_ns[row]
    span_ns = truth.time_ns[b] - truth.time_ns[b - 1]
    share = (t - truth.time_ns[b - 1]) / np.where(span_ns == 0, 1, span_ns)  # 0: one pose alone
    q_a, q_b = truth.q[b - 1], truth.q[b]
    turn = quat_log(quat_mul(quat_conj(q_a), q_b))
    q = quat_mul(q_a, quat_exp(share[:, None] * turn))
    p = truth.p[b - 1] + share[:, None] * (truth.p[b] - truth.p[b - 1])
    return Matched(estimate.rows(row), Trajectory(t, p, q), row)


def align(p_from: Array, p_to: Array, *, with_scale: bool) -> tuple[float, Array, Array]:
    """Scale s, rotation R and shift t that bring s R p_from + t closest to p_to.

    Args:
        p_from: (n, 3) [m].
        p_to: (n, 3) [m].
        with_scale: Whether s may differ from 1.

    Source:    Umeyama, IEEE PAMI 13(4), 1991.
    Limits:    Points on one line leave the turn about it open; it is then the smallest one of
        those that the singular vectors offer.
    """
    m_from, m_to = p_from.mean(axis=0), p_to.mean(axis=0)
    a, b = p_from - m_from, p_to - m_to
    U, singular, Vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, math.copysign(1.0, np.linalg.det(U) * np.linalg.det(Vt))])
    R: Array = U @ np.diag(sign) @ Vt
    spread = float(np.sum(a * a))
    s = float(singular @ sign) / spread if with_scale and spread > 0.0 else 1.0
    return s, R, m_to - s * R @ m_from


def trajectory_error(
    matched: Matched, alignment: Alignment = "se3", rpe_delta_s: float = 1.0
) -> TrajectoryError:
    """ATE after alignment over all pairs, and RPE, which needs none.

    RPE compares the motion over `rpe_delta_s`, from each pose to the first one that much later;
    where the next one is more than a tenth later still, there is a gap and no motion.
    """
    estimate, truth = matched.estimate, matched.truth
    s, R, t = 1.0, np.eye(3), np.zeros(3)
    if alignment != "none":
        s, R, t = align(estimate.p, truth.p, with_scale=alignment == "sim3")
    error = np.linalg.norm(s * estimate.p @ R.T + t - truth.p, axis=1)
    shift, turn = relative_errors(matched, s, rpe_delta_s)
    return TrajectoryError(
        ate_m=_rms(error),
        ate_max_m=float(error.max()),
        rpe_m=_rms(shift),
        rpe_deg=math.degrees(_rms(turn)),
        rpe_delta_s=rpe_delta_s,
        rpe_pairs=len(shift),
        matched=len(error),
        alignment=alignment,
        scale=s,
        path_m=truth.length_m(),
    )


def relative_errors(matched: Matched, scale: float, delta_s: float) -> tuple[Array, Array]:
    """Errors of the motions over `delta_s`: shift (m,) [m] and turn (m,) [rad]."""
    times = matched.truth.time_ns
    # Half a microsecond of slack: recorders round their stamps.
    later = np.searchsorted(times, times + round(delta_s * NS_PER_S) - 500, side="left")
    near = times[np.minimum(later, len(times) - 1)] - times <= round(1.1 * delta_s * NS_PER_S)
    i = np.flatnonzero((later < len(times)) & near)
    j = later[i]
    true_R, true_p = _motions(matched.truth, i, j, 1.0)
    our_R, our_p = _motions(matched.estimate, i, j, scale)
    shift = np.linalg.norm(our_p - true_p, axis=1)
    turn = np.linalg.norm(so3_log(np.swapaxes(true_R, 1, 2) @ our_R), axis=1)
    return shift, turn


def _motions(path: Trajectory, i: IntArray, j: IntArray, scale: float) -> tuple[Array, Array]:
    R_i, R_j = quat_to_R(path.q[i]), quat_to_R(path.q[j])
    back = np.swapaxes(R_i, 1, 2)
    return back @ R_j, scale * np.einsum("nij,nj->ni", back, path.p[j] - path.p[i])


def pose_nees(matched: Matched, covariance: Array) -> Array:
    """Squared error over its covariance at each pair; 6 on average for a consistent estimate.

    The truth is moved into the estimate's axes by shift and heading at the first pair, which the
    estimator cannot know.

    Args:
        matched: The pairs.
        covariance: Of the estimate's error (p, R), (m, 6, 6).
    """
    return _squared(_errors(matched), covariance)


def position_nees(matched: Matched, covariance: Array) -> Array:
    """The same for the position alone: 3 on average; for truths whose attitude is in doubt."""
    return _squared(_errors(matched)[:, :3], covariance[:, :3, :3])


def _errors(matched: Matched) -> Array:
    """Errors (p, R) of the estimate with the truth laid onto its first pose, (m, 6)."""
    estimate, truth = matched.estimate, matched.truth
    R_hat, R = quat_to_R(estimate.q), quat_to_R(truth.q)
    first = R_hat[0] @ R[0].T
    heading = rotation_z(math.atan2(first[1, 0] - first[0, 1], first[0, 0] + first[1, 1]))
    p = (truth.p - truth.p[0]) @ heading.T + estimate.p[0]
    turn = so3_log(np.swapaxes(R_hat, 1, 2) @ (heading @ R))
    return np.hstack([p - estimate.p, turn])


def _squared(error: Array, covariance: Array) -> Array:
    scaled = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    nees: Array = np.einsum("ni,ni->n", error, scaled)
    return nees


def _rms(x: Array) -> float:
    return math.sqrt(float(np.mean(x * x))) if len(x) else math.nan
