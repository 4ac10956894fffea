# SPDX-License-Identifier: Apache-2.0
"""The cameras of a vehicle: which, where, looking which way.

Azimuth 0 looks forward (x_B), 90 to the left; elevation 90 looks up. With roll 0 the image is
upright: its x axis is level. Default rig, fields of view from edge to edge:

    front left, front right   stereo pair, 8 cm apart, pitched up 25 deg, 84 x 63 deg
    rear                      azimuth 180, pitched down 20 deg, 84 x 63 deg
    down                      canted 19 deg from straight down towards the load, 68 x 51 deg
    event camera              forward, 5 deg up, fisheye of 150 x 111 deg

The stereo pair shares 80 % of its view at 0.5 m and 93 % from 2 m, rear and down overlap, and the
event camera sees all that the stereo pair sees. Vehicles face away from the load: it hangs behind
and below, about 26 deg from straight down, up to 45 deg to either side. The down camera sits
behind the vehicle's centre, so that its own cable never runs across the tag.
"""

import math
import re
from dataclasses import dataclass, field

import numpy as np

from skyhaul.geometry.camera import CameraModel
from skyhaul.params import Params
from skyhaul.plant.api import PLANT_STEP_US
from skyhaul.sensors.api import CameraCalibration, RigCalibration
from skyhaul.sensors.imaging.photometry import Photometry
from skyhaul.sensors.optics import LensParams
from skyhaul.types import US_PER_S, Array, TimeUs, Vec3

EUROC_DISTORTION = (-0.283, 0.074, 0.0002, 0.00002)
"""Of camera 0 of the EuRoC data set, a usual wide lens."""

FISHEYE = LensParams(
    kind="equidistant", size_px=(160, 120), fov_deg=150.0, distortion=(-0.02, 0.003, 0.0, 0.0)
)
"""Of the event camera."""


@dataclass(frozen=True, kw_only=True)
class CameraMount(Params):
    """One camera and where it sits."""

    name: str
    """Unique name in the rig: a lower-case letter, then letters, digits, spaces, underscores."""
    lens: LensParams
    """Size, field of view, distortion."""
    p_BC_m: Vec3
    """Optical centre in body axes, from the centre of mass [m]."""
    azimuth_deg: float = 0.0
    """Where the optical axis points, from x_B to the left [deg]."""
    elevation_deg: float = 0.0
    """How far it points up [deg]."""
    roll_deg: float = 0.0
    """Turn of the camera about its optical axis, clockwise as it sees the world tilt left [deg]."""
    rate_hz: float = 10.0
    """Images a second [Hz]."""
    photometry: Photometry = field(default_factory=Photometry)
    """Exposure, noise, vignetting."""

    def __post_init__(self) -> None:
        _check_name(self.name)
        period_us = US_PER_S / self.rate_hz if self.rate_hz > 0.0 else 0.0
        if not (period_us >= PLANT_STEP_US and period_us % PLANT_STEP_US == 0.0):
            raise ValueError(
                f"rate_hz must divide the {US_PER_S // PLANT_STEP_US} steps a second of the plant, "
                f"as 5, 10, 20 or 25 do, got {self.rate_hz}"
            )

    @property
    def model(self) -> CameraModel:
        """The model of its lens."""
        return self.lens.model()

    @property
    def period_us(self) -> TimeUs:
        """Time between two images [us]."""
        return round(US_PER_S / self.rate_hz)

    def calibration(self) -> CameraCalibration:
        """What an estimator may know of it."""
        R = mount_rotation(self.azimuth_deg, self.elevation_deg, self.roll_deg)
        return CameraCalibration(self.name, self.model, np.array(self.p_BC_m), R, self.rate_hz)


