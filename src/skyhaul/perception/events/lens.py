# SPDX-License-Identifier: Apache-2.0
"""An event camera's lens as tables: the ray of every pixel and how the image turns with it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyhaul.geometry.camera import CameraModel, pixel_rays, project_points
from skyhaul.types import Array, frozen

_SMALL = 1e-5


@dataclass(frozen=True, eq=False)
class EventLens:
    """Tables over the pixels of one camera."""

    model: CameraModel
    rays_C: Array  # (height, width, 3) unit rays
    turn_flow: NDArray[np.float32]  # (height, width, 2, 3) [px/rad]
    move_flow: NDArray[np.float32]  # (height, width, 2, 3) [px]

    def __post_init__(self) -> None:
        frozen(self.rays_C, self.turn_flow, self.move_flow)

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
    image of what stands: a ray f goes to f - phi x f, its image by turn_flow @ phi. `move_flow`
    maps the camera's velocity v (C axes) over the range rho to the velocity of that image: f
    changes by -v / rho along the sphere, its image by move_flow @ v / rho.
    """
    w, h = model.size_px
    rays = pixel_rays(model)
    turn_flow, move_flow = (np.empty((h, w, 2, 3), np.float32) for _ in range(2))
    for axis in range(3):
        small = np.zeros(3)
        small[axis] = _SMALL
        turn_flow[..., axis] = _image_shift(model, rays, -np.cross(small, rays))
        move_flow[..., axis] = _image_shift(model, rays, np.broadcast_to(-small, rays.shape))
    return EventLens(model, rays, turn_flow, move_flow)


def _image_shift(model: CameraModel, rays: Array, change: Array) -> Array:
    """How far images of rays (height, width, 3) move per `_SMALL` of change, (height, width, 2)."""
    ahead, _ = project_points(model, rays + change)
    back, _ = project_points(model, rays - change)
    shift: Array = ((ahead - back) / (2.0 * _SMALL)).reshape(*rays.shape[:2], 2)
    return shift
