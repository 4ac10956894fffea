# SPDX-License-Identifier: Apache-2.0
"""A lens as a scenario file tells it: by its field of view, or by a calibration."""

from dataclasses import dataclass
from typing import Literal, cast

from skyhaul.geometry.camera import CameraModel, Equidistant, RadTan
from skyhaul.params import Params

LEAST_PX, MOST_PX = 16, 4096
"""Fewest and most columns and rows of an image [px]."""


@dataclass(frozen=True, kw_only=True)
class LensParams(Params):
    """Image size, focal length and distortion of a camera."""

    kind: Literal["radtan", "equidistant"] = "radtan"
    """Pinhole with radial and tangential distortion, or fisheye; see `geometry.camera`."""
    size_px: tuple[int, int] = (320, 240)
    """Columns and rows of the image [px]."""
    fov_deg: float | None = None
    """What the middle row sees from edge to edge [deg]: square pixels, centred axis ..."""
    focal_px: tuple[float, float] | None = None
    """... or fx and fy of a calibration [px; equidistant: px per rad] ..."""
    center_px: tuple[float, float] | None = None
    """... and its principal point, cx and cy [px]; pixel centres are integers."""
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """radtan: k1, k2, p1, p2; equidistant: k1 to k4."""

    def __post_init__(self) -> None:
        calibrated = (self.focal_px is not None, self.center_px is not None)
        if calibrated not in ((False, False), (True, True)) or (
            calibrated[0] == (self.fov_deg is not None)
        ):
            raise ValueError("give either fov_deg, or focal_px and center_px")
        if not (min(self.size_px) >= LEAST_PX and max(self.size_px) <= MOST_PX):
            raise ValueError(
                f"size_px must lie between {LEAST_PX} and {MOST_PX} columns and rows, "
                f"got {self.size_px[0]} x {self.size_px[1]}"
            )
        self.model()

    def model(self) -> CameraModel:
        """The camera model."""
        cls = RadTan if self.kind == "radtan" else Equidistant
        if self.focal_px is None or self.center_px is None:
            return cls.from_fov(self.size_px, cast(float, self.fov_deg), self.distortion)
        return cls(
            size_px=self.size_px,
            focal_px=self.focal_px,
            center_px=self.center_px,
            distortion=self.distortion,
        )
