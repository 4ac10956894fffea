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
    rebased,
    start_filter,
)
from skyhaul.perception.vio.constraints import (
    ClonedTrack,
    agreeing,
    point_of,
    standing_constraint,
    track_constraint,
)
from skyhaul.perception.vio.imu import ImuNoise, advance, segments
from skyhaul.perception.vio.intake import Intake
from skyhaul.perception.vio.keyframes import kept, keyframe_due
from skyhaul.perception.vio.rest import Rest, rest_of, widened
from skyhaul.sensors.api import ImuReading
from skyhaul.types import US_PER_S, Array, TimeUs

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
    adrift_s: float = 0.3
    """Without a track that passes for this long, tracks that are not ripe are used too: seen by two
    cameras, or with bearings that stand [s]."""
    held_quota: int = 12
    """How many of them at a clone at most ..."""
    least_held: int = 4
    """... and at least; most of them must agree with the filter."""
    stereo_rad: float = 0.008
    """Parallax that two cameras together need [rad]."""
    far_m: float = 10.0
    """Points of bearings that stand are taken to lie here: cautious where most are nearer [m]."""
    lost_s: float = 2.0
    """TRACKING asks that in this time `least_passed` tracks passed and more than did not, by their
    last sights, or that the vehicle rested or began [s]."""
    least_passed: int = 4
    """See `lost_s`."""
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


Trial = tuple[TimeUs, bool]
"""A track that was asked: when it was seen last, and whether it passed."""


