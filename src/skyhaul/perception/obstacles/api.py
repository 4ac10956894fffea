# SPDX-License-Identifier: Apache-2.0
"""What the estimators of moving obstacles take: events, and directions in which something moves."""

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from skyhaul.model.state import TeamState
from skyhaul.perception.api import Track
from skyhaul.sensors.api import EventReading, GreyImage, ImuReading
from skyhaul.types import Array, Mask, TimeUs, frozen

Memory = TypeVar("Memory")


@dataclass(frozen=True, eq=False)
class VehicleSight:
    """What one vehicle has to find movers with: its events, its gyro, and where it is."""

    vehicle: int
    events: EventReading  # since the step before, up to the stamp of the `TeamSight`
    imu: ImuReading  # since the step before
    pose_covariance: Array  # (6, 6) of the vehicle's position [m] and attitude [rad], W axes

    def __post_init__(self) -> None:
        frozen(self.pose_covariance)


@dataclass(frozen=True, eq=False)
class TeamSight:
    """What the vehicles' event cameras saw since the step before, and where everything is now.

    `team` is an estimate: it turns what the cameras see into directions in the world, and tells
    where in their images the team itself is.
    """

    stamp_us: TimeUs
    team: TeamState
    attached: Mask  # (n,) cables that join a vehicle and the load
    vehicles: tuple[VehicleSight, ...]  # those that were heard; one that is silent is missing

    def __post_init__(self) -> None:
        frozen(self.attached)


@dataclass(frozen=True, eq=False)
class VehicleView:
    """Images of one vehicle, all of one time: of its stereo pair, and of its other cameras."""

    vehicle: int
    stamp_us: TimeUs
    left: GreyImage
    right: GreyImage
    pose_covariance: Array  # (6, 6) of the vehicle's position [m] and attitude [rad], W axes
    others: tuple[tuple[int, GreyImage], ...] = ()  # index in the rig, image

    def __post_init__(self) -> None:
        frozen(self.pose_covariance)


@dataclass(frozen=True, eq=False)
class TeamViews:
    """What the stereo pairs saw since the step before, and where everything is now."""

    stamp_us: TimeUs
    team: TeamState
    attached: Mask  # (n,) cables that join a vehicle and the load
    vehicles: tuple[VehicleView, ...]  # those with new images

    def __post_init__(self) -> None:
        frozen(self.attached)


@dataclass(frozen=True, eq=False)
class Bearings:
    """What one camera of the team sees move at one time; at most one row per obstacle."""

    stamp_us: TimeUs
    camera: int  # unique in the team
    p_WC: Array  # (3,), or (k, 3) of each row [m]
    v_WC: Array  # (3,) [m/s]
    dir_W: Array  # (k, 3) unit, from the camera to the middle of what moves
    sigma_rad: Array  # (k,) standard deviation of the direction, the camera's own pose included
    half_angle_rad: Array  # (k,) half the angle that it fills
    range_m: Array  # (k,) distance to its middle where a depth camera gives one, else NaN [m]
    range_sigma_m: Array  # (k,) its standard deviation, NaN where there is none [m]
    age_s: Array  # (k,) how long before the stamp it was so, camera and obstacle [s]
    alike: Array  # (k,) number of successive rows of one obstacle whose errors are alike, >= 1

    def __post_init__(self) -> None:
        frozen(self.p_WC, self.v_WC, self.dir_W, self.sigma_rad, self.half_angle_rad)
        frozen(self.range_m, self.range_sigma_m, self.age_s, self.alike)


def bearings(
    stamp_us: TimeUs, camera: int, p_WC: Array, dir_W: Array, sigma_rad: float,
    half_angle_rad: Array,
) -> Bearings:  # fmt: skip
    """Bearings of now without ranges, all equally good, of a camera that stands."""
    k = len(dir_W)
    none = np.full(k, np.nan)
    return Bearings(
        stamp_us, camera, p_WC, np.zeros(3), dir_W.reshape(k, 3), np.full(k, sigma_rad),
        half_angle_rad, none, none.copy(), np.zeros(k), np.ones(k),
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
