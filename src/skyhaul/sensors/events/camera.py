# SPDX-License-Identifier: Apache-2.0
"""The event camera of one vehicle: renders when the image has moved, and fires in between.

After a rendering with largest optical flow f [px/s] the next is due before the image has moved by
`flow_px`, so `flow_px / f` later; pixels take their light to change on a line meanwhile. Where
nothing moves, few renderings give the same events as many.

Limits: there is no rendering between two steps of the plant, 2 ms: where the flow exceeds
`flow_px` a step (500 px/s at 1 px) the image moves by more than `flow_px`. Flow that begins
suddenly is noticed at the next rendering.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.params import Params
from skyhaul.plant.api import PLANT_STEP_US, Truth
from skyhaul.sensors.api import CameraCalibration, EventReading
from skyhaul.sensors.camera import camera_pose
from skyhaul.sensors.events.kernel import View
from skyhaul.sensors.events.pixels import EventPixels, PixelMemory
from skyhaul.sensors.imaging.flow import optical_flow
from skyhaul.sensors.imaging.frame import Frame, blank_frame
from skyhaul.sensors.imaging.lens import Lens, make_lens
from skyhaul.sensors.imaging.raycast import render
from skyhaul.sensors.imaging.scene import Scene
from skyhaul.sensors.rig import EventCameraMount
from skyhaul.sensors.streams import Source, stream
from skyhaul.sensors.truth_api import EventLabels
from skyhaul.types import US_PER_S, Array, TimeUs
from skyhaul.world.scenario import Light


@dataclass(frozen=True, kw_only=True)
class Pacing(Params):
    """When the scene is rendered."""

    flow_px: float = 1.0
    """How far the image may move between two renderings [px]."""
    longest_us: int = 20_000
    """Longest time between two renderings, also when nothing moves [us]."""

    def __post_init__(self) -> None:
        if not self.flow_px > 0.0:
            raise ValueError(f"flow_px must be > 0, got {self.flow_px}")
        if not self.longest_us >= PLANT_STEP_US:
            raise ValueError(f"longest_us must be >= {PLANT_STEP_US}, got {self.longest_us}")

    def due_us(self, t_us: TimeUs, flow_pxps: float) -> TimeUs:
        """Latest time for the rendering after one at t with a largest flow [px/s]."""
        wait_us = self.longest_us
        if flow_pxps * wait_us > self.flow_px * US_PER_S:
            wait_us = int(self.flow_px * US_PER_S / flow_pxps)
        return t_us + wait_us


@dataclass(frozen=True, kw_only=True)
class EventParams(Params):
    """Event camera of every vehicle."""

    pixels: EventPixels = field(default_factory=EventPixels)
    """How its pixels turn light into events."""
    pacing: Pacing = field(default_factory=Pacing)
    """When the scene is rendered for it."""


class EventCameraMemory(NamedTuple):
    """State of one vehicle's event camera. `EventCamera.step` takes it over."""

    seed: int
    pixels: PixelMemory | None  # None before the first rendering
    due_us: TimeUs  # latest time for the next rendering
    level: float  # of the light at the last rendering
    renderings: int
    flow_pxps: float  # largest at the last rendering [px/s]


@dataclass(frozen=True, eq=False)
class EventCamera:
    """An event camera at work; `event_camera` builds it."""

    vehicle: int
    params: EventParams
    calibration: CameraCalibration
    light: Light
    scene: Scene  # posed anew for each rendering; vehicles of one process may share it
    lens: Lens
    frame: Frame  # overwritten by each rendering

    def init(self, seed: int) -> EventCameraMemory:
        """Turn on, before the first true state."""
        return EventCameraMemory(seed, None, 0, 0.0, 0, 0.0)

    def step(
        self, memory: EventCameraMemory, truth: Truth, *, last: bool = False
    ) -> tuple[EventCameraMemory, EventReading | None, EventLabels | None]:
        """Events since the rendering before, if one is due at a true state.

        Labels are object ids of the scene. Call it for every step of the plant, in order; with
        `last` what has fired since the rendering before is delivered in any case.
        """
        t_us, level = truth.stamp_us, self.light.at(truth.stamp_us / US_PER_S)
        if memory.pixels is None:
            view, flow = self._look(truth, level)
            rng = stream(memory.seed, 1 + self.vehicle, Source.EVENT_CAMERA)
            pixels = self.params.pixels.init(view, self.lens.width, t_us, rng)
            return self._after(memory, pixels, level, flow), None, None
        coming = self.light.at((t_us + PLANT_STEP_US) / US_PER_S)
        steady = t_us + PLANT_STEP_US <= memory.due_us and level == memory.level == coming
        if steady and not last:
            return memory, None, None
        view, flow = self._look(truth, level)
        pixels, reading, labels = self.params.pixels.step(memory.pixels, view, t_us)
        return self._after(memory, pixels, level, flow), reading, labels

    def _after(
        self, memory: EventCameraMemory, pixels: PixelMemory, level: float, flow: float
    ) -> EventCameraMemory:
        due_us = self.params.pacing.due_us(pixels.t_us, flow)
        count = memory.renderings + 1
        return EventCameraMemory(memory.seed, pixels, due_us, level, count, flow)

    def _look(self, truth: Truth, level: float) -> tuple[View, float]:
        """Render; returns the view and its largest flow [px/s]."""
        self.scene.pose(truth)
        p_WC, R_WC = camera_pose(self.calibration, truth, self.vehicle)
        arrays, frame = self.scene.arrays, self.frame
        render(arrays, self.lens, p_WC, R_WC, self.scene.vehicle_id(self.vehicle), frame)
        motion = camera_motion(self.calibration, truth, self.vehicle)
        flow = optical_flow(arrays, self.lens, R_WC, p_WC, motion, frame)
        light = (frame.grey * np.float32(level)).ravel()
        return View(light, frame.object_id.ravel().copy(), frame.range.ravel().copy()), flow


def event_camera(
    params: EventParams, mount: EventCameraMount, scene: Scene, light: Light, vehicle: int
) -> EventCamera:
    """The event camera of one vehicle.

    Args:
        params: Its pixels and the pace of rendering.
        mount: Its lens, and where it sits.
        scene: The world it sees.
        light: How bright it is.
        vehicle: Which vehicle.
    """
    lens = make_lens(mount.model)
    frame = blank_frame(scene.arrays, lens)
    return EventCamera(vehicle, params, mount.calibration(), light, scene, lens, frame)


def camera_motion(camera: CameraCalibration, truth: Truth, vehicle: int) -> Array:
    """Velocity of a camera's centre [m/s] and its angular velocity [rad/s], W axes, (2, 3)."""
    team = truth.team
    R_WB = quat_to_R(team.q_WB[vehicle])
    w_WB = R_WB @ team.w_WB_B[vehicle]
    return np.array([team.v_WB[vehicle] + np.cross(w_WB, R_WB @ camera.p_BC), w_WB])
