# SPDX-License-Identifier: Apache-2.0
"""What the cameras of a made-up flight see of its walls: each point looks like itself alone.

A descriptor is 256 random bits of its point, of which a share differs from look to look.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from simulated_tracks import FOCAL_PX, HALF_VIEW, Simulated

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.perception.slam.places import NO_CORNERS, Corners
from skyhaul.perception.slam.words import Descriptors
from skyhaul.types import Array

MOST = 120
"""Corners of a camera."""
FLIPPED = 0.05
"""Share of the bits that differ."""


@dataclass(frozen=True, eq=False)
class SimulatedLook:
    """See `skyhaul.perception.slam.keyframes.Look`."""

    simulated: Simulated
    frame: int
    dark: bool
    landmarks: Callable[[], Mapping[int, Array]]
    shift_W: Array  # (3,) what is seen stands elsewhere by this [m]

    def corners(self) -> Corners:
        """Points in view of every camera."""
        if self.dark:
            return NO_CORNERS
        s, rng = self.simulated, np.random.default_rng([self.frame, 8])
        rig, R_WI = s.recording.rig, quat_to_R(s.truth.q[self.frame])
        seen_I = (s.p_WP + self.shift_W - s.truth.p[self.frame]) @ R_WI
        camera, xy, point = [], [], []
        for c in range(len(rig.p_IC)):
            p_C = (seen_I - rig.p_IC[c]) @ rig.R_IC[c]
            flat = p_C[:, :2] / np.maximum(p_C[:, 2:], 0.1)
            inside = (p_C[:, 2] > 0.1) & np.all(np.abs(flat) < HALF_VIEW, axis=1)
            rows = np.sort(rng.permutation(np.flatnonzero(inside))[:MOST])
            camera.append(np.full(len(rows), c))
            xy.append(flat[rows] + rng.normal(0.0, 0.7 / FOCAL_PX, (len(rows), 2)))
            point.append(rows)
        names = self._names(np.concatenate(point), rng)
        return Corners(np.concatenate(camera), np.concatenate(xy), names)

    def points(self, R_WI: Array, p_WI: Array) -> tuple[Array, Descriptors]:
        """Landmarks of the odometry, body axes, and their descriptors."""
        found = {} if self.dark else self.landmarks()
        if not found:
            return np.zeros((0, 3)), np.zeros((0, 32), np.uint8)
        point = self.simulated.point[list(found)]
        names = self._names(point, np.random.default_rng([self.frame, 9]))
        return (np.array(list(found.values())) - p_WI) @ R_WI, names

    def _names(self, point: Array, rng: np.random.Generator) -> Descriptors:
        names = np.random.default_rng(1).integers(0, 256, (len(self.simulated.p_WP), 32), np.uint8)
        bits = np.unpackbits(names[point], axis=1) ^ (rng.random((len(point), 256)) < FLIPPED)
        return np.packbits(bits, axis=1)
