# SPDX-License-Identifier: Apache-2.0
"""`kind: ekf`: error-state Kalman filter over the state and clones of past poses.

A track that ends, or that has been followed for long enough, constrains the clones that saw it;
its point is eliminated on the spot (multi-state constraint filter).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.special import chdtri

from skyhaul.geometry.so3 import hat
from skyhaul.params import Params
from skyhaul.perception.vio.api import (
    NE,
    CameraRig,
    NavState,
    StartPose,
    TrackFrame,
    V,
    VioEstimate,
    VioStatus,
)
from skyhaul.perception.vio.beginning import Beginning, begin
from skyhaul.perception.vio.clones import (
    CloneFilter,
    clone,
    correct,
    forget_clone,
    move,
    start_filter,
)
from skyhaul.perception.vio.imu import ImuNoise, advance, segments
from skyhaul.perception.vio.intake import Intake
from skyhaul.perception.vio.rest import Rest, rest_of, widened
from skyhaul.perception.vio.triangulation import Point, locate
from skyhaul.sensors.api import ImuReading
from skyhaul.types import US_PER_S, Array, IntArray, TimeUs

FIT = 5.0
"""RMS error of the sights of a landmark that is handed on, in standard deviations."""


@dataclass(frozen=True, kw_only=True)
class EkfVio(Params):
    """Error-state Kalman filter over clones of past poses."""

    kind: Literal["ekf"] = "ekf"
    keyframe_s: float = 0.1
    """Time between clones [s]."""
    clones: int = 20
    """Clones that are kept."""
    quota: int = 4
    """Tracks still followed that may be used at a clone, so that not all end together."""
    ripe: float = 0.6
    """Share of the clones that such a track must have seen."""
    least_sights: int = 4
    """Clones that must have seen a track."""
    parallax_rad: float = 0.02
    """Angle between two of its bearings that a track needs [rad]."""
    slide: float = 0.0
    """Random walk of a track off its point, in standard deviations of a sight [1/sqrt(s)]."""
    gate: float = 0.95
    """Share of good tracks that pass the chi-square gate."""
    depth_m: tuple[float, float] = (0.2, 50.0)
    """Depths at which points may lie [m]."""
    lost_s: float = 2.0
    """Without a track that passes for this long the status is LOST [s]."""
    beginning: Beginning = field(default_factory=Beginning)
    """How the first state is found."""
    noise: ImuNoise = field(default_factory=ImuNoise)
    """Noise of the IMU."""

    def __post_init__(self) -> None:
        for name in ("keyframe_s", "lost_s", "parallax_rad"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not 3 <= self.least_sights <= self.clones:
            raise ValueError(
                f"least_sights must be 3 to clones ({self.clones}), got {self.least_sights}"
            )
        for name in ("gate", "ripe"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name} must lie between 0 and 1, got {getattr(self, name)}")

    def build(self, rig: CameraRig, sigma: float | Array) -> "EkfEstimator":
        """The estimator of a rig.

        Args:
            rig: The cameras.
            sigma: Standard deviation of a track in the normalised image, per axis; one, or one
                for each camera.
        """
        return EkfEstimator(self, rig, np.broadcast_to(sigma, len(rig.p_IC)))


@dataclass(frozen=True, eq=False)
class ClonedTrack:
    """A track and the clones that saw it."""

    camera: tuple[int, ...]  # of each sight
    k: tuple[int, ...]  # keyframes, growing; two cameras of one keyframe may see it
    xy: tuple[Array, ...]  # (2,) each

    def seen_from(self, k: int) -> "ClonedTrack":
        """The track without what was seen before a keyframe."""
        first = sum(i < k for i in self.k)
        return ClonedTrack(self.camera[first:], self.k[first:], self.xy[first:])


@dataclass(frozen=True, eq=False)
class EkfMemory:
    """What the filter remembers."""

    start: StartPose
    intake: Intake
    filter: CloneFilter | None = None
    stamp_us: TimeUs = 0  # of the filter's state
    newest: int = 0  # keyframe
    tracks: Mapping[int, ClonedTrack] = field(default_factory=dict)
    seen_us: TimeUs = 0
    used: int = 0
    rejected: int = 0


@dataclass(frozen=True, eq=False)
class EkfEstimator:
    """Implements `VioEstimator`."""

    params: EkfVio
    rig: CameraRig
    sigma: Array  # (c,) of a track of each camera

    def init(self, start: StartPose) -> EkfMemory:
        """See `VioEstimator.init`."""
        return EkfMemory(start, Intake(self.params.beginning.keep_s))

    def step(
        self, memory: EkfMemory, imu: ImuReading, tracks: TrackFrame
    ) -> tuple[EkfMemory, VioEstimate]:
        """See `VioEstimator.step`."""
        memory = replace(memory, intake=memory.intake.take(imu, tracks))
        if memory.filter is None:
            return self._begin(memory)
        samples = segments(memory.intake.imu, memory.stamp_us, tracks.stamp_us)
        filter_, noise = memory.filter, self.params.noise.over(samples)
        predicted, Phi, Q = advance(filter_.state, samples, noise)
        due_us = memory.stamp_us + round(0.99 * self.params.keyframe_s * US_PER_S)
        if tracks.stamp_us < due_us:
            covariance = Phi @ filter_.covariance[:NE, :NE] @ Phi.T + Q
            return memory, self._estimate(memory, predicted, covariance)
        filter_ = move(filter_, predicted, Phi, Q, float(samples[:, 0].sum()))
        memory = self._keyframe(memory, filter_, tracks)
        assert memory.filter is not None
        covariance = memory.filter.covariance[:NE, :NE].copy()
        return memory, self._estimate(memory, memory.filter.state, covariance)

    def landmarks(self, memory: EkfMemory) -> dict[int, Array]:
        """See `VioEstimator.landmarks`: from the clones and sights that are kept."""
        p, filter_, out = self.params, memory.filter, {}
        for track_id, track in memory.tracks.items():
            if filter_ is None or len(track.k) < p.least_sights:
                continue
            _, point = point_of(filter_, self.rig, track)
            near = p.depth_m[0] < point.depth_m < p.depth_m[1]
            if near and point.parallax_rad >= p.parallax_rad and point.error <= FIT * self.sigma[0]:
                out[track_id] = point.p_WP
        return out

    def _begin(self, memory: EkfMemory) -> tuple[EkfMemory, VioEstimate]:
        p, frame = self.params, memory.intake.frames[-1]
        first = begin(
            p.beginning, memory.intake, memory.start, self.rig, p.noise, float(self.sigma[0])
        )
        if first is None:
            none = np.zeros((NE, NE))
            return memory, VioEstimate(frame.stamp_us, VioStatus.INITIALIZING, None, none, 0, 0)
        memory = self._keyframe(memory, start_filter(*first), frame)
        memory = replace(memory, seen_us=frame.stamp_us)
        return memory, self._estimate(memory, first[0], first[1].copy())

    def _keyframe(self, memory: EkfMemory, filter_: CloneFilter, frame: TrackFrame) -> EkfMemory:
        """Clone the pose, follow the tracks, use those that are ripe."""
        p, now, k = self.params, frame.stamp_us, memory.newest + 1
        filter_ = clone(filter_, k)
        standing = p.beginning.standing
        rest = rest_of(standing, memory.intake, filter_.state, filter_.covariance[:NE, :NE])
        if rest is Rest.DESPITE:
            filter_ = replace(filter_, covariance=widened(filter_.state, filter_.covariance))
        if rest is not Rest.NO:
            H = np.zeros((3, len(filter_.covariance)))
            H[:, V] = np.eye(3)
            filter_ = correct(filter_, -filter_.state.v_WI, H, standing.speed_sigma_mps)
        tracks, ended = follow(memory.tracks, frame, k)
        due = [*ended, *self._ripe(tracks, filter_)]
        filter_, used, rejected = self._use(filter_, [t for _, t in due])
        for track_id, _ in due:
            tracks.pop(track_id, None)
        if len(filter_.clone_k) > p.clones:
            filter_ = forget_clone(filter_, 0)
            tracks = {i: t.seen_from(filter_.clone_k[0]) for i, t in tracks.items()}
        return replace(
            memory,
            filter=filter_,
            stamp_us=now,
            newest=k,
            tracks=tracks,
            seen_us=now if used or rest is not Rest.NO else memory.seen_us,
            used=used,
            rejected=rejected,
        )

    def _ripe(
        self, tracks: Mapping[int, ClonedTrack], filter_: CloneFilter
    ) -> list[tuple[int, ClonedTrack]]:
        """Tracks to use although they go on: those that would lose a sight, then the longest."""
        p = self.params
        full = len(filter_.clone_k) >= p.clones
        oldest = filter_.clone_k[0]
        must = [(i, t) for i, t in tracks.items() if full and t.k[0] <= oldest]
        rest = [
            (i, t) for i, t in tracks.items() if t.k[0] > oldest and len(t.k) >= p.ripe * p.clones
        ]
        rest.sort(key=lambda item: (-len(item[1].k), item[0]))
        return must + rest[: p.quota]

    def _use(
        self, filter_: CloneFilter, tracks: Sequence[ClonedTrack]
    ) -> tuple[CloneFilter, int, int]:
        """Update with the tracks that pass; how many did and how many did not."""
        rows, residuals, rejected = [], [], 0
        for track in tracks:
            if len(track.k) < self.params.least_sights:
                continue
            constraint = track_constraint(filter_, self.rig, track, self.params, self.sigma)
            if constraint is None:
                continue
            residual, H = constraint
            S = H @ filter_.covariance @ H.T + np.eye(len(residual))
            bound = chdtri(len(residual), 1.0 - self.params.gate)  # chi-square quantile
            if residual @ np.linalg.solve(S, residual) > bound:
                rejected += 1
                continue
            rows.append(H)
            residuals.append(residual)
        if rows:
            filter_ = correct(filter_, np.concatenate(residuals), np.vstack(rows), 1.0)
        return filter_, len(rows), rejected

    def _estimate(self, memory: EkfMemory, state: NavState, covariance: Array) -> VioEstimate:
        now = memory.intake.now_us
        lost = now - memory.seen_us > round(self.params.lost_s * US_PER_S)
        status = VioStatus.LOST if lost else VioStatus.TRACKING
        return VioEstimate(now, status, state, covariance, memory.used, memory.rejected)


def follow(
    tracks: Mapping[int, ClonedTrack], frame: TrackFrame, k: int
) -> tuple[dict[int, ClonedTrack], list[tuple[int, ClonedTrack]]]:
    """Tracks with what keyframe k sees of them, and those that ended."""
    going: dict[int, ClonedTrack] = {}
    for track_id, camera, xy in zip(
        frame.track_id.tolist(), frame.camera.tolist(), frame.xy, strict=True
    ):
        old = going.get(track_id) or tracks.get(track_id) or ClonedTrack((), (), ())
        going[track_id] = ClonedTrack((*old.camera, camera), (*old.k, k), (*old.xy, xy))
    return going, [(i, t) for i, t in tracks.items() if i not in going]


def track_constraint(
    filter_: CloneFilter, rig: CameraRig, track: ClonedTrack, params: EkfVio, sigma: Array
) -> tuple[Array, Array] | None:
    """Residual and derivative of a track with its point eliminated; None where it has no point.

    The residual, in standard deviations `sigma` of each camera's tracks, (c,), is multiplied by a
    basis of all directions that moving the point cannot change.
    """
    poses, point = point_of(filter_, rig, track)
    R_WI, p_WI, R_IC, p_IC, index = poses
    camera, xy = np.array(track.camera), np.array(track.xy)
    if point.parallax_rad < params.parallax_rad:
        return None
    if not params.depth_m[0] < point.depth_m < params.depth_m[1]:
        return None
    seen = _project(R_WI, p_WI, R_IC, p_IC, point.p_WP)
    white = np.linalg.inv(np.linalg.cholesky(_noise_of(track, sigma[camera], params)))
    residual = (white @ (xy - seen[:, :2] / seen[:, 2:])).ravel()
    first_R, first_p = filter_.first_R[index], filter_.first_p[index]
    by_pose, by_point = sight_derivatives(first_R, first_p, R_IC, p_IC, point.p_WP)
    by_point = np.einsum("ij,jab->iab", white, by_point)
    H = np.zeros((len(xy), 2, len(filter_.covariance)))
    for row, i in enumerate(index):
        H[row, :, NE + 6 * i : NE + 6 * i + 6] = by_pose[row]
    H = np.einsum("ij,jab->iab", white, H).reshape(len(residual), -1)
    basis = np.linalg.qr(by_point.reshape(-1, 3), mode="complete").Q[:, 3:]
    return basis.T @ residual, basis.T @ H


def point_of(
    filter_: CloneFilter, rig: CameraRig, track: ClonedTrack
) -> tuple[tuple[Array, Array, Array, Array, IntArray], Point]:
    """Poses of body and camera at each sight, their rows among the clones; the track's point."""
    index = np.array([filter_.clone_k.index(k) for k in track.k])
    camera = np.array(track.camera)
    R_IC, p_IC = rig.R_IC[camera], rig.p_IC[camera]
    R_WI, p_WI = filter_.clone_R[index], filter_.clone_p[index]
    p_WC = p_WI + np.einsum("kij,kj->ki", R_WI, p_IC)
    point = locate(R_WI @ R_IC, p_WC, np.array(track.xy))
    return (R_WI, p_WI, R_IC, p_IC, index), point


def _noise_of(track: ClonedTrack, sigma: Array, params: EkfVio) -> Array:
    """Covariance of the sights of a track, per axis of the image, (n, n).

    White noise, and a walk: a patch slides off its point as its look changes. Each camera walks
    on its own, from its first sight on; what came before is a shift of the point.
    """
    t_s = params.keyframe_s * (np.array(track.k) - track.k[0])
    same = np.equal.outer(track.camera, track.camera)
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
