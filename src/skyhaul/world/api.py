# SPDX-License-Identifier: Apache-2.0
"""The moving world as the plant sees it."""

from typing import Protocol

from skyhaul.geometry.shapes import ShapeArrays
from skyhaul.types import Array, Mask, TimeUs


class ObstacleField(Protocol):
    """All obstacles of a scenario, with the phases of one seed."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each obstacle, in the order of every array here."""
        ...

    def shapes_at(self, t_us: TimeUs) -> ShapeArrays:
        """Shapes at a time, (m) rows; fresh arrays are not promised."""
        ...

    def velocities_at(self, t_us: TimeUs) -> Array:
        """Velocities of the centres, (m, 3) [m/s]."""
        ...

    def present(self, t_us: TimeUs, p_WL: Array) -> Mask:
        """Which obstacles are there, (m,); those that appear at a distance need the load's place.

        Pure: who calls keeps what has appeared (once there, always there).
        """
        ...
