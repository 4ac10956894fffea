# SPDX-License-Identifier: Apache-2.0
"""The load's upper face with its tag: one square in the middle of a bare plate."""

import cv2
import numpy as np

from skyhaul.model.team import PointPayload, RigidPayload
from skyhaul.sensors.api import TagCalibration
from skyhaul.sensors.imaging.atlas import Grey
from skyhaul.types import Array

SIZE = 256
"""Edge of the texture [texels]."""
TAG_FAMILY, TAG_NUMBER = "tag25h9", 0
"""Which tag lies on the load."""
CELLS = 9
"""Cells along the white square: the tag's border of one, its bits, one white cell around."""

_DICTIONARY = cv2.aruco.DICT_APRILTAG_25h9
_DARK, _LIGHT, _BARE = 0.04, 0.86, 0.45


def tag_on(payload: PointPayload | RigidPayload) -> TagCalibration | None:
    """The tag on a load; a point has none.

    Its white square fills the upper face of the load's box along the shorter edge.
    """
    if payload.kind == "point":
        return None
    x, y, z = payload.size_m
    edge_m = min(x, y) * (CELLS - 2) / CELLS
    return TagCalibration(TAG_FAMILY, TAG_NUMBER, edge_m, np.array([0.0, 0.0, 0.5 * z]), np.eye(3))


def plate(x_m: float, y_m: float) -> Grey:
    """The upper face: it begins in the lower left corner of a square of its longer edge.

    Args:
        x_m: Its edge to the right [m].
        y_m: Its edge upwards [m].
    """
    whole, white = max(x_m, y_m), min(x_m, y_m)
    right, down = 0.5 * (x_m - white), whole - 0.5 * (y_m + white)
    rows, columns = (_cover(first / whole, white / whole) for first in (down, right))
    texture = np.full((SIZE, SIZE), _BARE)
    texture *= 1.0 - np.outer(rows.sum(axis=1), columns.sum(axis=1))
    texture += rows @ _cells() @ columns.T
    return np.asarray(texture, dtype=np.float32)


def _cells() -> Array:
    """Grey of the cells of the white square, row 0 on top."""
    inner = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(_DICTIONARY), TAG_NUMBER, CELLS - 2
    )
    cells = np.full((CELLS, CELLS), _LIGHT)
    cells[1:-1, 1:-1] = np.where(inner > 0, _LIGHT, _DARK)
    return cells


def _cover(first: float, edge: float) -> Array:
    """Share of each texel along an axis that each cell covers, (SIZE, CELLS).

    Args:
        first: Where the cells begin, as a share of the texture.
        edge: How much of it they take.
    """
    marks = SIZE * (first + edge * np.arange(CELLS + 1) / CELLS)
    below = np.clip(marks[None] - np.arange(SIZE)[:, None], 0.0, 1.0)
    return np.diff(below, axis=1)
