# SPDX-License-Identifier: Apache-2.0
"""Finds the load's tag in an image."""

from dataclasses import dataclass

import cv2
import numpy as np

from skyhaul.geometry.camera import unproject_pixels
from skyhaul.perception.team.api import TagSight
from skyhaul.sensors.api import CameraCalibration, CameraFrame, TagCalibration
from skyhaul.types import Array

_FAMILIES = {"tag25h9": cv2.aruco.DICT_APRILTAG_25h9}
_MARGIN = 0.6
"""The search window reaches this share of the tag's size past the corners seen last."""

_SMALLEST_PX = 16
"""Smallest window worth a search [px]."""
_THRESHOLD_PX = 13
"""Window over which the detector thresholds [px]."""


def tag_corners_L(tag: TagCalibration, scale: float = 1.0) -> Array:
    """Corners of a tag of `scale` times its size, L axes, in the detector's order, (4, 3) [m]."""
    h = 0.5 * scale * tag.edge_m
    flat = np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
    return np.asarray(tag.p_LT + flat @ tag.R_LT.T)


@dataclass(frozen=True, eq=False)
class TagFinder:
    """Looks for one tag; corners to a fraction of a pixel.

    The window around the tag's last place is searched first, then the whole image.
    """

    tag: TagCalibration
    wide: cv2.aruco.ArucoDetector  # for a whole image
    near: cv2.aruco.ArucoDetector  # for the window, which the tag fills

    def find(self, frame: CameraFrame, last: TagSight | None = None) -> TagSight | None:
        """The tag in an image, None when it is not seen exactly once.

        Args:
            frame: The image.
            last: Where it was in the last image of the same camera, if it was.
        """
        h, w = frame.image.shape
        corners = None
        if last is not None:
            low, high = last.corners_px.min(axis=0), last.corners_px.max(axis=0)
            pad = _MARGIN * float(np.max(high - low)) + 8.0
            x0, y0 = np.maximum(low - pad, 0.0).astype(int).tolist()
            x1, y1 = np.minimum(high + pad + 1.0, (w, h)).astype(int).tolist()
            if min(x1 - x0, y1 - y0) >= _SMALLEST_PX:
                corners = self._search(self.near, frame, (x0, y0, x1, y1))
        if corners is None:
            corners = self._search(self.wide, frame, (0, 0, w, h))
        return None if corners is None else TagSight(frame.stamp_us, frame.camera, corners)

    def _search(
        self,
        detector: cv2.aruco.ArucoDetector,
        frame: CameraFrame,
        window: tuple[int, int, int, int],
    ) -> Array | None:
        x0, y0, x1, y1 = window
        found, ids, _ = detector.detectMarkers(np.ascontiguousarray(frame.image[y0:y1, x0:x1]))
        names = [] if ids is None else ids.ravel().tolist()
        if names.count(self.tag.id) != 1:
            return None
        corners = found[names.index(self.tag.id)].reshape(4, 2).astype(np.float64)
        return np.asarray(corners + np.array([x0, y0]))


def tag_finder(tag: TagCalibration) -> TagFinder:
    """A finder for a tag."""
    return TagFinder(tag, _detector(tag.family, 0.12), _detector(tag.family, 0.4))


def _detector(family: str, least: float) -> cv2.aruco.ArucoDetector:
    """A detector of squares whose perimeter is at least so many times the larger side."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 3
    parameters.adaptiveThreshWinSizeMin = _THRESHOLD_PX
    parameters.adaptiveThreshWinSizeMax = _THRESHOLD_PX
    parameters.minMarkerPerimeterRate = least
    dictionary = cv2.aruco.getPredefinedDictionary(_FAMILIES[family])
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def tag_pose(
    sight: TagSight, camera: CameraCalibration, corners_L: Array
) -> tuple[Array, Array] | None:
    """Pose of the load in the camera's axes from one sight: p_CL (3,) [m], R_CL (3, 3).

    Args:
        sight: Corners seen.
        camera: The camera that saw them.
        corners_L: Where the corners are, from the point that is wanted, L axes, (4, 3) [m].
    """
    rays = unproject_pixels(camera.model, sight.corners_px)
    flat = rays[:, :2] / rays[:, 2:]
    centre = corners_L.mean(axis=0)
    ok, turn, place = cv2.solvePnP(
        corners_L - centre, flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    if not ok:
        return None
    R_CL = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    return place.ravel() - R_CL @ centre, R_CL
