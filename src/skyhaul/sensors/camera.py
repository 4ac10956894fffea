# SPDX-License-Identifier: Apache-2.0
"""The cameras of one vehicle: when they are due, and what they deliver."""

from collections.abc import Container
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.plant.api import PLANT_STEP_US, Truth
from skyhaul.sensors.api import CameraCalibration, CameraFrame, GreyImage
from skyhaul.sensors.imaging.frame import Frame, blank_frame
from skyhaul.sensors.imaging.lens import Lens, make_lens
from skyhaul.sensors.imaging.photometry import Sensor, expose, make_sensor
from skyhaul.sensors.imaging.raycast import render
from skyhaul.sensors.imaging.scene import Scene
from skyhaul.sensors.rig import CameraMount, RigParams
from skyhaul.sensors.streams import Source, seed_of
from skyhaul.types import US_PER_S, Array, TimeUs
from skyhaul.world.scenario import Light


class CamerasMemory(NamedTuple):
    """State of one vehicle's cameras."""

    keys: tuple[int, ...]  # of the noise of each camera
    exposure: tuple[float, ...]  # of each camera's next image, gain included


@dataclass(frozen=True, eq=False)
class Cameras:
    """All cameras of one vehicle, triggered together: every image of a tick has the same stamp.

    Vehicles take turns: vehicle i of n is late by i / n of the shortest period, so that the load
    of rendering is even. `cameras` builds it.
    """

    vehicle: int
    mounts: tuple[CameraMount, ...]
    calibrations: tuple[CameraCalibration, ...]
    light: Light
    scene: Scene  # posed anew for each image; vehicles of one process may share it
    lenses: tuple[Lens, ...]
    sensors: tuple[Sensor, ...]
    frames: tuple[Frame, ...]  # of each camera, overwritten by each image
    lag_us: TimeUs
    watched: tuple[bool, ...]  # of each camera: whether somebody looks at its images

    def init(self, seed: int) -> CamerasMemory:
        """Turn on, before the first true state."""
        keys = tuple(
            int(seed_of(seed, 1 + self.vehicle, Source.CAMERAS, c).generate_state(1, np.uint64)[0])
            >> 1
            for c in range(len(self.mounts))
        )
        return CamerasMemory(keys, tuple(m.photometry.first_exposure() for m in self.mounts))

    def due(self, c: int, t_us: TimeUs) -> bool:
        """Whether camera c takes an image at a time that somebody looks at."""
        since = t_us - self.lag_us
        return self.watched[c] and since >= 0 and since % self.mounts[c].period_us == 0

    def step(
        self, memory: CamerasMemory, truth: Truth
    ) -> tuple[CamerasMemory, tuple[CameraFrame, ...]]:
        """Images that are due at a true state."""
        t_us = truth.stamp_us
        due = [c for c in range(len(self.mounts)) if self.due(c, t_us)]
        if not due:
            return memory, ()
        self.scene.pose(truth)
        level, exposures, images = self.light.at(t_us / US_PER_S), list(memory.exposure), []
        for c in due:
            self.look(c, truth)
            image, exposures[c] = self._expose(c, memory, level, t_us)
            images.append(CameraFrame(t_us, c, image))
        return memory._replace(exposure=tuple(exposures)), tuple(images)

    def look(self, c: int, truth: Truth) -> Frame:
        """Render what camera c sees in the posed scene, without noise."""
        p_WC, R_WC = camera_pose(self.calibrations[c], truth, self.vehicle)
        frame, own = self.frames[c], self.scene.vehicle_id(self.vehicle)
        render(self.scene.arrays, self.lenses[c], p_WC, R_WC, own, frame)
        return frame

    def _expose(
        self, c: int, memory: CamerasMemory, level: float, t_us: TimeUs
    ) -> tuple[GreyImage, float]:
        """The image of a rendered frame, and the exposure of the next one."""
        mount, exposure = self.mounts[c], memory.exposure[c]
        photometry, image = mount.photometry, np.empty(self.frames[c].grey.shape, np.uint8)
        gain = photometry.gain(exposure)
        # images are numbered by their time, so that a key is used once
        number = t_us // mount.period_us
        key = (memory.keys[c] + number * 0xD1342543DE82EF95) % 2**63
        mean = expose(self.frames[c].grey, self.sensors[c], level * exposure, gain, key, image)
        return image, photometry.next_exposure(exposure, mean, mount.period_us / US_PER_S)


def cameras(
    rig: RigParams,
    scene: Scene,
    light: Light,
    vehicle: int,
    count: int,
    names: Container[str] | None = None,
) -> Cameras:
    """The cameras of one vehicle of a team.

    Args:
        rig: The cameras.
        scene: The world they see.
        light: How bright it is.
        vehicle: Which vehicle.
        count: Number of vehicles in the team.
        names: Of the cameras whose images somebody looks at; None: all.
    """
    lenses = tuple(make_lens(m.model) for m in rig.cameras)
    steps = min(m.period_us for m in rig.cameras) // PLANT_STEP_US if rig.cameras else 0
    return Cameras(
        vehicle=vehicle,
        mounts=rig.cameras,
        calibrations=rig.calibration().cameras,
        light=light,
        scene=scene,
        lenses=lenses,
        sensors=tuple(make_sensor(m.photometry, m.model) for m in rig.cameras),
        frames=tuple(blank_frame(scene.arrays, lens) for lens in lenses),
        lag_us=vehicle * steps // count * PLANT_STEP_US,
        watched=tuple(names is None or m.name in names for m in rig.cameras),
    )


def camera_pose(camera: CameraCalibration, truth: Truth, vehicle: int) -> tuple[Array, Array]:
    """Where a camera of a vehicle is: p_WC (3,) [m] and R_WC (3, 3)."""
    R_WB = quat_to_R(truth.team.q_WB[vehicle])
    return truth.team.p_WB[vehicle] + R_WB @ camera.p_BC, np.ascontiguousarray(R_WB @ camera.R_BC)
