# SPDX-License-Identifier: Apache-2.0
"""What the sensors deliver. Besides evaluation, sensors are the only readers of truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyhaul.geometry.camera import CameraModel
from skyhaul.geometry.shapes import Shape
from skyhaul.model.state import CableState, TeamState
from skyhaul.types import Array, IntArray, Mask, TimeUs, frozen

GreyImage = NDArray[np.uint8]
"""A grey image, (height, width), row 0 on top."""


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


@dataclass(frozen=True, eq=False)
class ImuReading:
    """Samples of one IMU since the reading before, in order of time."""

    stamp_us: IntArray  # (k,) by the IMU's own clock
    gyro_I: Array  # (k, 3) angular rate [rad/s]
    accel_I: Array  # (k, 3) specific force [m/s^2]

    def __post_init__(self) -> None:
        frozen(self.stamp_us, self.gyro_I, self.accel_I)


@dataclass(frozen=True, eq=False)
class ImuCalibration:
    """What an estimator may know of an IMU."""

    rate_hz: int
    p_BI: Array  # (3,) place in the body, from its centre of mass [m]
    R_BI: Array  # (3, 3)
    gyro_noise: float  # white noise [rad/s/sqrt(Hz)]
    accel_noise: float  # white noise [m/s^2/sqrt(Hz)]
    gyro_walk: float  # random walk of the bias [rad/s^2/sqrt(Hz)]
    accel_walk: float  # random walk of the bias [m/s^3/sqrt(Hz)]
    clock_offset_us: TimeUs  # its clock is ahead of true time by this

    def __post_init__(self) -> None:
        frozen(self.p_BI, self.R_BI)


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One image of one camera."""

    stamp_us: TimeUs  # middle of the exposure, by the camera's own clock
    camera: int  # index in the rig
    image: GreyImage

    def __post_init__(self) -> None:
        frozen(self.image)


@dataclass(frozen=True, eq=False)
class EventReading:
    """Events of one event camera since the reading before, in order of time."""

    t_us: IntArray  # (k,)
    x: NDArray[np.int16]  # (k,) column [px]
    y: NDArray[np.int16]  # (k,) row [px]
    p: NDArray[np.int8]  # (k,) polarity, -1 or +1

    def __post_init__(self) -> None:
        frozen(self.t_us, self.x, self.y, self.p)


@dataclass(frozen=True, eq=False)
class LoadCellReading:
    """Tensions measured in one hook since the reading before."""

    stamp_us: IntArray  # (k,)
    tension: Array  # (k,) [N]

    def __post_init__(self) -> None:
        frozen(self.stamp_us, self.tension)


@dataclass(frozen=True, eq=False)
class VehicleReading:
    """Everything one vehicle's sensors delivered in one tick; empty where nothing was due."""

    stamp_us: TimeUs
    vehicle: int
    imu: ImuReading
    frames: tuple[CameraFrame, ...]
    events: EventReading | None
    load_cell: LoadCellReading | None


@dataclass(frozen=True, eq=False)
class PayloadReading:
    """Everything the payload's sensors delivered in one tick."""

    stamp_us: TimeUs
    imu: ImuReading


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """What an estimator may know of one camera. C axes: x right, y down, z forward."""

    name: str
    model: CameraModel
    p_BC: Array  # (3,) [m]
    R_BC: Array  # (3, 3)
    rate_hz: float  # images a second; 0 for an event camera

    def __post_init__(self) -> None:
        frozen(self.p_BC, self.R_BC)


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """What an estimator may know of a vehicle's cameras."""

    cameras: tuple[CameraCalibration, ...]  # in the order of `CameraFrame.camera`
    event_camera: CameraCalibration | None


@dataclass(frozen=True, eq=False)
class VehicleCalibration:
    """What an estimator may know of a body's sensors."""

    imu: ImuCalibration
    rig: RigCalibration
    load_cell_rate_hz: float | None  # None without one


@dataclass(frozen=True, eq=False)
class TagCalibration:
    """What an estimator may know of the tag on the load.

    T axes: origin in the tag's middle; as one reads the tag, x right, y up, z towards the reader.
    """

    family: str  # "tag25h9": AprilTag 25h9
    id: int
    edge_m: float  # of the black square, its border included [m]
    p_LT: Array  # (3,) [m]
    R_LT: Array  # (3, 3)

    def __post_init__(self) -> None:
        frozen(self.p_LT, self.R_LT)
