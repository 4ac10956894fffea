# SPDX-License-Identifier: Apache-2.0
"""An event camera's lens as tables: the ray of every pixel and how the image turns with it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyhaul.geometry.camera import CameraModel, pixel_rays, project_points
from skyhaul.types import Array, frozen

_SMALL_TURN_RAD = 1e-5


@dataclass(frozen=True, eq=False)
class EventLens:
    """Tables over the pixels of one camera."""

    model: CameraModel
    rays_C: Array  # (height, width, 3) unit rays
    turn_flow: NDArray[np.float32]  # (height, width, 2, 3) [px/rad]

    def __post_init__(self) -> None:
        frozen(self.rays_C, self.turn_flow)

    @property
    def width(self) -> int:
        """Columns [px]."""
        return self.model.size_px[0]

    @property
    def height(self) -> int:
        """Rows [px]."""
        return self.model.size_px[1]


def event_lens(model: CameraModel) -> EventLens:
    """The tables of a camera model.

    `turn_flow` maps a small turn phi of the camera (rotation vector, C axes) to the shift of the
    image of what stands: a ray f goes to f - phi x f, its image by turn_flow @ phi.
    """
    w, h = model.size_px
    rays = pixel_rays(model)
    flow = np.empty((h, w, 2, 3))
    for axis in range(3):
        turn = np.zeros(3)
        turn[axis] = _SMALL_TURN_RAD
        side = np.cross(turn, rays)
        ahead, _ = project_points(model, rays - side)
        back, _ = project_points(model, rays + side)
        flow[..., axis] = ((ahead - back) / (2.0 * _SMALL_TURN_RAD)).reshape(h, w, 2)
    return EventLens(model, rays, flow.astype(np.float32))
