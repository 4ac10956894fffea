# SPDX-License-Identifier: Apache-2.0
"""The smoother's window: keyframes, the tracks they see, the factors between them.

A window is never changed: each function returns a new one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

from skyhaul.geometry.quaternion import R_to_quat, quat_to_R
from skyhaul.params import Params
from skyhaul.perception.vio.api import CameraRig, NavState, TrackFrame
from skyhaul.perception.vio.factors import (
    Robust,
    camera_poses,
    imu_factor,
    imu_parameters,
    insert_state,
    marginalize,
    optimize,
    point_prior,
    sight_factor,
    sight_noise,
    speed_prior,
    state_in,
    state_prior,
)
from skyhaul.perception.vio.imu import ImuNoise, advance
from skyhaul.perception.vio.pose_update import (
    Sights,
    TukeyPose,
    bearing_sigma,
    bearings,
    update_pose,
)
from skyhaul.perception.vio.triangulation import locate
from skyhaul.types import Array, Mask, TimeUs

NO_LANDMARK = -1


@dataclass(frozen=True, kw_only=True)
class WindowParams(Params):
    """The window and its landmarks."""

    keyframes: int = 15
    """Keyframes that are solved together."""
    iterations: int = 2
    """Gauss-Newton steps at a keyframe."""
    robust: Robust = "tukey"
    """M-setting of the sights."""
    least_sights: int = 3
    """Keyframes that must have seen a track before it becomes a landmark."""
    parallax_rad: float = 0.03
    """Angle between two of its bearings that a landmark needs [rad]."""
    fit: float = 2.5
    """RMS error that a new landmark's sights may have, in standard deviations."""
    depth_m: tuple[float, float] = (0.2, 50.0)
    """Depths at which landmarks may lie [m]."""
    most: int = 60
    """Landmarks that a keyframe may see; further tracks wait until one of them is lost."""
    misses: int = 2
    """A track that disagrees this often in a row is taken for another point."""

    def __post_init__(self) -> None:
        for name in ("keyframes", "iterations", "least_sights", "most", "misses"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be >= 1, got {getattr(self, name)}")
        if not 0.0 < self.depth_m[0] < self.depth_m[1]:
            raise ValueError(f"depth_m must be two growing depths > 0, got {self.depth_m}")


@dataclass(frozen=True, eq=False)
class Setting:
    """What the window needs to know of the vehicle and of the estimator."""

    rig: CameraRig
    sigma: Array  # (c,) standard deviation of a track of each camera in the normalised image
    noise: ImuNoise
    pose: TukeyPose
    params: WindowParams
    speed_sigma_mps: float  # of a vehicle that stands


class Sight(NamedTuple):
    """A track in a camera of a keyframe."""

    k: int
    camera: int
    xy: Array  # (2,)


@dataclass(frozen=True, eq=False)
class Track:
    """A track that goes on: the last keyframe saw it, or its camera delivered nothing then."""

    sights: tuple[Sight, ...]  # in keyframes of the window
    landmark: int = NO_LANDMARK  # key of its point
    misses: int = 0


@dataclass(frozen=True, eq=False)
class Window:
    """Everything between the oldest and the newest keyframe."""

    newest: int
    oldest: int
    stamp_us: TimeUs  # of the newest
    state: NavState  # at the newest
    covariance: Array  # (15, 15)
    values: gtsam.Values
    factors: tuple[gtsam.NonlinearFactor, ...]
    tracks: Mapping[int, Track]
    landmarks: Mapping[int, int]  # key -> last keyframe that saw it
    next_landmark: int = 0
    used: int = 0
    rejected: int = 0
    rebuilt: int = 0  # how often the window turned out singular


def open_window(now: TimeUs, first: tuple[NavState, Array], tracks: TrackFrame) -> Window:
    """A window of one keyframe whose state is known with a covariance."""
    state, covariance = first
    values = gtsam.Values()
    insert_state(values, 0, state)
    return Window(
        newest=0,
        oldest=0,
        stamp_us=now,
        state=state,
        covariance=covariance,
        values=values,
        factors=(state_prior(0, state, covariance),),
        tracks={i: Track(sights) for i, sights in _sights(tracks, 0).items()},
        landmarks={},
    )


def landmarks_of(window: Window) -> dict[int, Array]:
    """Where the points of the tracks that have one are, by track, (3,) each [m]."""
    return {
        i: np.array(window.values.atPoint3(t.landmark))
        for i, t in window.tracks.items()
        if t.landmark != NO_LANDMARK
    }


def _sights(frame: TrackFrame, k: int) -> dict[int, tuple[Sight, ...]]:
    """The sights of each track in a keyframe."""
    out: dict[int, tuple[Sight, ...]] = {}
    for i, c, xy in zip(frame.track_id.tolist(), frame.camera.tolist(), frame.xy, strict=True):
        out[i] = (*out.get(i, ()), Sight(k, c, xy))
    return out


def add_keyframe(
    setting: Setting, window: Window, samples: Array, frame: TrackFrame, rests: bool
) -> Window:
    """The window with a new keyframe, solved; a singular one is built anew from the prediction."""
    predicted, Phi, Q = advance(window.state, samples, setting.noise.densities())
    covariance = Phi @ window.covariance @ Phi.T + Q
    agrees, known, seen = _agreeing(setting, window, frame, predicted, covariance)
    grown = _grow(setting, window, samples, frame, seen)
    grown = _see(setting, grown, frame, agrees, known)
    if rests:
        speed = setting.speed_sigma_mps
        grown = replace(grown, factors=(*grown.factors, speed_prior(grown.newest, speed)))
    grown = replace(grown, stamp_us=frame.stamp_us)
    try:
        return _solve(setting, _add_landmarks(setting, grown))
    except RuntimeError:
        fresh = open_window(frame.stamp_us, (predicted, covariance), frame)
        return replace(fresh, rebuilt=window.rebuilt + 1)


def _agreeing(
    setting: Setting,
    window: Window,
    frame: TrackFrame,
    predicted: NavState,
    covariance: Array,
) -> tuple[Mask, Mask, NavState]:
    """Which tracks agree with the landmarks and the predicted pose, and which have a landmark.

    Also the prediction with the pose that they agree on: from one that is far off, as after a gap
    in the IMU, the window would take them all for outliers.
    """
    tracks = [window.tracks.get(int(i)) for i in frame.track_id]
    keys = [NO_LANDMARK if t is None else t.landmark for t in tracks]
    known = np.array([key != NO_LANDMARK for key in keys], dtype=np.bool_)
    agrees = np.ones(len(keys), dtype=np.bool_)
    if not known.any():
        return agrees, known, predicted
    points = np.array([window.values.atPoint3(key) for key in keys if key != NO_LANDMARK])
    sights = Sights(
        points,
        bearings(frame.xy[known]),
        frame.camera[known],
        bearing_sigma(frame.xy[known], setting.sigma[frame.camera[known]]),
    )
    guess = (predicted.p_WI, quat_to_R(predicted.q_WI))
    prior = np.asarray(np.linalg.inv(covariance[:6, :6]), dtype=np.float64)
    fix = update_pose(setting.pose, setting.rig, guess, sights, prior)
    agrees[known] = fix.inlier
    return agrees, known, replace(predicted, p_WI=fix.p_WI, q_WI=R_to_quat(fix.R_WI))


def _grow(
    setting: Setting,
    window: Window,
    samples: Array,
    frame: TrackFrame,
    guess: NavState,
) -> Window:
    k = window.newest + 1
    values = gtsam.Values(window.values)
    insert_state(values, k, guess)
    imu = imu_factor(imu_parameters(setting.noise), k - 1, k, samples, window.state)
    return replace(window, newest=k, values=values, factors=(*window.factors, imu))


def _see(setting: Setting, window: Window, frame: TrackFrame, agrees: Mask, known: Mask) -> Window:
    """Take the sights of the new keyframe in."""
    params, k = setting.params, window.newest
    noise = [sight_noise(params.robust, sigma) for sigma in setting.sigma.tolist()]
    T_IC = camera_poses(setting.rig)
    factors, tracks, landmarks = list(window.factors), {}, dict(window.landmarks)
    every, good = _sights(frame, k), _sights(_rows(frame, agrees), k)
    points = dict(zip(frame.track_id.tolist(), known.tolist(), strict=True))
    for track_id, seen in every.items():
        track, fits = window.tracks.get(track_id), good.get(track_id, ())
        if track is None:
            tracks[track_id] = Track(seen)
        elif fits:
            tracks[track_id] = replace(track, sights=(*track.sights, *fits), misses=0)
            if points[track_id]:
                landmarks[track.landmark] = k
                factors += [
                    sight_factor(s.xy, noise[s.camera], k, track.landmark, T_IC[s.camera])
                    for s in fits
                ]
        elif track.misses + 1 < params.misses:
            tracks[track_id] = replace(track, misses=track.misses + 1)
        else:
            tracks[track_id] = Track(seen)
    for track_id, track in window.tracks.items():
        if track_id not in tracks and any(s.camera in frame.silent for s in track.sights):
            tracks[track_id] = track
    used = int(np.count_nonzero(agrees & known))
    rejected = int(np.count_nonzero(~agrees))
    return replace(
        window,
        factors=tuple(factors),
        tracks=tracks,
        landmarks=landmarks,
        used=used,
        rejected=rejected,
    )


def _rows(frame: TrackFrame, mask: Mask) -> TrackFrame:
    """Some of its tracks."""
    return replace(
        frame, track_id=frame.track_id[mask], camera=frame.camera[mask], xy=frame.xy[mask]
    )


def _add_landmarks(setting: Setting, window: Window) -> Window:
    """Tracks seen from far enough apart become landmarks, the longest first."""
    params, rig = setting.params, setting.rig
    noise = [sight_noise(params.robust, sigma) for sigma in setting.sigma.tolist()]
    T_IC = camera_poses(rig)
    values, factors = gtsam.Values(window.values), list(window.factors)
    tracks, landmarks = dict(window.tracks), dict(window.landmarks)
    states = {k: values.atPose3(X(k)) for k in range(window.oldest, window.newest + 1)}
    poses = {k: (T.rotation().matrix(), T.translation()) for k, T in states.items()}
    following = window.next_landmark
    room = params.most - sum(t.landmark != NO_LANDMARK for t in window.tracks.values())
    for track_id, track in sorted(window.tracks.items(), key=_longest_first):
        if following - window.next_landmark >= room:
            break
        p_WP = _point_of(setting, track, poses) if track.landmark == NO_LANDMARK else None
        if p_WP is None:
            continue
        key = L(following)
        following += 1
        values.insert(key, p_WP)
        factors.append(point_prior(key, p_WP))
        factors += [
            sight_factor(s.xy, noise[s.camera], s.k, key, T_IC[s.camera]) for s in track.sights
        ]
        tracks[track_id] = replace(track, landmark=key)
        landmarks[key] = window.newest
    return replace(
        window,
        values=values,
        factors=tuple(factors),
        tracks=tracks,
        landmarks=landmarks,
        next_landmark=following,
    )


def _point_of(
    setting: Setting, track: Track, poses: Mapping[int, tuple[Array, Array]]
) -> Array | None:
    """Where a track's point is, (3,) [m], or None while its sights do not hold it."""
    params, rig = setting.params, setting.rig
    if len(track.sights) < params.least_sights:
        return None
    R_WI = np.array([poses[s.k][0] for s in track.sights])
    p_WI = np.array([poses[s.k][1] for s in track.sights])
    camera = np.array([s.camera for s in track.sights])
    R_WC = R_WI @ rig.R_IC[camera]
    p_WC = p_WI + np.einsum("kij,kj->ki", R_WI, rig.p_IC[camera])
    point = locate(R_WC, p_WC, np.array([s.xy for s in track.sights]))
    held = point.parallax_rad >= params.parallax_rad
    near = params.depth_m[0] < point.depth_m < params.depth_m[1]
    fits = point.error <= params.fit * np.sqrt(2.0) * float(np.mean(setting.sigma[camera]))
    return point.p_WP if held and near and fits else None


def _longest_first(item: tuple[int, Track]) -> tuple[int, int]:
    """Sorting key of tracks."""
    return -len(item[1].sights), item[0]


def _solve(setting: Setting, window: Window) -> Window:
    """Solve, then take out what is older than the window.

    Raises:
        RuntimeError: When the window is singular.
    """
    params = setting.params
    k = window.newest
    values, covariance = optimize(window.factors, window.values, k, params.iterations)
    window = replace(window, values=values, state=state_in(values, k), covariance=covariance)
    while window.newest - window.oldest >= params.keyframes:
        window = _forget_oldest(window)
    return window


def _forget_oldest(window: Window) -> Window:
    k = window.oldest
    gone_points = [key for key, last in window.landmarks.items() if last <= k]
    gone = [X(k), V(k), B(k), *gone_points]
    factors = marginalize(window.factors, window.values, gone)
    values = gtsam.Values(window.values)
    for key in gone:
        values.erase(key)
    tracks = {
        i: replace(
            t,
            sights=tuple(s for s in t.sights if s.k > k),
            landmark=NO_LANDMARK if t.landmark in gone_points else t.landmark,
        )
        for i, t in window.tracks.items()
    }
    landmarks = {key: last for key, last in window.landmarks.items() if last > k}
    return replace(
        window, oldest=k + 1, factors=factors, values=values, tracks=tracks, landmarks=landmarks
    )
