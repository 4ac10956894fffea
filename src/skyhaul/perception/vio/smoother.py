# SPDX-License-Identifier: Apache-2.0
"""`kind: smoother`: all states and landmarks of the last seconds, solved together in GTSAM."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.vio.api import (
    NE,
    CameraRig,
    NavState,
    StartPose,
    TrackFrame,
    VioEstimate,
    VioStatus,
)
from skyhaul.perception.vio.beginning import Beginning, begin
from skyhaul.perception.vio.imu import ImuNoise, advance, segments
from skyhaul.perception.vio.intake import Intake
from skyhaul.perception.vio.keyframes import kept, keyframe_due
from skyhaul.perception.vio.pose_update import TukeyPose
from skyhaul.perception.vio.rest import Rest, brought_to_rest, rest_of
from skyhaul.perception.vio.window import (
    Setting,
    Window,
    WindowParams,
    add_keyframe,
    landmarks_of,
    open_window,
)
from skyhaul.sensors.api import ImuReading
from skyhaul.types import US_PER_S, Array, TimeUs


@dataclass(frozen=True, kw_only=True)
class SmootherVio(Params):
    """Fixed-lag smoother over keyframes: IMU, landmarks, Tukey."""

    kind: Literal["smoother"] = "smoother"
    keyframe_s: float = 0.1
    """Time between keyframes [s]."""
    lost_s: float = 1.0
    """Without landmarks for this long the status is LOST [s]."""
    slide: float = 0.0
    """Random walk of a track off its point, in standard deviations of a sight [1/sqrt(s)]; sights
    are taken for independent, with the variance that it has in the middle of the window."""
    least_landmarks: int = 4
    """Landmarks that must agree for a keyframe to count as seen."""
    window: WindowParams = field(default_factory=WindowParams)
    """The window and its landmarks."""
    pose: TukeyPose = field(default_factory=TukeyPose)
    """The pose update that sorts sights out before they enter the window."""
    beginning: Beginning = field(default_factory=Beginning)
    """How the first state is found."""
    noise: ImuNoise = field(default_factory=ImuNoise)
    """Noise of the IMU."""

    def __post_init__(self) -> None:
        for name in ("keyframe_s", "lost_s"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if self.least_landmarks < 1:
            raise ValueError(f"least_landmarks must be >= 1, got {self.least_landmarks}")

    def build(self, rig: CameraRig, sigma: float | Array) -> "SmootherEstimator":
        """The estimator of a rig.

        Args:
            rig: The cameras.
            sigma: Standard deviation of a track in the normalised image, per axis; one, or one
                for each camera.
        """
        middle_s = 0.5 * self.keyframe_s * self.window.keyframes
        white = np.sqrt(1.0 + self.slide**2 * middle_s) * np.broadcast_to(sigma, len(rig.p_IC))
        return SmootherEstimator(self, rig, white)


@dataclass(frozen=True, eq=False)
class SmootherMemory:
    """What the smoother remembers."""

    start: StartPose
    intake: Intake
    window: Window | None = None
    kept_us: Mapping[int, TimeUs] = field(default_factory=dict)  # last keyframe of each camera
    seen_us: TimeUs = 0  # last keyframe with enough landmarks


@dataclass(frozen=True, eq=False)
class SmootherEstimator:
    """Implements `VioEstimator`."""

    params: SmootherVio
    rig: CameraRig
    sigma: Array  # (c,) of a track of each camera

    def init(self, start: StartPose) -> SmootherMemory:
        """See `VioEstimator.init`."""
        return SmootherMemory(start, Intake(self.params.beginning.keep_s))

    def step(
        self, memory: SmootherMemory, imu: ImuReading, tracks: TrackFrame
    ) -> tuple[SmootherMemory, VioEstimate]:
        """See `VioEstimator.step`."""
        memory = replace(memory, intake=memory.intake.take(imu, tracks))
        if memory.window is None:
            return self._begin(memory)
        window, now = memory.window, tracks.stamp_us
        samples = segments(memory.intake.imu, window.stamp_us, now)
        noise = self.params.noise.through_gaps(memory.intake.imu, window.stamp_us, now)
        state, Phi, Q = advance(window.state, samples, noise.densities())
        covariance = Phi @ window.covariance @ Phi.T + Q
        frames, every_s = memory.intake.frames, self.params.keyframe_s
        if not keyframe_due(every_s, frames, window.stamp_us, memory.kept_us):
            return memory, self._estimate(memory, state, covariance)
        standing = self.params.beginning.standing
        rest = rest_of(standing, memory.intake, state, covariance)
        if rest is Rest.DESPITE:
            window = open_window(now, brought_to_rest(standing, state, covariance), tracks)
        else:
            setting = replace(self.setting(), noise=noise)
            window = add_keyframe(setting, window, samples, tracks, rest is Rest.YES)
        seen = window.used >= self.params.least_landmarks or rest is not Rest.NO
        memory = replace(
            memory,
            window=window,
            kept_us=kept(memory.kept_us, tracks, len(self.sigma)),
            seen_us=now if seen else memory.seen_us,
        )
        return memory, self._estimate(memory, window.state, window.covariance)

    def landmarks(self, memory: SmootherMemory) -> dict[int, Array]:
        """See `VioEstimator.landmarks`."""
        return {} if memory.window is None else landmarks_of(memory.window)

    def restart(self, memory: SmootherMemory, state: NavState, covariance: Array) -> SmootherMemory:
        """See `VioEstimator.restart`."""
        frame = memory.intake.frames[-1]
        window = open_window(frame.stamp_us, (state, covariance), frame)
        return replace(memory, window=window, seen_us=frame.stamp_us)

    def setting(self) -> Setting:
        """What the window needs to know."""
        p = self.params
        speed = p.beginning.standing.speed_sigma_mps
        return Setting(self.rig, self.sigma, p.noise, p.pose, p.window, speed)

    def _begin(self, memory: SmootherMemory) -> tuple[SmootherMemory, VioEstimate]:
        now = memory.intake.now_us
        first = begin(
            self.params.beginning,
            memory.intake,
            memory.start,
            self.rig,
            self.params.noise,
            float(self.sigma[0]),
        )
        if first is None:
            none = VioEstimate(now, VioStatus.INITIALIZING, None, np.zeros((NE, NE)), 0, 0)
            return memory, none
        memory = self.restart(memory, *first)
        return memory, self._estimate(memory, *first)

    def _estimate(self, memory: SmootherMemory, state: NavState, covariance: Array) -> VioEstimate:
        now, window = memory.intake.now_us, memory.window
        assert window is not None
        lost = now - memory.seen_us > round(self.params.lost_s * US_PER_S)
        status = VioStatus.LOST if lost else VioStatus.TRACKING
        return VioEstimate(now, status, state, covariance, window.used, window.rejected)
