# SPDX-License-Identifier: Apache-2.0
"""Corners that are worth following: the strongest of four detectors, spread over the image."""

from typing import Literal

import cv2
import numpy as np

from skyhaul.jit import njit
from skyhaul.sensors.api import GreyImage
from skyhaul.types import Array, IntArray

Detector = Literal["gftt", "fast", "orb", "sift"]
ORB_CORNERS = 600
"""Corners that ORB ranks before they are spread."""


def find_corners(
    detector: Detector,
    image: GreyImage,
    free: GreyImage,
    count: int,
    spacing_px: float,
    threshold: float,
) -> Array:
    """The strongest corners, (k, 2) [px] with k <= count, each at a distance from the others.

    Args:
        detector: GFTT (smaller eigenvalue; Shi and Tomasi), FAST, ORB (FAST on a pyramid, ranked
            by Harris) or SIFT (extrema of differences of Gaussians).
        image: Grey image.
        free: Not zero where corners are wanted, of the same shape.
        count: How many at most.
        spacing_px: Least distance between two of them [px].
        threshold: GFTT: weakest corner as a share of the strongest; FAST, ORB: difference of grey
            values; SIFT has none.
    """
    if detector == "gftt":
        found = cv2.goodFeaturesToTrack(image, count, threshold, spacing_px, mask=free)
        return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)
    if detector == "fast":
        points = cv2.FastFeatureDetector.create(int(threshold)).detect(image, free)
    elif detector == "orb":
        orb = cv2.ORB.create(ORB_CORNERS, fastThreshold=int(threshold), edgeThreshold=16)
        points = orb.detect(image, free)
    else:
        points = cv2.SIFT.create().detect(image, free)
    ranked = sorted(points, key=lambda c: (-c.response, c.pt))
    at = np.array([c.pt for c in ranked], dtype=np.float64).reshape(-1, 2)
    kept: Array = at[_spread(at, float(spacing_px), count)]
    return kept


@njit
def _spread(at: Array, spacing: float, count: int) -> IntArray:
    """Rows of points, the first ones first, that keep their distance from those taken before."""
    taken = np.empty(count, np.int64)
    k = 0
    for i in range(at.shape[0]):
        if k == count:
            break
        good = True
        for j in range(k):
            du, dv = at[i, 0] - at[taken[j], 0], at[i, 1] - at[taken[j], 1]
            if du * du + dv * dv < spacing * spacing:
                good = False
                break
        if good:
            taken[k] = i
            k += 1
    return taken[:k]
