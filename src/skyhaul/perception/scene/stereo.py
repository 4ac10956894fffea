# SPDX-License-Identifier: Apache-2.0
"""Depth from a pair of cameras side by side: rectification and block matching.

Depth along the optical axis is z = f b / d: f focal length, b baseline, d disparity. An error of
the disparity sigma_d gives sigma_z = z^2 / (f b) sigma_d.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from skyhaul.errors import ConfigError
from skyhaul.geometry.camera import project_points
from skyhaul.params import Params
from skyhaul.sensors.api import CameraCalibration, GreyImage, RigCalibration
from skyhaul.types import Array, Mask, frozen

DepthArray = NDArray[np.float32]

_SUBPIXELS = 16.0
"""Fractions of a pixel in which OpenCV gives disparities."""
_PARALLEL = 1e-6


@dataclass(frozen=True, kw_only=True)
class StereoParams(Params):
    """Matching along the rows of the rectified pair."""

    focal_px: float = 150.0
    """Focal length of the rectified images, which have the size of the raw ones [px]."""
    disparities: int = 48
    """Largest disparity that is looked for, a multiple of 16 [px]."""
    block_px: int = 9
    """Edge of the blocks that are compared, odd [px]."""
    uniqueness: int = 25
    """By how much the best match must beat the others [%]."""
    texture: int = 10
    """Least texture of a block (OpenCV's measure)."""
    speckle_px: int = 80
    """Smaller patches that differ from all around them are dropped [px]."""
    sigma_px: float = 0.2
    """Standard deviation of a disparity [px]."""

    def __post_init__(self) -> None:
        for name in ("focal_px", "sigma_px"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if self.disparities < 16 or self.disparities % 16:
            raise ValueError(f"disparities must be a multiple of 16, got {self.disparities}")
        if self.block_px < 5 or self.block_px % 2 == 0:
            raise ValueError(f"block_px must be odd and >= 5, got {self.block_px}")

    def build(self, rig: RigCalibration) -> "StereoPair":
        """The first two cameras of a rig that stand side by side.

        Raises:
            ConfigError: When the rig has none.
        """
        pair = pair_of(rig)
        if pair is None:
            raise ConfigError(
                "sensors.rig.cameras: depth needs a stereo pair, two cameras of equal size and "
                "direction side by side; the rig has none"
            )
        return StereoPair(self, pair, rig.cameras[pair[0]], rig.cameras[pair[1]])


def pair_of(rig: RigCalibration) -> tuple[int, int] | None:
    """Left and right camera of the first stereo pair of a rig, by index; None without one.

    Both look the same way and fire together; the right one stands on the x axis of the left one.
    """
    for i, left in enumerate(rig.cameras):
        for j, right in enumerate(rig.cameras):
            off_C = left.R_BC.T @ (right.p_BC - left.p_BC)
            if (
                i != j
                and off_C[0] > 0.0
                and np.hypot(off_C[1], off_C[2]) < _PARALLEL
                and np.allclose(left.R_BC, right.R_BC, atol=_PARALLEL)
                and left.model.size_px == right.model.size_px
                and left.rate_hz == right.rate_hz
            ):
                return i, j
    return None


@dataclass(frozen=True, eq=False)
class DepthImage:
    """Depth of the rectified left image; C axes are those of the left camera."""

    z: DepthArray  # (height, width) along the optical axis, NaN where unknown [m]
    focal_px: float
    sigma_per_z2: float
    """sigma_z / z^2 [1/m]."""

    def __post_init__(self) -> None:
        frozen(self.z)

    def points_C(self, step_px: int) -> tuple[Array, Mask]:
        """Points of every `step_px`-th pixel of every `step_px`-th row, and which are known.

        Returns:
            Points (rows, columns, 3) [m], and where there is one (rows, columns).
        """
        height, width = self.z.shape
        first = step_px // 2
        z = self.z[first::step_px, first::step_px].astype(np.float64)
        v, u = np.mgrid[first:height:step_px, first:width:step_px]
        x = (u - 0.5 * (width - 1)) / self.focal_px
        y = (v - 0.5 * (height - 1)) / self.focal_px
        return np.stack([x * z, y * z, z], axis=-1), np.isfinite(z)


class StereoPair:
    """The pair with its rectification tables; `depth` has no memory."""

    def __init__(
        self, params: StereoParams, index: tuple[int, int], left: CameraCalibration,
        right: CameraCalibration,
    ) -> None:  # fmt: skip
        self.params, self.index, self.left, self.right = params, index, left, right
        self.baseline_m = float(np.linalg.norm(right.p_BC - left.p_BC))
        tables = [_rectifying(camera, params.focal_px) for camera in (left, right)]
        self._maps = [maps for maps, _ in tables]
        self.valid = _matched(params, tables[0][1], tables[1][1])
        """Pixels that can have a depth, (height, width)."""
        matcher = cv2.StereoBM.create(params.disparities, params.block_px)
        matcher.setUniquenessRatio(params.uniqueness)
        matcher.setTextureThreshold(params.texture)
        matcher.setSpeckleWindowSize(params.speckle_px)
        matcher.setSpeckleRange(1)
        matcher.setDisp12MaxDiff(1)
        self._matcher = matcher

    def depth(self, left: GreyImage, right: GreyImage) -> DepthImage:
        """Depth of two images of one time."""
        pair = [
            cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR)
            for image, maps in zip((left, right), self._maps, strict=True)
        ]
        disparity = self._matcher.compute(*pair).astype(np.float32)
        disparity[(disparity < _SUBPIXELS) | ~self.valid] = np.nan
        p = self.params
        z = p.focal_px * self.baseline_m * _SUBPIXELS / disparity
        return DepthImage(z, p.focal_px, p.sigma_px / (p.focal_px * self.baseline_m))


def _rectifying(camera: CameraCalibration, focal_px: float) -> tuple[Any, Mask]:
    """What the raw image has where a pinhole camera of that focal looks.

    Returns:
        Tables for `cv2.remap`, and where the raw image has anything, (height, width).
    """
    width, height = camera.model.size_px
    v, u = np.mgrid[0:height, 0:width]
    x, y = (u - 0.5 * (width - 1)) / focal_px, (v - 0.5 * (height - 1)) / focal_px
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    uv, seen = project_points(camera.model, rays)
    uv[~seen] = -1e3  # beyond the lens: black
    u_raw, v_raw = uv.T.astype(np.float32).reshape(2, height, width)
    inside = (u_raw >= 0) & (u_raw <= width - 1) & (v_raw >= 0) & (v_raw <= height - 1)
    return cv2.convertMaps(u_raw, v_raw, cv2.CV_16SC2), inside


def _matched(params: StereoParams, left: Mask, right: Mask) -> Mask:
    """Where whole blocks lie in both images at every disparity that is looked for."""
    edge = np.ones((params.block_px, params.block_px), np.uint8)
    whole = [
        cv2.erode(m.astype(np.uint8), edge, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
        for m in (left, right)
    ]
    whole[0][:, : params.disparities] = False
    both: Mask = whole[0] & whole[1]
    return both
