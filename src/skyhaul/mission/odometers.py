# SPDX-License-Identifier: Apache-2.0
"""Odometry of all vehicles of a flight, by its kind."""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from skyhaul.errors import SensorDataError
from skyhaul.geometry.quaternion import R_to_quat, quat_exp, quat_mul, quat_rotate, quat_to_R
from skyhaul.mission.config import RunConfig
from skyhaul.mission.odometry import ModelledOdometry
from skyhaul.perception.vio.api import StartPose, VioEstimate
from skyhaul.perception.vio.vehicle import VehicleVio, rig_of
from skyhaul.perception.vio.warm_up import warm_up
from skyhaul.plant.api import Truth
from skyhaul.sensors.api import VehicleReading
from skyhaul.types import Array, TimeUs
from skyhaul.world.scenario import AirStart

SURVEY_M, SURVEY_RAD = 1e-3, 1e-3
"""How well the start of every vehicle is surveyed: standard deviations of place and heading."""
STANDS_US: TimeUs = 100_000
"""Every vehicle is known to be at rest for so long from the start on [us]."""


class Odometers(Protocol):
    """Odometry of all vehicles. Stateful: there is one of it in a flight."""

    def step(
        self, truth: Truth, readings: Sequence[VehicleReading], bias: Array
    ) -> list[VioEstimate | None]:
        """New estimates, one entry a vehicle; None where there is none now.

        Args:
            truth: True state now.
            readings: What the sensors of every vehicle gave now.
            bias: True biases of gyro and accelerometer of every vehicle, (n, 6).
        """
        ...


class ModelledOdometers:
    """True poses with the errors of a model; see `mission.odometry`."""

    def __init__(self, config: RunConfig, model: ModelledOdometry, seed: int) -> None:
        n = config.team.count
        self._model, self._imu = model, config.sensors.imu.calibration()
        self._memories = [model.init(seed, i, n) for i in range(n)]

    def step(
        self, truth: Truth, readings: Sequence[VehicleReading], bias: Array
    ) -> list[VioEstimate | None]:
        """See `Odometers.step`; readings are not looked at."""
        del readings
        out = []
        for i, memory in enumerate(self._memories):
            self._memories[i], estimate = self._model.step(memory, truth, self._imu, bias[i])
            out.append(estimate)
        return out


class EstimatedOdometers:
    """Cameras and IMU of every vehicle, from its surveyed start on; truth is not looked at.

    A vehicle whose IMU delivers nonsense has no odometry from then on.
    """

    def __init__(self, config: RunConfig, kind: VehicleVio, seed: int, start: Truth) -> None:
        calibration = config.sensors.calibration()
        self._odometry = kind.build(calibration)
        warm_up(rig_of(calibration))
        self._memories = [
            self._odometry.init(surveyed_start(config, start, i, seed))
            for i in range(config.team.count)
        ]
        self._silent = [False] * config.team.count

    def step(
        self, truth: Truth, readings: Sequence[VehicleReading], bias: Array
    ) -> list[VioEstimate | None]:
        """See `Odometers.step`."""
        del truth, bias
        return [self._one(i, reading) for i, reading in enumerate(readings)]

    def _one(self, vehicle: int, reading: VehicleReading) -> VioEstimate | None:
        if self._silent[vehicle]:
            return None
        memory = self._memories[vehicle]
        try:
            self._memories[vehicle], estimate = self._odometry.step(memory, reading)
        except SensorDataError:
            self._silent[vehicle] = True
            return None
        return estimate if estimate is not None and estimate.state is not None else None


def surveyed_start(config: RunConfig, start: Truth, vehicle: int, seed: int) -> StartPose:
    """Pose of a vehicle's IMU before the flight, with the errors of a survey.

    On the floor it stands, and gravity tells its attitude; in the air that is surveyed too.
    """
    imu, rng = config.sensors.imu.calibration(), np.random.default_rng([seed, vehicle, 77])
    q_WB = start.team.q_WB[vehicle]
    q_WI = quat_mul(q_WB, R_to_quat(imu.R_BI))
    p_WI = start.team.p_WB[vehicle] + quat_rotate(q_WB, imu.p_BI)
    p_WI = p_WI + SURVEY_M * rng.normal(size=3)
    if isinstance(config.start, AirStart):
        q_WI = quat_mul(q_WI, quat_exp(SURVEY_RAD * rng.normal(size=3)))
        return StartPose(p_WI, 0.0, SURVEY_M, SURVEY_RAD, q_WI=q_WI)
    R_WI = quat_to_R(q_WI)
    yaw = math.atan2(R_WI[1, 0], R_WI[0, 0]) + SURVEY_RAD * rng.normal()
    return StartPose(p_WI, yaw, SURVEY_M, SURVEY_RAD, STANDS_US)


def odometers(config: RunConfig, seed: int, start: Truth) -> Odometers:
    """What the configuration asks for."""
    match config.perception.odometry:
        case VehicleVio() as kind:
            return EstimatedOdometers(config, kind, seed, start)
        case ModelledOdometry() as model:
            return ModelledOdometers(config, model, seed)
