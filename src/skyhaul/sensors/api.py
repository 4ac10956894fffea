# SPDX-License-Identifier: Apache-2.0
"""What the sensors deliver. Besides evaluation, sensors are the only readers of truth."""

from dataclasses import dataclass

from skyhaul.geometry.shapes import Shape
from skyhaul.model.state import CableState, TeamState
from skyhaul.types import Array, Mask, TimeUs


@dataclass(frozen=True, eq=False)
class TeamReading:
    """The team's state as a perfect sensor gives it."""

    stamp_us: TimeUs
    team: TeamState
    cables: CableState
    attached: Mask  # (n,)
    thrust: Array  # (n,) total thrust that each vehicle's rotors give now [N]


@dataclass(frozen=True, eq=False)
class ObjectReading:
    """One obstacle as a perfect sensor gives it."""

    object_id: int
    shape: Shape
    p_WO: Array  # (3,) centre [m]
    R_WO: Array  # (3, 3)
    v_WO: Array  # (3,) [m/s]
    moves: bool  # has it ever moved since it was first seen


@dataclass(frozen=True, eq=False)
class ObjectsReading:
    """What is in reach and in sight now."""

    stamp_us: TimeUs
    objects: tuple[ObjectReading, ...]
