# SPDX-License-Identifier: Apache-2.0
"""Structure from motion of one camera, up to scale: poses of some frames and points.

Two frames far enough apart give the first points; every other frame takes its pose from points
already there, frame by frame from its neighbour, and adds points.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import gtsam
import numpy as np

from skyhaul.perception.vio.api import CameraRig, TrackFrame
from skyhaul.perception.vio.factors import adjust_bundle
from skyhaul.perception.vio.pose_update import (
    Sights,
    TukeyPose,
    bearing_sigma,
    bearings,
    update_pose,
)
from skyhaul.perception.vio.triangulation import locate
from skyhaul.types import Array, IntArray, frozen

_ONE_CAMERA = CameraRig(np.eye(3)[None], np.zeros((1, 3)))


@dataclass(frozen=True, eq=False)
class Structure:
    """Cameras and points in axes S of the first camera of the pair that began it, free scale."""

    R_SC: Array  # (n, 3, 3)
    p_SC: Array  # (n, 3)
    points: Mapping[int, Array]  # track -> (3,)

    def __post_init__(self) -> None:
        frozen(self.R_SC, self.p_SC)


Sighted = Mapping[int, Array]
"""Track -> where one frame sees it, (2,)."""


def sighted(frame: TrackFrame, camera: int) -> Sighted:
    """What one camera sees in a frame."""
    mine = frame.camera == camera
    return dict(zip(frame.track_id[mine].tolist(), frame.xy[mine], strict=True))


def build_structure(
    frames: Sequence[Sighted], sigma: float, least_tracks: int, parallax: float
) -> Structure | None:
    """Poses and points of frames in order of time, or None where they show too little.

    Args:
        frames: What each frame sees.
        sigma: Standard deviation of a track in the normalised image.
        least_tracks: Tracks that the first pair must share, and that a pose needs.
        parallax: Median motion of the tracks of the first pair, turn taken out [rad].
    """
    last = len(frames) - 1
    for first in range(last - 1):
        pair = relative_pose(frames[first], frames[last], sigma, least_tracks)
        if pair is not None:
            break
    else:
        return None
    R_ab, p_ab, good = pair
    poses = {first: (np.eye(3), np.zeros(3)), last: (R_ab, p_ab)}
    points = _points(frames, poses, good, sigma)
    if len(points) < least_tracks or _parallax(poses, points, first, last) < parallax:
        return None
    for k in [*range(first + 1, last), *range(first - 1, -1, -1)]:
        neighbour = k - 1 if k > first else k + 1
        pose = _locate_frame(frames[k], points, poses[neighbour], sigma, least_tracks)
        if pose is None:
            return None
        poses[k] = pose
        fresh = set(frames[k]) - set(points)
        points |= _points(frames, poses, fresh, sigma)
    return _refined(frames, poses, points, (first, last), sigma)


def _refined(
    frames: Sequence[Sighted],
    poses: Mapping[int, tuple[Array, Array]],
    points: Mapping[int, Array],
    fixed: tuple[int, int],
    sigma: float,
) -> Structure | None:
    """Poses and points adjusted together."""
    sights = [(k, i, seen[i]) for k, seen in enumerate(frames) for i in sorted(seen) if i in points]
    T = {k: gtsam.Pose3(gtsam.Rot3(R), p) for k, (R, p) in poses.items()}
    try:
        T, points = adjust_bundle(T, points, sights, fixed, sigma)
    except RuntimeError:
        return None
    order = range(len(frames))
    R_SC = np.array([T[k].rotation().matrix() for k in order])
    p_SC = np.array([T[k].translation() for k in order])
    return Structure(R_SC, p_SC, points)


def relative_pose(
    a: Sighted, b: Sighted, sigma: float, least_tracks: int
) -> tuple[Array, Array, set[int]] | None:
    """R_ab, p_ab (unit length) of camera b in camera a, and the tracks that agree.

    Source:    Nister's five-point method with RANSAC (OpenCV): x_b^T E x_a = 0, E = [t]x R.
    Deviation: The paper's eq. (14) has E = K^T R [t]x K (PAPER_NOTES 45).
    """
    ids = sorted(set(a) & set(b))
    if len(ids) < least_tracks:
        return None
    x_a, x_b = np.array([a[i] for i in ids]), np.array([b[i] for i in ids])
    cv2.setRNGSeed(0)
    E, mask = cv2.findEssentialMat(
        x_a, x_b, np.eye(3), method=cv2.RANSAC, prob=0.999, threshold=3.0 * sigma
    )
    if E is None or E.shape != (3, 3):
        return None
    count, R_ba, t_ba, mask = cv2.recoverPose(E, x_a, x_b, np.eye(3), mask=mask)
    if count < least_tracks:
        return None
    R_ab = np.asarray(R_ba, dtype=np.float64).T
    good = {i for i, ok in zip(ids, np.ravel(mask), strict=True) if ok}
    return R_ab, -R_ab @ np.ravel(t_ba), good


def _points(
    frames: Sequence[Sighted],
    poses: Mapping[int, tuple[Array, Array]],
    tracks: set[int],
    sigma: float,
) -> dict[int, Array]:
    """Points of tracks whose sights from the posed frames agree and differ enough."""
    out = {}
    for track in sorted(tracks):
        seen = [k for k in sorted(poses) if track in frames[k]]
        if len(seen) < 2:
            continue
        R_SC = np.array([poses[k][0] for k in seen])
        p_SC = np.array([poses[k][1] for k in seen])
        point = locate(R_SC, p_SC, np.array([frames[k][track] for k in seen]))
        if point.depth_m > 0.0 and point.parallax_rad > 0.02 and point.error < 4.0 * sigma:
            out[track] = point.p_WP
    return out


def _parallax(
    poses: Mapping[int, tuple[Array, Array]], points: Mapping[int, Array], a: int, b: int
) -> float:
    """Median angle at which the points see two cameras [rad]."""
    at = np.array(list(points.values()))
    to_a, to_b = at - poses[a][1], at - poses[b][1]
    cosine = np.sum(to_a * to_b, axis=1)
    cosine /= np.linalg.norm(to_a, axis=1) * np.linalg.norm(to_b, axis=1)
    return float(np.median(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _locate_frame(
    frame: Sighted,
    points: Mapping[int, Array],
    guess: tuple[Array, Array],
    sigma: float,
    least_tracks: int,
) -> tuple[Array, Array] | None:
    ids = [i for i in sorted(frame) if i in points]
    if len(ids) < least_tracks:
        return None
    xy = np.array([frame[i] for i in ids])
    at = np.array([points[i] for i in ids])
    camera: IntArray = np.zeros(len(ids), dtype=np.int64)
    sights = Sights(at, bearings(xy), camera, bearing_sigma(xy, sigma))
    fix = update_pose(TukeyPose(), _ONE_CAMERA, (guess[1], guess[0]), sights)
    if np.count_nonzero(fix.inlier) < least_tracks or not fix.scale < 5.0:
        return None
    return fix.R_WI, fix.p_WI
