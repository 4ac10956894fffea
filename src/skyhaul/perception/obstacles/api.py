# SPDX-License-Identifier: Apache-2.0
"""What trackers of moving obstacles take: directions in which cameras see something move."""

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from skyhaul.perception.api import Track
from skyhaul.types import Array, TimeUs, frozen

Memory = TypeVar("Memory")


@dataclass(frozen=True, eq=False)
class Bearings:
    """What one camera of the team sees move at one time; at most one row per obstacle."""

    stamp_us: TimeUs
    camera: int  # unique in the team
    p_WC: Array  # (3,) [m]
    dir_W: Array  # (k, 3) unit, from the camera to the middle of what moves
    sigma_rad: Array  # (k,) standard deviation of the direction, the camera's own pose included
    half_angle_rad: Array  # (k,) half the angle that it fills
    range_m: Array  # (k,) distance to its middle where a depth camera gives one, else NaN [m]
    range_sigma_m: Array  # (k,) its standard deviation, NaN where there is none [m]

    def __post_init__(self) -> None:
        frozen(self.p_WC, self.dir_W, self.sigma_rad, self.half_angle_rad)
        frozen(self.range_m, self.range_sigma_m)


def bearings(
    stamp_us: TimeUs, camera: int, p_WC: Array, dir_W: Array, sigma_rad: float,
    half_angle_rad: Array,
) -> Bearings:  # fmt: skip
    """Bearings without ranges, all equally good."""
    k = len(dir_W)
    none = np.full(k, np.nan)
    return Bearings(
        stamp_us, camera, p_WC, dir_W.reshape(k, 3), np.full(k, sigma_rad), half_angle_rad,
        none, none.copy(),
    )  # fmt: skip


class ObstacleTracker(Protocol[Memory]):
    """Bearings of the whole team -> confirmed tracks. Stateful through an explicit memory."""

    def init(self) -> Memory:
        """Memory before the first bearing."""
        ...

    def step(
        self, memory: Memory, stamp_us: TimeUs, seen: tuple[Bearings, ...]
    ) -> tuple[Memory, tuple[Track, ...]]:
        """Take in what the cameras saw at a time, not before the last."""
        ...
