# SPDX-License-Identifier: Apache-2.0
"""Messages of visual-inertial odometry and the Protocol of its estimators.

I is the frame of the IMU, C_c that of camera c (x right, y down, z forward). W has z up, its
origin and its heading are those of the start pose.

Errors of a state are e = (p - p_hat, Log(q_hat^-1 (x) q), v - v_hat, b_g - b_g_hat,
b_a - b_a_hat), (15,): right (body) tangent for the attitude, world axes for p and v. Covariances
have that layout.
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol, TypeVar

import numpy as np

from skyhaul.errors import GeometryError
from skyhaul.geometry.so3 import check_rotation
from skyhaul.sensors.api import ImuReading
from skyhaul.types import Array, IntArray, TimeUs, frozen

Memory = TypeVar("Memory")

P, R, V, BG, BA = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 15)
"""Layout of an error of a state (15,)."""
NE = 15
MOST_CAMERAS = 64


class VioStatus(StrEnum):
    """What an estimate is worth."""

    INITIALIZING = "initializing"
    """There is no state yet: gravity, velocity or scale are still unknown."""
    TRACKING = "tracking"
    """Landmarks and IMU agree."""
    LOST = "lost"
    """No landmark has been seen for a while: dead reckoning, the covariance grows."""


@dataclass(frozen=True, eq=False)
class CameraRig:
    """Where the cameras sit on the body of the IMU."""

    R_IC: Array  # (c, 3, 3)
    p_IC: Array  # (c, 3) [m]

    def __post_init__(self) -> None:
        c = len(self.p_IC)
        if c < 1 or self.p_IC.shape != (c, 3) or self.R_IC.shape != (c, 3, 3):
            raise GeometryError(
                f"a rig has R_IC (c, 3, 3) and p_IC (c, 3) with c >= 1, "
                f"got {self.R_IC.shape} and {self.p_IC.shape}"
            )
        check_rotation(self.R_IC, "R_IC")
        frozen(self.R_IC, self.p_IC)


@dataclass(frozen=True, eq=False)
class TrackFrame:
    """Feature tracks seen at one time by all cameras: points followed from frame to frame.

    The same number in the next frame, or in another camera, is the same point.
    """

    stamp_us: TimeUs
    track_id: IntArray  # (k,) each at most once in a camera
    camera: IntArray  # (k,) index in the rig
    xy: Array  # (k, 2) undistorted, normalised: x / z and y / z in camera axes
    silent: tuple[int, ...] = ()
    """Cameras that delivered no image: of their tracks nothing is known, they have not ended."""

    def __post_init__(self) -> None:
        frozen(self.track_id, self.camera, self.xy)

    @property
    def sight_id(self) -> IntArray:
        """Numbers of track and camera together, (k,): each at most once."""
        return self.track_id * MOST_CAMERAS + self.camera


@dataclass(frozen=True, eq=False)
class NavState:
    """The paper's state of one vehicle: p, q, v, b_g, b_a."""

    p_WI: Array  # (3,) [m]
    q_WI: Array  # (4,)
    v_WI: Array  # (3,) [m/s]
    gyro_bias: Array  # (3,) [rad/s]
    accel_bias: Array  # (3,) [m/s^2]

    def __post_init__(self) -> None:
        frozen(self.p_WI, self.q_WI, self.v_WI, self.gyro_bias, self.accel_bias)


@dataclass(frozen=True, eq=False)
class StartPose:
    """Where W is: the pose of the first estimate. Roll and pitch come from gravity.

    Unless the attitude was surveyed too: then the vehicle is at rest at time 0, standing or not.
    """

    p_WI: Array = field(default_factory=lambda: np.zeros(3))  # (3,) [m]
    yaw_rad: float = 0.0
    sigma_m: float = 1e-3  # how well the start is surveyed
    sigma_yaw_rad: float = 1e-3
    stands_until_us: TimeUs = 0  # the vehicle is known to stand up to then; 0: not known
    q_WI: Array | None = None  # (4,) at time 0; `yaw_rad` is not looked at then


@dataclass(frozen=True, eq=False)
class VioEstimate:
    """State of one vehicle and what it is worth."""

    stamp_us: TimeUs
    status: VioStatus
    state: NavState | None  # None while initialising
    covariance: Array  # (15, 15); zero while initialising
    used: int  # observations of landmarks that agreed with the state
    rejected: int  # observations of landmarks that did not
    relocated: bool = False  # the state has jumped: the vehicle found its place again

    def __post_init__(self) -> None:
        frozen(self.covariance)


class VioEstimator(Protocol[Memory]):
    """IMU and tracks -> state. Stateful through an explicit memory.

    Expected trouble is a status, never an exception: lost landmarks, a singular window.
    """

    def init(self, start: StartPose) -> Memory:
        """Memory before the first reading."""
        ...

    def step(
        self, memory: Memory, imu: ImuReading, tracks: TrackFrame
    ) -> tuple[Memory, VioEstimate]:
        """Take the IMU samples since the last frame and the tracks of a frame in.

        Args:
            memory: What `init` or the last `step` returned.
            imu: Samples up to the frame, in order of time; may be empty.
            tracks: Tracks of the frame, later than the last one; may hold no track.

        Raises:
            SensorDataError: When the first second of the IMU is nonsense, or when time goes back.
        """
        ...

    def landmarks(self, memory: Memory) -> dict[int, Array]:
        """Points of tracks that were seen lately and are known in depth: track -> p_WP, (3,) [m].

        With the images and places in `front_end.Followed` this is what a map of places needs.
        """
        ...

    def restart(self, memory: Memory, state: NavState, covariance: Array) -> Memory:
        """Go on from another state at the stamp of the last frame: the vehicle was relocated.

        What is held of older poses goes along or is dropped; the next status is `TRACKING`.

        Args:
            memory: What the last `step` returned, of an estimate that had a state.
            state: Where the vehicle is.
            covariance: Of its error, (15, 15).
        """
        ...