@dataclass(frozen=True, eq=False)
class EkfMemory:
    """What the filter remembers."""

    start: StartPose
    intake: Intake
    filter: CloneFilter | None = None
    stamp_us: TimeUs = 0  # of the filter's state
    newest: int = 0  # keyframe
    kept_us: Mapping[int, TimeUs] = field(default_factory=dict)  # last keyframe of each camera
    tracks: Mapping[int, ClonedTrack] = field(default_factory=dict)
    seen_us: TimeUs = 0  # a track passed, or the vehicle rested
    sure_us: TimeUs = 0  # the vehicle rested, or began
    tried: tuple[Trial, ...] = ()  # in the last `lost_s`
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
        assumed = self.params.noise.through_gaps(
            memory.intake.imu, memory.stamp_us, tracks.stamp_us
        )
        filter_, noise = memory.filter, assumed.over(samples)
        predicted, Phi, Q = advance(filter_.state, samples, noise)
        frames, every_s = memory.intake.frames, self.params.keyframe_s
        if not keyframe_due(every_s, frames, memory.stamp_us, memory.kept_us):
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
            if (
                near
                and point.parallax_rad >= p.parallax_rad
                and point.error <= FIT * float(np.max(self.sigma[list(track.camera)]))
            ):
                out[track_id] = point.p_WP
        return out

    def restart(self, memory: EkfMemory, state: NavState, covariance: Array) -> EkfMemory:
        """See `VioEstimator.restart`; clones and tracks go along."""
        now, filter_, imu = memory.intake.now_us, memory.filter, memory.intake.imu
        assert filter_ is not None, "there was a state"
        if memory.stamp_us < now:
            samples = segments(imu, memory.stamp_us, now)
            noise = self.params.noise.through_gaps(imu, memory.stamp_us, now).over(samples)
            predicted, Phi, Q = advance(filter_.state, samples, noise)
            filter_ = move(filter_, predicted, Phi, Q, float(samples[:, 0].sum()))
        filter_ = rebased(filter_, state, covariance)
        return replace(memory, filter=filter_, stamp_us=now, seen_us=now, sure_us=now)

    def _begin(self, memory: EkfMemory) -> tuple[EkfMemory, VioEstimate]:
        p, frame = self.params, memory.intake.frames[-1]
        first = begin(
            p.beginning, memory.intake, memory.start, self.rig, p.noise, float(self.sigma[0])
        )
        if first is None:
            none = np.zeros((NE, NE))
            return memory, VioEstimate(frame.stamp_us, VioStatus.INITIALIZING, None, none, 0, 0)
        memory = self._keyframe(memory, start_filter(*first), frame)
        memory = replace(memory, seen_us=frame.stamp_us, sure_us=frame.stamp_us)
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
        filter_, tried = self._use(filter_, [t for _, t in due])
        used = sum(passed for _, passed in tried)
        adrift = now - memory.seen_us > round(p.adrift_s * US_PER_S)
        if adrift and not used and rest is Rest.NO:
            longest = self._longest(tracks)
            filter_, used = self._hold(filter_, [t for _, t in longest])
            due = [*due, *(longest if used else ())]
            tried = [*tried, *[(now, True)] * used]
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
            kept_us=kept(memory.kept_us, frame, len(self.sigma)),
            tracks=tracks,
            seen_us=now if used or rest is not Rest.NO else memory.seen_us,
            sure_us=now if rest is not Rest.NO else memory.sure_us,
            tried=tuple(t for t in (*memory.tried, *tried) if self._lately(t[0], now)),
            used=used,
            rejected=sum(not passed for _, passed in tried),
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

    def _longest(self, tracks: Mapping[int, ClonedTrack]) -> list[tuple[int, ClonedTrack]]:
        """The tracks that go on and have been followed longest."""
        p = self.params
        going = [(i, t) for i, t in tracks.items() if len(t.k) >= p.least_sights]
        going.sort(key=lambda item: (-len(item[1].k), item[0]))
        return going[: p.held_quota]

    def _use(
        self, filter_: CloneFilter, tracks: Sequence[ClonedTrack]
    ) -> tuple[CloneFilter, list[Trial]]:
        """Update with the tracks that pass; which did and which did not."""
        found, seen_us = [], []
        for track in tracks:
            if len(track.k) >= self.params.least_sights:
                c = track_constraint(filter_, self.rig, track, self.params, self.sigma)
                if c is not None:
                    found.append(c)
                    seen_us.append(track.stamp_us[-1])
        good = agreeing(filter_, [c for c in found if self._passes(filter_, *c)], self.params.gate)
        if good:
            residual, H = np.concatenate([r for r, _ in good]), np.vstack([H for _, H in good])
            filter_ = correct(filter_, residual, H, 1.0)
        passed = {id(c) for c in good}
        return filter_, [(t, id(c) in passed) for t, c in zip(seen_us, found, strict=True)]

    def _hold(self, filter_: CloneFilter, tracks: Sequence[ClonedTrack]) -> tuple[CloneFilter, int]:
        """Update with tracks that are not ripe, if most of them agree with the filter; how many.

        Two cameras place a point with little parallax; what one camera sees must stand, and most of
        it must: of a camera that moves among near points a few bearings stand by chance.
        """
        p, found, others = self.params, [], 0
        for track in tracks:
            if len(set(track.camera)) > 1:
                c = track_constraint(filter_, self.rig, track, p, self.sigma, p.stereo_rad)
            else:
                c = standing_constraint(filter_, self.rig, track, p, self.sigma)
            if c is not None:
                found.append(c)
            else:
                others += len(set(track.camera)) == 1
        good = [c for c in found if self._passes(filter_, *c)]
        if len(good) < p.least_held or 2 * len(good) <= len(found) + others:
            return filter_, 0
        residual, H = np.concatenate([r for r, _ in good]), np.vstack([H for _, H in good])
        return correct(filter_, residual, H, 1.0), len(good)

    def _passes(self, filter_: CloneFilter, residual: Array, H: Array) -> bool:
        """Chi-square gate."""
        S = H @ filter_.covariance @ H.T + np.eye(len(residual))
        bound = chdtri(len(residual), 1.0 - self.params.gate)
        return bool(residual @ np.linalg.solve(S, residual) <= bound)

    def _lately(self, stamp_us: TimeUs, now: TimeUs) -> bool:
        """Whether something was less than `lost_s` ago."""
        return now - stamp_us <= round(self.params.lost_s * US_PER_S)

    def _estimate(self, memory: EkfMemory, state: NavState, covariance: Array) -> VioEstimate:
        now = memory.intake.now_us
        passed = [passed for seen_us, passed in memory.tried if self._lately(seen_us, now)]
        held = sum(passed) >= self.params.least_passed and 2 * sum(passed) > len(passed)
        tracking = held or self._lately(memory.sure_us, now)
        status = VioStatus.TRACKING if tracking else VioStatus.LOST
        return VioEstimate(now, status, state, covariance, memory.used, memory.rejected)


def follow(
    tracks: Mapping[int, ClonedTrack], frame: TrackFrame, k: int
) -> tuple[dict[int, ClonedTrack], list[tuple[int, ClonedTrack]]]:
    """Tracks with what keyframe k sees of them, and those that ended.

    Tracks of a camera that delivered nothing go on as they are.
    """
    going: dict[int, ClonedTrack] = {}
    for track_id, camera, xy in zip(
        frame.track_id.tolist(), frame.camera.tolist(), frame.xy, strict=True
    ):
        old = going.get(track_id) or tracks.get(track_id) or ClonedTrack((), (), (), ())
        going[track_id] = ClonedTrack(
            (*old.camera, camera), (*old.k, k), (*old.xy, xy), (*old.stamp_us, frame.stamp_us)
        )
    missing = {i: t for i, t in tracks.items() if i not in going}
    unknown = {i: t for i, t in missing.items() if not set(frame.silent).isdisjoint(t.camera)}
    return going | unknown, [(i, t) for i, t in missing.items() if i not in unknown]
