# SPDX-License-Identifier: Apache-2.0
"""What real sensors and the vehicles' own odometry deliver to the estimate of the team.

Every vehicle sends its odometry, its IMU, the thrust that its rotor speeds tell and where its down
camera saw the tag; the load sends its IMU. Nothing here is truth.
"""

from dataclasses import dataclass

from skyhaul.perception.vio.api import VioEstimate
from skyhaul.sensors.api import ImuReading
from skyhaul.types import Array, TimeUs, frozen


@dataclass(frozen=True, eq=False)
class TagSight:
    """The load's tag in one image of one camera."""

    stamp_us: TimeUs  # middle of the exposure
    camera: int  # index in the rig
    corners_px: Array  # (4, 2) pixels, in the detector's order, lens not undone

    def __post_init__(self) -> None:
        frozen(self.corners_px)


@dataclass(frozen=True, eq=False)
class VehicleReport:
    """What one vehicle sends in one tick."""

    imu: ImuReading  # samples since the tick before; may be empty
    vio: VioEstimate | None  # a new estimate of the pose of its IMU, else None
    tag: TagSight | None  # the tag in a new image, else None
    thrust: float  # that its rotors give now, from their speeds [N]
    attached: bool  # its hook is closed, from the hook's switch


@dataclass(frozen=True, eq=False)
class TeamReports:
    """Everything that arrived in one tick; None where a vehicle is silent."""

    stamp_us: TimeUs
    vehicles: tuple[VehicleReport | None, ...]
    load_imu: ImuReading  # samples of the load's IMU since the tick before; may be empty


@dataclass(frozen=True, eq=False)
class SurveyedTeam:
    """Where load and vehicles stand before the flight: the one frame W of all."""

    p_WL: Array  # (3,) [m]
    q_WL: Array  # (4,)
    p_WB: Array  # (n, 3) [m]
    q_WB: Array  # (n, 4)
    sigma_m: float = 0.01  # of the load
    sigma_rad: float = 0.02
    sigma_vehicle_m: float = 1e-3
    sigma_vehicle_rad: float = 1e-3

    def __post_init__(self) -> None:
        frozen(self.p_WL, self.q_WL, self.p_WB, self.q_WB)


@dataclass(frozen=True, eq=False)
class FrameOffset:
    """What turns a vehicle's odometry frame V into the team's frame W.

    p_WI = p_VI + p,  R_WI = Exp(turn) R_VI
    """

    p: Array  # (3,) [m]
    turn: Array  # (3,) W axes [rad]
    covariance: Array  # (6, 6) of p and turn

    def __post_init__(self) -> None:
        frozen(self.p, self.turn, self.covariance)
