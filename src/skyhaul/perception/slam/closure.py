# SPDX-License-Identifier: Apache-2.0
"""Is a place the one of before? Descriptors, then geometry: the pose of now in its body's axes."""

from dataclasses import dataclass

import cv2
import numpy as np

from skyhaul.params import Params
from skyhaul.perception.slam.places import Corners, Place
from skyhaul.perception.slam.words import Descriptors
from skyhaul.perception.vio.api import CameraRig
from skyhaul.perception.vio.pose_update import (
    PoseFix,
    Sights,
    TukeyPose,
    bearing_sigma,
    bearings,
    update_pose,
)
from skyhaul.types import Array, IntArray


@dataclass(frozen=True, kw_only=True)
class ClosureRules(Params):
    """When two places are one."""

    most_bits: int = 60
    """Bits in which descriptors of one point differ, at most."""
    ratio: float = 0.85
    """The best match must differ in this share of the bits of the next best, at most."""
    least_matches: int = 8
    """Matches in one camera from which a pose is sought."""
    ransac_px: float = 4.0
    """Error of a match that RANSAC allows [px]."""
    sigma_px: float = 1.0
    """Standard deviation of a corner against its point [px]."""
    least_inliers: int = 15
    """Matches of all cameras that must agree with the pose."""
    least_share: float = 0.4
    """The same as a share of all matches."""
    floor_m: float = 0.01
    """Least standard deviation of the pose found, per axis [m]."""
    floor_rad: float = 3e-3
    """The same of its attitude [rad]."""

    def __post_init__(self) -> None:
        for name in ("ransac_px", "sigma_px", "floor_m", "floor_rad"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not 4 <= self.least_matches <= self.least_inliers:
            raise ValueError(
                f"least_matches must be 4 to least_inliers ({self.least_inliers}), "
                f"got {self.least_matches}"
            )


@dataclass(frozen=True, eq=False)
class Closure:
    """Pose of the body now in the axes of a place of before."""

    R: Array  # (3, 3)
    p: Array  # (3,) [m]
    covariance: Array  # (6, 6) of the error (p, R), axes of the body now
    inliers: int
    matches: int


def close(
    rules: ClosureRules, rig: CameraRig, focal_px: float, old: Place, now: Corners
) -> Closure | None:
    """Find the body of now from the points of a place; None when it is not the place.

    Args:
        rules: What is asked.
        rig: The cameras.
        focal_px: Pixels of a unit of the normalised image.
        old: The place of before.
        now: Corners of all cameras now.
    """
    point, corner = match(rules, old.descriptor, now.descriptor)
    if len(point) < rules.least_inliers:
        return None
    p_P, camera, xy = old.p_IP[point], now.camera[corner], now.xy[corner]
    guess = _guess(rules, rig, focal_px, p_P, camera, xy)
    if guess is None:
        return None
    sigma = bearing_sigma(xy, rules.sigma_px / focal_px)
    fix = update_pose(TukeyPose(), rig, guess, Sights(p_P, bearings(xy), camera, sigma))
    inliers = int(np.count_nonzero(fix.inlier))
    if inliers < rules.least_inliers or inliers < rules.least_share * len(point):
        return None
    if not np.all(np.isfinite(fix.p_WI)) or fix.scale > 3.0:
        return None
    return Closure(fix.R_WI, fix.p_WI, _covariance(rules, fix), inliers, len(point))


def match(rules: ClosureRules, old: Descriptors, now: Descriptors) -> tuple[IntArray, IntArray]:
    """Rows of descriptors that are each other's best and clearly better than the next best."""
    none = np.zeros(0, dtype=np.int64)
    if len(old) < 2 or len(now) < 2:
        return none, none
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    best = {m.queryIdx: m.trainIdx for m in matcher.match(now, old)}
    rows = []
    for first, second in matcher.knnMatch(old, now, k=2):
        mutual = best.get(first.trainIdx) == first.queryIdx
        clear = first.distance < rules.ratio * second.distance
        if mutual and clear and first.distance <= rules.most_bits:
            rows.append((first.queryIdx, first.trainIdx))
    pairs = np.array(rows, dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _guess(
    rules: ClosureRules, rig: CameraRig, focal_px: float, p_P: Array, camera: IntArray, xy: Array
) -> tuple[Array, Array] | None:
    """P and R from the camera with most matches in which three points explain the others."""
    counts = np.bincount(camera, minlength=len(rig.p_IC))
    for c in np.argsort(-counts, kind="stable").tolist():
        if counts[c] < rules.least_matches:
            return None
        mine = camera == c
        found, turn, shift, inliers = cv2.solvePnPRansac(
            p_P[mine], xy[mine], np.eye(3), None, iterationsCount=200,
            reprojectionError=rules.ransac_px / focal_px, flags=cv2.SOLVEPNP_AP3P,
        )  # fmt: skip
        if not found or inliers is None or len(inliers) < rules.least_matches // 2 + 2:
            continue
        R_CP, _ = cv2.Rodrigues(turn)
        R_IP = rig.R_IC[c] @ R_CP
        p_IP = rig.R_IC[c] @ shift.ravel() + rig.p_IC[c]
        return -R_IP.T @ p_IP, np.ascontiguousarray(R_IP.T)
    return None


def _covariance(rules: ClosureRules, fix: PoseFix) -> Array:
    """Of the error (p, R) in axes of the body now, not below what corners and points allow."""
    turn = np.eye(6)
    turn[:3, :3] = fix.R_WI.T
    found = max(1.0, fix.scale) ** 2 * np.linalg.inv(fix.information)
    floor = np.repeat([rules.floor_m**2, rules.floor_rad**2], 3)
    covariance: Array = turn @ found @ turn.T + np.diag(floor)
    return covariance
