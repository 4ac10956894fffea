# SPDX-License-Identifier: Apache-2.0
"""Odometry of one vehicle: from the readings of its IMU and cameras to its state."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.slam.relocation import LandmarkMap, Relocaliser, Relocation
from skyhaul.perception.vio.api import CameraRig, StartPose, VioEstimate, VioEstimator
from skyhaul.perception.vio.beginning import Beginning
from skyhaul.perception.vio.ekf import EkfVio
from skyhaul.perception.vio.front_end import FeatureTracker, FrontEnd, TrackerMemory
from skyhaul.perception.vio.imu import NO_SAMPLES, ImuNoise, join, segments, since
from skyhaul.perception.vio.preintegration import preintegrate
from skyhaul.perception.vio.screening import believable, without_false
from skyhaul.perception.vio.smoother import SmootherVio
from skyhaul.perception.vio.standing import Standing
from skyhaul.sensors.api import (
    CameraFrame,
    ImuCalibration,
    ImuReading,
    VehicleCalibration,
    VehicleReading,
)
from skyhaul.types import Array, TimeUs

PATIENCE_US = 20_000
"""Images wait this long for a sample of the IMU that is not older than they are."""
TOGETHER_US = 2_000
"""Images of several cameras this close in time are one frame of the rig."""


def _calibrated() -> Beginning:
    """Biases as a calibration on the bench leaves them, and rotors that shake little."""
    return Beginning(
        standing=Standing(
            gyro_bias_sigma_rad_s=4e-3,
            accel_bias_sigma_mps2=0.05,
            rate_sigma_rad_s=1.5e-3,
            force_sigma_mps2=0.03,
        )
    )


def _small_images() -> FrontEnd:
    """For 320 x 240 px."""
    return FrontEnd(window_px=11, levels=2, motion="gyro")


@dataclass(frozen=True, kw_only=True)
class VehicleVio(Params):
    """Front end and estimator of a vehicle; its IMU's noise comes from the calibration."""

    kind: Literal["smoother", "ekf"] = "ekf"
    """Which estimator."""
    front_end: FrontEnd = field(default_factory=_small_images)
    """How features are followed."""
    smoother: SmootherVio = field(
        default_factory=lambda: SmootherVio(keyframe_s=0.2, slide=2.0, beginning=_calibrated())
    )
    """The fixed-lag smoother, without the noise."""
    ekf: EkfVio = field(default_factory=lambda: EkfVio(slide=2.0, beginning=_calibrated()))
    """The filter, without the noise."""
    sigma_px: float = 0.2
    """Standard deviation of a track, its slide apart [px]."""
    noise_margin: float = 1.3
    """Factor on the IMU's white noise, for what else shakes."""
    accel_walk_margin: float = 1.7
    """Factor on the random walk of the accelerometer's bias, for its scale
    and axes."""

    scale_error: float = 3e-3
    """What calibration left of the IMU's errors of scale and axes, as a share of what it reads."""
    relocation: Relocation | None = field(default_factory=Relocation)
    """How it finds its place again after it was LOST; null: it does not."""

    def __post_init__(self) -> None:
        for name in ("sigma_px", "noise_margin", "accel_walk_margin"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")

    def build(self, calibration: VehicleCalibration) -> "VehicleOdometry":
        """The odometry of a vehicle with these sensors."""
        rig, models = rig_of(calibration), [c.model for c in calibration.rig.cameras]
        sigma = self.sigma_px / np.array([np.mean(m.focal_px) for m in models])
        noise = self._noise(calibration.imu)
        chosen = self.ekf if self.kind == "ekf" else self.smoother
        tracker, finder = self.front_end.build(models, rig), self.relocation
        return VehicleOdometry(
            tracker=tracker,
            estimator=replace(chosen, noise=noise).build(rig, sigma),
            clock_offset_us=calibration.imu.clock_offset_us,
            relocaliser=None if finder is None else finder.build(rig, tracker.lenses),
        )

    def _noise(self, imu: ImuCalibration) -> ImuNoise:
        return ImuNoise(
            gyro_rad_s_rthz=self.noise_margin * imu.gyro_noise,
            accel_mps2_rthz=self.noise_margin * imu.accel_noise,
            gyro_walk_rad_s2_rthz=imu.gyro_walk,
            accel_walk_mps3_rthz=self.accel_walk_margin * imu.accel_walk,
            scale_error=self.scale_error,
        )


def rig_of(calibration: VehicleCalibration) -> CameraRig:
    """The cameras in the axes of the IMU."""
    imu, cameras = calibration.imu, calibration.rig.cameras
    return CameraRig(
        np.array([imu.R_BI.T @ c.R_BC for c in cameras]),
        np.array([imu.R_BI.T @ (c.p_BC - imu.p_BI) for c in cameras]),
    )


@dataclass(frozen=True, eq=False)
class OdometryMemory:
    """What the odometry remembers."""

    tracker: TrackerMemory
    estimator: Any  # each kind has its own memory
    recent: ImuReading = NO_SAMPLES  # samples since the frame before, for its turn
    fresh: ImuReading = NO_SAMPLES  # samples that the estimator has not had yet
    waiting: tuple[CameraFrame, ...] = ()  # in order of time
    stamp_us: TimeUs = -1  # of the last frame
    gyro_bias: Array = field(default_factory=lambda: np.zeros(3))
    places: LandmarkMap = field(default_factory=LandmarkMap)


@dataclass(frozen=True, eq=False)
class VehicleOdometry:
    """Readings in, estimates out: one for each frame of the rig."""

    tracker: FeatureTracker
    estimator: VioEstimator[Any]
    clock_offset_us: TimeUs
    relocaliser: Relocaliser | None = None

    def init(self, start: StartPose) -> OdometryMemory:
        """Memory before the first reading."""
        return OdometryMemory(self.tracker.init(), self.estimator.init(start))

    def step(
        self, memory: OdometryMemory, reading: VehicleReading
    ) -> tuple[OdometryMemory, VioEstimate | None]:
        """Take a reading in; the estimate of the last frame that became complete with it.

        Images within `TOGETHER_US` are one frame; it waits until a sample of the IMU is there that
        is not older. Images that are not newer than the frame before are dropped.

        Raises:
            SensorDataError: When the IMU delivers nonsense.
        """
        imu = ImuReading(
            reading.imu.stamp_us - self.clock_offset_us, reading.imu.gyro_I, reading.imu.accel_I
        )
        waiting = sorted((*memory.waiting, *reading.frames), key=lambda f: (f.stamp_us, f.camera))
        memory = replace(
            memory,
            recent=join(memory.recent, believable(imu)),
            fresh=join(memory.fresh, imu),
            waiting=tuple(f for f in waiting if f.stamp_us > memory.stamp_us),
        )
        estimate = None
        while memory.waiting:
            images = together(memory.waiting)
            newest_us, sampled = images[-1].stamp_us, memory.recent.stamp_us
            complete = len(sampled) > 0 and sampled[-1] >= newest_us
            if not complete and reading.stamp_us < newest_us + PATIENCE_US:
                break
            memory, estimate = self._frame(memory, images)
        return memory, estimate

    def _frame(
        self, memory: OdometryMemory, images: Sequence[CameraFrame]
    ) -> tuple[OdometryMemory, VioEstimate]:
        """Follow the features into the images of a frame, and take the tracks in."""
        stamp_us = images[0].stamp_us
        turn = np.eye(3)
        if memory.stamp_us >= 0 and len(memory.recent.stamp_us):
            fine, _ = without_false(memory.recent)
            samples = segments(fine, memory.stamp_us, stamp_us)
            noise = ImuNoise().densities()
            turn = preintegrate(samples, memory.gyro_bias, np.zeros(3), noise).R_ij
        tracker, tracks = self.tracker.step(memory.tracker, images, stamp_us, turn)
        inner, estimate = self.estimator.step(memory.estimator, memory.fresh, tracks)
        places = memory.places
        if self.relocaliser is not None:
            views = tracker.delivered_since(memory.tracker)
            places, inner, estimate = self.relocaliser.follow(
                places, self.estimator, inner, estimate, views
            )
        state = estimate.state
        memory = replace(
            memory,
            tracker=tracker,
            estimator=inner,
            recent=since(memory.recent, stamp_us),
            fresh=NO_SAMPLES,
            waiting=memory.waiting[len(images) :],
            stamp_us=stamp_us,
            gyro_bias=memory.gyro_bias if state is None else state.gyro_bias,
            places=places,
        )
        return memory, estimate


def together(images: Sequence[CameraFrame]) -> Sequence[CameraFrame]:
    """The first images that make one frame of the rig: close in time, one of each camera."""
    for k, image in enumerate(images):
        again = any(image.camera == before.camera for before in images[:k])
        if again or image.stamp_us > images[0].stamp_us + TOGETHER_US:
            return images[:k]
    return images
