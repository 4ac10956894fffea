# SPDX-License-Identifier: Apache-2.0
"""IMUs: specific force and angular rate at their place in a body, with a data sheet's errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skyhaul.errors import SkyhaulError
from skyhaul.geometry.so3 import euler_to_R
from skyhaul.params import Params
from skyhaul.plant.api import PLANT_STEP_US
from skyhaul.sensors.api import ImuCalibration, ImuReading
from skyhaul.sensors.imu_kernel import (
    BIAS,
    COUNT,
    NOISE_NX,
    STATE_NX,
    ImuArrays,
    ImuErrors,
    Motion,
    imu_step,
)
from skyhaul.sensors.streams import Source, stream
from skyhaul.types import US_PER_S, Array, IntArray, TimeUs, Vec3

BLOCK = 512
"""Noise is drawn for this many samples at once."""
_STEP_S = PLANT_STEP_US / US_PER_S
_ERRORS = 0
"""Part of the stream with the errors of the unit; parts 1 + b hold the noise of block b."""

NO_SAMPLES = ImuReading(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))


@dataclass(frozen=True, kw_only=True)
class Imu(Params):
    """A gyroscope and an accelerometer, each of three axes.

    Source:
        White noise, ranges and resolution: Bosch BMI088 (data sheet BST-BMI088-DS001), the IMU of
        Crazyflie 2.1 and Pixhawk 6: 0.014 deg/s/sqrt(Hz); 175 ug/sqrt(Hz), between its 160 in
        plane and 190 across; +-2000 deg/s and +-24 g in 16 bits. Offsets, scale and misalignment:
        what is left of its +-1 deg/s, +-20 mg, +-1 % after the usual calibration on the bench
        and at rest before take-off (ours). Random walks: the data sheet has none; these are of
        the size that Allan deviations of such sensors show (ours).
    """

    rate_hz: int = 500
    """Samples a second; divides the 500 steps of the plant [Hz]."""
    position_m: Vec3 = (0.01, 0.0, 0.01)
    """Place in the body, from its centre of mass [m]."""
    rotation_deg: Vec3 = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of the IMU's axes in the body [deg]."""
    gyro_noise_radps_per_sqrt_hz: float = 2.44e-4
    """White noise of the rate [rad/s/sqrt(Hz)]."""
    accel_noise_mps2_per_sqrt_hz: float = 1.72e-3
    """White noise of the specific force [m/s^2/sqrt(Hz)]."""
    gyro_walk_radps2_per_sqrt_hz: float = 2.0e-5
    """Random walk of the gyro's bias [rad/s^2/sqrt(Hz)]."""
    accel_walk_mps3_per_sqrt_hz: float = 3.0e-4
    """Random walk of the accelerometer's bias [m/s^3/sqrt(Hz)]."""
    gyro_bias_radps: float = 2.0e-3
    """Standard deviation of the gyro's bias when it is turned on [rad/s]."""
    accel_bias_mps2: float = 0.05
    """Standard deviation of the accelerometer's bias when it is turned on [m/s^2]."""
    gyro_scale_error: float = 2.0e-3
    """Standard deviation of the error of each gyro axis's scale [-]."""
    accel_scale_error: float = 2.0e-3
    """Standard deviation of the error of each accelerometer axis's scale [-]."""
    misalignment_deg: float = 0.1
    """Standard deviation of the angle of each axis towards each other one [deg]."""
    gyro_range_radps: float = 34.9
    """Largest rate that is measured [rad/s]."""
    accel_range_mps2: float = 235.0
    """Largest specific force that is measured [m/s^2]."""
    gyro_lsb_radps: float = 1.065e-3
    """Step of the rate's digits [rad/s]; 0: continuous."""
    accel_lsb_mps2: float = 7.18e-3
    """Step of the specific force's digits [m/s^2]; 0: continuous."""
    clock_offset_us: int = 0
    """The IMU's clock is ahead of true time by this; calibrated, so published [us]."""

    def __post_init__(self) -> None:
        steps = US_PER_S // PLANT_STEP_US
        if not (self.rate_hz > 0 and steps % self.rate_hz == 0):
            raise ValueError(f"rate_hz must divide {steps}, got {self.rate_hz}")
        for name in ("gyro_range_radps", "accel_range_mps2"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        for name in _NOT_NEGATIVE:
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")
        if not max(self.gyro_scale_error, self.accel_scale_error) < 0.2:
            raise ValueError("gyro_scale_error and accel_scale_error are shares, below 0.2")

    @property
    def every(self) -> int:
        """Plant steps to a sample."""
        return US_PER_S // PLANT_STEP_US // self.rate_hz

    @property
    def period_us(self) -> TimeUs:
        """Time between samples [us]."""
        return US_PER_S // self.rate_hz

    @property
    def R_BI(self) -> Array:
        """Axes of the IMU in the body, (3, 3)."""
        return euler_to_R(np.deg2rad(np.array(self.rotation_deg, dtype=np.float64)))

    def calibration(self) -> ImuCalibration:
        """What an estimator may know of it."""
        return ImuCalibration(
            rate_hz=self.rate_hz,
            p_BI=np.array(self.position_m, dtype=np.float64),
            R_BI=self.R_BI,
            gyro_noise=self.gyro_noise_radps_per_sqrt_hz,
            accel_noise=self.accel_noise_mps2_per_sqrt_hz,
            gyro_walk=self.gyro_walk_radps2_per_sqrt_hz,
            accel_walk=self.accel_walk_mps3_per_sqrt_hz,
            clock_offset_us=self.clock_offset_us,
        )

    def white(self) -> Array:
        """Standard deviation of a sample's noise, gyro and accelerometer, (6,)."""
        gyro, accel = self.gyro_noise_radps_per_sqrt_hz, self.accel_noise_mps2_per_sqrt_hz
        density = np.repeat([gyro, accel], 3)
        return np.asarray(np.sqrt(density**2 * self.rate_hz + self.walk() ** 2 / 12.0))

    def walk(self) -> Array:
        """Standard deviation of the biases' steps between samples, (6,)."""
        gyro, accel = self.gyro_walk_radps2_per_sqrt_hz, self.accel_walk_mps3_per_sqrt_hz
        return np.repeat([gyro, accel], 3) / math.sqrt(self.rate_hz)


_NOT_NEGATIVE = (
    "gyro_noise_radps_per_sqrt_hz",
    "accel_noise_mps2_per_sqrt_hz",
    "gyro_walk_radps2_per_sqrt_hz",
    "accel_walk_mps3_per_sqrt_hz",
    "gyro_bias_radps",
    "accel_bias_mps2",
    "gyro_scale_error",
    "accel_scale_error",
    "misalignment_deg",
    "gyro_lsb_radps",
    "accel_lsb_mps2",
)


def without_errors(imu: Imu) -> Imu:
    """The same IMU without noise, bias, scale, misalignment and digits; its range stays."""
    none: dict[str, Any] = dict.fromkeys(_NOT_NEGATIVE, 0.0)
    return replace(imu, **none)


@dataclass(frozen=True, eq=False)
class ImuMemory:
    """State of a bank of k IMUs."""

    t_us: TimeUs  # of the last true state; -1 before the first
    errors: ImuErrors
    state: Array  # (k, 20), see `imu_kernel`
    noise: Array  # (BLOCK, k, 12) variates of the block in use
    steps: int  # true states so far
    seed: int

    @property
    def bias(self) -> Array:
        """Biases now, gyro and accelerometer, (k, 6) [rad/s, m/s^2]."""
        return self.state[:, BIAS].copy()


@dataclass(frozen=True, eq=False)
class ImuBank:
    """Several IMUs that are stepped together; each reads as if it were alone."""

    imus: tuple[Imu, ...]
    bodies: tuple[int, ...]
    """Where each is: `streams.PAYLOAD_BODY`, or 1 + i for vehicle i."""
    arrays: ImuArrays
    lead_us: IntArray  # (k,) stamp of a sample less the time of its delivery

    def init(self, seed: int) -> ImuMemory:
        """Turn on, before the first true state."""
        state = np.zeros((len(self.imus), STATE_NX))
        state[:, 0], state[:, COUNT] = 1.0, -1.0
        gyro, accel = np.empty((2, len(self.imus), 3, 3))
        for r, (imu, body) in enumerate(zip(self.imus, self.bodies, strict=True)):
            state[r, BIAS], gyro[r], accel[r] = _draw_unit(imu, seed, body)
        return ImuMemory(-1, ImuErrors(gyro, accel), state, self._noise(seed, 0), 0, seed)

    def step(
        self, memory: ImuMemory, t_us: TimeUs, motion: Motion
    ) -> tuple[ImuMemory, tuple[ImuReading, ...]]:
        """Advance to the next true state; a reading for each IMU, empty where none is due.

        Raises:
            SkyhaulError: When it is not the state one plant step later.
        """
        if memory.t_us >= 0 and t_us != memory.t_us + PLANT_STEP_US:
            raise SkyhaulError(
                f"an IMU needs every step of the plant: after {memory.t_us} us comes "
                f"{memory.t_us + PLANT_STEP_US} us, got {t_us} us"
            )
        k, row = len(self.imus), memory.steps % BLOCK
        noise = memory.noise
        if row == 0 and memory.steps:
            noise = self._noise(memory.seed, memory.steps // BLOCK)
        state, out, ready = memory.state.copy(), np.empty((k, 6)), np.empty(k, np.bool_)
        imu_step(self.arrays, memory.errors, motion, _STEP_S, noise[row], state, out, ready)
        after = ImuMemory(t_us, memory.errors, state, noise, memory.steps + 1, memory.seed)
        return after, self._readings(t_us, out, ready.tolist())

    def _readings(self, t_us: TimeUs, out: Array, ready: list[bool]) -> tuple[ImuReading, ...]:
        """Samples are stamped in the middle of their period, by the IMU's clock."""
        stamps = (t_us + self.lead_us)[:, None]
        gyro, accel = out[:, None, :3], out[:, None, 3:]
        return tuple(
            [
                ImuReading(stamps[r], gyro[r], accel[r]) if due else NO_SAMPLES
                for r, due in enumerate(ready)
            ]
        )

    def _noise(self, seed: int, block: int) -> Array:
        rows = [
            stream(seed, body, Source.IMU, 1 + block).standard_normal((BLOCK, NOISE_NX))
            for body in self.bodies
        ]
        return np.ascontiguousarray(np.stack(rows, axis=1))


def imu_bank(imus: Sequence[Imu], bodies: Sequence[int]) -> ImuBank:
    """A bank of IMUs, one for each of the bodies."""
    six = np.repeat
    arrays = ImuArrays(
        body=np.array(bodies, dtype=np.int64),
        every=np.array([i.every for i in imus], dtype=np.int64),
        p_BI=np.array([i.position_m for i in imus], dtype=np.float64),
        R_BI=np.array([i.R_BI for i in imus]),
        white=np.array([i.white() for i in imus]),
        walk=np.array([i.walk() for i in imus]),
        span=np.array([six([i.gyro_range_radps, i.accel_range_mps2], 3) for i in imus]),
        lsb=np.array([six([i.gyro_lsb_radps, i.accel_lsb_mps2], 3) for i in imus]),
    )
    lead_us = np.array([i.clock_offset_us - i.period_us // 2 for i in imus], dtype=np.int64)
    return ImuBank(tuple(imus), tuple(bodies), arrays, lead_us)


def _draw_unit(imu: Imu, seed: int, body: int) -> tuple[Array, Array, Array]:
    """Errors of one unit: biases (6,), gyro and accelerometer matrices (3, 3)."""
    rng = stream(seed, body, Source.IMU, _ERRORS)
    bias = rng.standard_normal(6) * np.repeat([imu.gyro_bias_radps, imu.accel_bias_mps2], 3)
    tilt = math.radians(imu.misalignment_deg)
    matrices = []
    for scale in (imu.gyro_scale_error, imu.accel_scale_error):
        spread = np.where(np.eye(3, dtype=bool), scale, tilt)
        matrices.append(np.eye(3) + spread * rng.standard_normal((3, 3)))
    return bias, matrices[0], matrices[1]