@dataclass(frozen=True, kw_only=True)
class EventCameraMount(Params):
    """The event camera's lens and where it sits."""

    name: str = "events"
    """Unique name in the rig: a lower-case letter, then letters, digits, spaces, underscores."""
    lens: LensParams = FISHEYE
    """Size, field of view, distortion."""
    p_BC_m: Vec3 = (0.055, 0.0, 0.025)
    """Optical centre in body axes, from the centre of mass [m]."""
    azimuth_deg: float = 0.0
    """Where the optical axis points, from x_B to the left [deg]."""
    elevation_deg: float = 5.0
    """How far it points up [deg]."""
    roll_deg: float = 0.0
    """Turn of the camera about its optical axis [deg]."""

    def __post_init__(self) -> None:
        _check_name(self.name)

    @property
    def model(self) -> CameraModel:
        """The model of its lens."""
        return self.lens.model()

    def calibration(self) -> CameraCalibration:
        """What an estimator may know of it."""
        R = mount_rotation(self.azimuth_deg, self.elevation_deg, self.roll_deg)
        return CameraCalibration(self.name, self.model, np.array(self.p_BC_m), R, 0.0)


def _default_cameras() -> tuple[CameraMount, ...]:
    wide = LensParams(size_px=(320, 240), fov_deg=84.0, distortion=EUROC_DISTORTION)
    sharp = LensParams(size_px=(320, 240), fov_deg=68.0, distortion=EUROC_DISTORTION)
    return (
        CameraMount(name="front left", lens=wide, p_BC_m=(0.05, 0.04, 0.01), elevation_deg=25.0),
        CameraMount(name="front right", lens=wide, p_BC_m=(0.05, -0.04, 0.01), elevation_deg=25.0),
        CameraMount(
            name="rear", lens=wide, p_BC_m=(-0.05, 0.0, 0.01),
            azimuth_deg=180.0, elevation_deg=-20.0,
        ),
        CameraMount(
            name="down", lens=sharp, p_BC_m=(-0.05, 0.0, -0.02),
            azimuth_deg=180.0, elevation_deg=-71.0,
        ),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class RigParams(Params):
    """All cameras of a vehicle."""

    cameras: tuple[CameraMount, ...] = field(default_factory=_default_cameras)
    """Cameras, in the order of `CameraFrame.camera`."""
    event_camera: EventCameraMount | None = field(default_factory=EventCameraMount)
    """The event camera, if there is one."""

    def __post_init__(self) -> None:
        names = [c.name for c in self.cameras]
        names += [self.event_camera.name] if self.event_camera else []
        parts = [re.sub(r"\W+", "_", name) for name in names]
        for name, part in zip(names, parts, strict=True):
            if parts.count(part) > 1:
                raise ValueError(
                    f"cameras must have names that differ in letters or digits, got {name!r} twice"
                )

    def calibration(self) -> RigCalibration:
        """What an estimator may know of the rig."""
        event = self.event_camera.calibration() if self.event_camera else None
        return RigCalibration(tuple(c.calibration() for c in self.cameras), event)


def mount_rotation(azimuth_deg: float, elevation_deg: float, roll_deg: float) -> Array:
    """R_BC of a camera, (3, 3): x right, y down, z along the optical axis.

    Args:
        azimuth_deg: Of the optical axis, from x_B to the left [deg].
        elevation_deg: Of the optical axis [deg].
        roll_deg: Turn about the optical axis, x towards y [deg].
    """
    a, e, r = (math.radians(v) for v in (azimuth_deg, elevation_deg, roll_deg))
    z = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    x = np.array([math.sin(a), -math.cos(a), 0.0])
    y = np.cross(z, x)
    c, s = math.cos(r), math.sin(r)
    return np.column_stack([c * x + s * y, c * y - s * x, z])


def _check_name(name: str) -> None:
    """Names become parts of topics, frames and files."""
    if not re.fullmatch(r"[a-z][A-Za-z0-9 _]*", name) or name == "imu":
        raise ValueError(
            "name must begin with a lower-case letter, go on with letters, digits, spaces or "
            f"underscores, and not be imu, got {name!r}"
        )
