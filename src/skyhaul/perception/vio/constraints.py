# SPDX-License-Identifier: Apache-2.0
"""What a track says of the clones that saw it, its point eliminated (multi-state constraint)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import chdtri

from skyhaul.geometry.so3 import hat
from skyhaul.perception.vio.api import NE, CameraRig
from skyhaul.perception.vio.clones import CloneFilter
from skyhaul.perception.vio.triangulation import Point, locate
from skyhaul.types import US_PER_S, Array, IntArray, TimeUs


class SightParams(Protocol):
    """What is asked of tracks; see `ekf.EkfVio`."""

    @property
    def slide(self) -> float:
        """Random walk of a track off its point, in standard deviations of a sight [1/sqrt(s)]."""
        ...

    @property
    def parallax_rad(self) -> float:
        """Angle between two bearings of a point that is placed [rad]."""
        ...

    @property
    def depth_m(self) -> tuple[float, float]:
        """Depths at which points may lie [m]."""
        ...

    @property
    def far_m(self) -> float:
        """Depth at which the points of bearings that stand are taken to be [m]."""
        ...

    @property
    def gate(self) -> float:
        """Share of good tracks that pass a chi-square test."""
        ...


_INFINITE_M = 1e6


@dataclass(frozen=True, eq=False)
class ClonedTrack:
    """A track and the clones that saw it."""

    camera: tuple[int, ...]  # of each sight
    k: tuple[int, ...]  # keyframes, growing; two cameras of one keyframe may see it
    xy: tuple[Array, ...]  # (2,) each
    stamp_us: tuple[TimeUs, ...]

    def seen_from(self, k: int) -> "ClonedTrack":
        """The track without what was seen before a keyframe."""
        first = sum(i < k for i in self.k)
        return ClonedTrack(
            self.camera[first:], self.k[first:], self.xy[first:], self.stamp_us[first:]
        )


def track_constraint(
    filter_: CloneFilter,
    rig: CameraRig,
    track: ClonedTrack,
    params: SightParams,
    sigma: Array,
    parallax_rad: float | None = None,
) -> tuple[Array, Array] | None:
    """Residual and derivative of a track with its point eliminated; None where it has no point.

    The residual, in standard deviations `sigma` of each camera's tracks, (c,), is multiplied by a
    basis of all directions that moving the point cannot change. `parallax_rad` takes the place of
    the parameter of that name.
    """
    poses, point = point_of(filter_, rig, track)
    if point.parallax_rad < (params.parallax_rad if parallax_rad is None else parallax_rad):
        return None
    if not params.depth_m[0] < point.depth_m < params.depth_m[1]:
        return None
    residual, H, by_point = _linear(filter_, track, params, sigma, poses, point.p_WP)
    basis = _without(by_point)
    return basis.T @ residual, basis.T @ H


def standing_constraint(
    filter_: CloneFilter, rig: CameraRig, track: ClonedTrack, params: SightParams, sigma: Array
) -> tuple[Array, Array] | None:
    """The same for a track whose bearings stand, so that its point cannot be placed; else None.

    Bearings that stand tell that the camera does, unless the point is very far. It is put at
    `far_m` on the last bearing, which is cautious: a nearer one would hold the camera more firmly.
    Only its direction is eliminated. Bearings that move are of no use, their scale is not known.
    """
    poses = _poses_of(filter_, rig, track)
    R_WI, p_WI, R_IC, p_IC, _ = poses
    R_WC, p_WC = R_WI[-1] @ R_IC[-1], p_WI[-1] + R_WI[-1] @ p_IC[-1]
    ray = R_WC @ np.append(track.xy[-1], 1.0)
    turn, _, by_point = _linear(filter_, track, params, sigma, poses, p_WC + _INFINITE_M * ray)
    turn = _without(by_point @ R_WC[:, :2]).T @ turn
    if turn @ turn > chdtri(len(turn), 1.0 - params.gate):
        return None
    residual, H, by_point = _linear(filter_, track, params, sigma, poses, p_WC + params.far_m * ray)
    basis = _without(by_point @ R_WC[:, :2])
    return basis.T @ residual, basis.T @ H


Constraint = tuple[Array, Array]
"""Residual (r,) of a track in standard deviations, and its derivative by the state (r, n)."""


def agreeing(
    filter_: CloneFilter, constraints: Sequence[Constraint], gate: float
) -> list[Constraint]:
    """Those that agree with the update that they make together.

    While a filter is unsure each passes its gate alone, sliding tracks too; together they cannot
    all be right. The worst quarter of those that the update leaves off is dropped, and it is made
    anew.

    Args:
        filter_: Before the update.
        constraints: Of the tracks that passed the gate.
        gate: Share of good tracks whose residual after the update is taken for noise.
    """
    kept = list(constraints)
    while len(kept) > 2:
        residual, H = np.concatenate([r for r, _ in kept]), np.vstack([H for _, H in kept])
        S = H @ filter_.covariance @ H.T + np.eye(len(residual))
        error = filter_.covariance @ (H.T @ np.linalg.solve(S, residual))
        left = [r - H @ error for r, H in kept]
        off = np.array([r @ r / chdtri(len(r), 1.0 - gate) for r in left])
        wrong = np.flatnonzero(off > 1.0)
        if not len(wrong):
            break
        worst = wrong[np.argsort(-off[wrong], kind="stable")][: max(1, len(kept) // 4)]
        kept = [c for k, c in enumerate(kept) if k not in worst]
    return kept


def _without(columns: Array) -> Array:
    """Basis of all directions at right angles to some columns, (n, n - m)."""
    Q: Array = np.linalg.qr(columns, mode="complete").Q
    return Q[:, columns.shape[1] :]


Poses = tuple[Array, Array, Array, Array, IntArray]
"""R_WI (k, 3, 3), p_WI (k, 3), R_IC, p_IC of each sight of a track, and their rows, (k,)."""


def _linear(
    filter_: CloneFilter,
    track: ClonedTrack,
    params: SightParams,
    sigma: Array,
    poses: Poses,
    p_WP: Array,
) -> tuple[Array, Array, Array]:
    """Residual of a track, (2k,), in standard deviations; by the state (2k, n), by its point."""
    R_WI, p_WI, R_IC, p_IC, index = poses
    camera, xy = np.array(track.camera), np.array(track.xy)
    seen = _project(R_WI, p_WI, R_IC, p_IC, p_WP)
    white = np.linalg.inv(np.linalg.cholesky(_noise_of(track, sigma[camera], params)))
    residual = (white @ (xy - seen[:, :2] / seen[:, 2:])).ravel()
    first_R, first_p = filter_.first_R[index], filter_.first_p[index]
    by_pose, by_point = sight_derivatives(first_R, first_p, R_IC, p_IC, p_WP)
    by_point = np.einsum("ij,jab->iab", white, by_point)
    H = np.zeros((len(xy), 2, len(filter_.covariance)))
    for row, i in enumerate(index):
        H[row, :, NE + 6 * i : NE + 6 * i + 6] = by_pose[row]
    H = np.einsum("ij,jab->iab", white, H).reshape(len(residual), -1)
    return residual, H, by_point.reshape(-1, 3)


def point_of(filter_: CloneFilter, rig: CameraRig, track: ClonedTrack) -> tuple[Poses, Point]:
    """Poses of body and camera at each sight; the track's point."""
    poses = _poses_of(filter_, rig, track)
    R_WI, p_WI, R_IC, p_IC, _ = poses
    p_WC = p_WI + np.einsum("kij,kj->ki", R_WI, p_IC)
    return poses, locate(R_WI @ R_IC, p_WC, np.array(track.xy))


