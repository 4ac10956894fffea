# SPDX-License-Identifier: Apache-2.0
"""Keyframes of a rig as places: corners with ORB descriptors, and points known in the body."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from skyhaul.geometry.camera import CameraArrays
from skyhaul.perception.slam.words import Descriptors
from skyhaul.perception.vio.front_end import LEAST_DEPTH, Followed
from skyhaul.perception.vio.rays import rays_of
from skyhaul.sensors.api import GreyImage
from skyhaul.types import Array, IntArray, TimeUs, frozen

_PATCH_PX = 31.0
_EDGE_PX = 18.0
"""ORB looks this far around a corner [px]."""


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of all cameras of a rig at one time."""

    camera: IntArray  # (k,)
    xy: Array  # (k, 2) undistorted, normalised
    descriptor: Descriptors  # (k, 32)

    def __post_init__(self) -> None:
        frozen(self.camera, self.xy, self.descriptor)


NO_CORNERS = Corners(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 32), np.uint8))


@dataclass(frozen=True, eq=False)
class Place:
    """A keyframe: its pose in the odometry's frame, what it looks like, points it can be found by.

    The odometry's frame W drifts; points are kept in the axes of the body, in which they are sharp.
    """

    stamp_us: TimeUs
    R_WI: Array  # (3, 3)
    p_WI: Array  # (3,) [m]
    covariance: Array  # (6, 6) of the error (p in W axes, R in body axes)
    corners: Corners
    p_IP: Array  # (m, 3) points, body axes [m]
    descriptor: Descriptors  # (m, 32) of the points

    def __post_init__(self) -> None:
        frozen(self.R_WI, self.p_WI, self.covariance, self.p_IP, self.descriptor)


def corners_of(
    lenses: Sequence[CameraArrays], views: Sequence[Followed | None], count: int, spacing_px: int
) -> Corners:
    """The strongest corners of every camera's image, with upright descriptors.

    Args:
        lenses: Numbers of the cameras' models.
        views: What each camera follows; None: it has no image.
        count: Corners of a camera at most.
        spacing_px: Least distance of two of them [px].
    """
    camera, xy, descriptor = [], [], []
    for c, view in enumerate(views):
        if view is None:
            continue
        found = cv2.goodFeaturesToTrack(view.image, count, 0.01, spacing_px)
        uv = np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)
        uv, rows = describe(view.image, uv)
        rays = rays_of(lenses[c], uv)
        good = rays[:, 2] > LEAST_DEPTH
        camera.append(np.full(int(good.sum()), c, dtype=np.int64))
        xy.append(rays[good, :2] / rays[good, 2:])
        descriptor.append(rows[good])
    if not camera:
        return NO_CORNERS
    return Corners(np.concatenate(camera), np.concatenate(xy), np.concatenate(descriptor))


def points_of(
    views: Sequence[Followed | None], landmarks: Mapping[int, Array], R_WI: Array, p_WI: Array
) -> tuple[Array, Descriptors]:
    """Landmarks in the axes of the body, (m, 3), each as one camera sees it now, (m, 32)."""
    points, descriptors, taken = [np.zeros((0, 3))], [np.zeros((0, 32), np.uint8)], set()
    for view in views:
        if view is None:
            continue
        rows = [
            k for k, i in enumerate(view.track_id.tolist()) if i in landmarks and i not in taken
        ]
        _, described = describe(view.image, view.uv[rows])
        kept = _inside(view.image, view.uv[rows])
        ids = view.track_id[rows][kept].tolist()
        taken.update(ids)
        if ids:
            points.append((np.array([landmarks[i] for i in ids]) - p_WI) @ R_WI)
            descriptors.append(described)
    return np.concatenate(points), np.concatenate(descriptors)


def describe(image: GreyImage, uv: Array) -> tuple[Array, Descriptors]:
    """Upright ORB descriptors of the corners that are not too near to the edge, and those."""
    uv = uv[_inside(image, uv)]
    if not len(uv):
        return uv, np.zeros((0, 32), np.uint8)
    keypoints = [cv2.KeyPoint(float(u), float(v), _PATCH_PX, 0.0, 1.0, 0) for u, v in uv]
    kept, rows = cv2.ORB.create(nfeatures=len(uv), edgeThreshold=0).compute(image, keypoints)
    assert len(kept) == len(uv), "none is near the edge"
    return uv, np.asarray(rows, dtype=np.uint8)


def _inside(image: GreyImage, uv: Array) -> Array:
    h, w = image.shape
    edge = np.array([w, h]) - 1.0 - _EDGE_PX
    inside: Array = np.all((uv >= _EDGE_PX) & (uv <= edge), axis=1)
    return inside