def _poses_of(filter_: CloneFilter, rig: CameraRig, track: ClonedTrack) -> Poses:
    index, camera = np.array([filter_.clone_k.index(k) for k in track.k]), np.array(track.camera)
    return filter_.clone_R[index], filter_.clone_p[index], rig.R_IC[camera], rig.p_IC[camera], index


def _noise_of(track: ClonedTrack, sigma: Array, params: SightParams) -> Array:
    """Covariance of the sights of a track, per axis of the image, (n, n).

    White noise, and a walk: a patch slides off its point as its look changes. Each camera walks
    on its own, from its first sight on; what came before is a shift of the point.
    """
    same = np.equal.outer(track.camera, track.camera)
    stamp_us = np.array(track.stamp_us)
    t_s = (stamp_us - stamp_us[np.argmax(same, axis=1)]) / US_PER_S  # since its camera's first
    walk = params.slide**2 * np.minimum.outer(t_s, t_s) * same
    covariance: Array = np.outer(sigma, sigma) * (np.eye(len(sigma)) + walk)
    return covariance


def _project(R_WI: Array, p_WI: Array, R_IC: Array, p_IC: Array, p_WP: Array) -> Array:
    """A point in camera axes, (k, 3)."""
    point_I = np.einsum("kji,kj->ki", R_WI, p_WP - p_WI) - p_IC
    seen: Array = np.einsum("kji,kj->ki", R_IC, point_I)
    return seen


def sight_derivatives(
    R_WI: Array, p_WI: Array, R_IC: Array, p_IC: Array, p_WP: Array
) -> tuple[Array, Array]:
    """Derivatives of a point's normalised image by the poses (p, R) and by the point.

    Args:
        R_WI: Attitudes, (k, 3, 3).
        p_WI: Positions, (k, 3) [m].
        R_IC: Camera on the body of each sight, (k, 3, 3).
        p_IC: (k, 3) [m].
        p_WP: The point, (3,) [m].

    Returns:
        (k, 2, 6) and (k, 2, 3).
    """
    c = _project(R_WI, p_WI, R_IC, p_IC, p_WP)
    z = np.maximum(c[:, 2], 0.05)
    by_c = np.zeros((len(c), 2, 3))
    by_c[:, 0, 0] = by_c[:, 1, 1] = 1.0 / z
    by_c[:, :, 2] = -c[:, :2] / (z * z)[:, None]
    by_I = by_c @ np.swapaxes(R_IC, 1, 2)
    by_point = by_I @ np.swapaxes(R_WI, 1, 2)
    turned = hat(np.einsum("kji,kj->ki", R_WI, p_WP - p_WI))
    return np.concatenate([-by_point, by_I @ turned], axis=2), by_point
