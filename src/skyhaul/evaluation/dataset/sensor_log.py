# SPDX-License-Identifier: Apache-2.0
"""Sensor topics of a data set, read from its files and written among those of the flight."""

import heapq
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skyhaul.evaluation import messages
from skyhaul.evaluation.dataset import layout
from skyhaul.evaluation.dataset.calibration import all_cameras, plain
from skyhaul.evaluation.dataset.euroc import read_frames, read_table
from skyhaul.evaluation.dataset.events_file import read_events
from skyhaul.evaluation.mcap_log import McapLog, RawRecord, read_raw
from skyhaul.geometry.quaternion import R_to_quat
from skyhaul.sensors.api import CameraCalibration, ImuCalibration, VehicleCalibration
from skyhaul.types import Array, TimeUs
from skyhaul.whole import whole

EVENTS_PERIOD_US: TimeUs = 10_000
"""Events of so long a time go into one message [us]."""

_UNKNOWN = (-1.0, *8 * (0.0,))


@dataclass(frozen=True, eq=False)
class Body:
    """Whose sensors: a vehicle, or the load."""

    name: str  # its folder, topic and frame
    known: VehicleCalibration


@dataclass(frozen=True, eq=False)
class Entry:
    """A message on its way into the log."""

    t_us: TimeUs
    topic: str
    type_name: str
    leaves: tuple[Any, ...] | None
    data: bytes | None = None  # instead of leaves: encoded already


def write_sensor_log(path: Path, flight: Path, dataset: Path, bodies: list[Body]) -> None:
    """Write a log with the flight's topics and those of the sensors, in order of time.

    Args:
        path: Where to; it is whole or not there.
        flight: Log of the flight.
        dataset: Folder with the bodies' folders.
        bodies: Whose sensors go in.
    """
    poses = [frame for body in bodies for frame in _frames(body)]
    streams = [_flight(flight)]
    with whole(path) as part, closing(McapLog(part)) as log:
        log.write("/tf_static", "tf2_msgs/TFMessage", 0, poses)
        for body in bodies:
            streams += _streams(dataset / body.name, body)
        for entry in heapq.merge(*streams, key=lambda e: e.t_us):
            if entry.data is not None:
                log.copy(RawRecord(entry.topic, entry.type_name, entry.t_us, entry.data))
            elif entry.leaves is not None:
                log.write(entry.topic, entry.type_name, entry.t_us, *entry.leaves)


def _flight(path: Path) -> Iterator[Entry]:
    for raw in read_raw(path):
        yield Entry(raw.t_us, raw.topic, raw.type_name, None, raw.data)


def _streams(folder: Path, body: Body) -> list[Iterator[Entry]]:
    """Messages of a body's sensors, each stream in order of time."""
    out = [_imu(folder, body)]
    for i, camera in enumerate(body.known.rig.cameras):
        out.append(_images(folder / "mav0" / f"cam{i}", body, camera))
    if body.known.rig.event_camera is not None:
        out.append(_events(folder, body, body.known.rig.event_camera))
    if body.known.load_cell_rate_hz is not None:
        out.append(_tensions(folder, body))
    return out


def _imu(folder: Path, body: Body) -> Iterator[Entry]:
    imu, frame = body.known.imu, f"{body.name}/imu"
    gyro = tuple((np.eye(3) * imu.gyro_noise**2 * imu.rate_hz).ravel())
    accel = tuple((np.eye(3) * imu.accel_noise**2 * imu.rate_hz).ravel())
    stamps, values = read_table(folder / "mav0" / "imu0" / layout.DATA)
    for t_ns, row in zip(stamps.tolist(), values.tolist(), strict=True):
        leaves = (
            *messages.header(t_ns // 1000, frame), 0.0, 0.0, 0.0, 1.0, _UNKNOWN,
            *row[:3], gyro, *row[3:], accel,
        )  # fmt: skip
        yield _entry(t_ns // 1000, f"/{body.name}/imu", "sensor_msgs/Imu", leaves)


def _images(folder: Path, body: Body, camera: CameraCalibration) -> Iterator[Entry]:
    frame = f"{body.name}/{plain(camera.name)}"
    for t_ns, name in read_frames(folder / layout.DATA):
        t_us = t_ns // 1000
        head = messages.header(t_us, frame)
        yield _info(t_us, frame, camera)
        data = np.frombuffer((folder / "data" / name).read_bytes(), np.uint8)
        image = (*head, "png", data)
        yield _entry(t_us, f"/{frame}/image", "sensor_msgs/CompressedImage", image)


def _info(t_us: TimeUs, frame: str, camera: CameraCalibration) -> Entry:
    """The `camera_info` that goes with an image or with events: of the same stamp."""
    info = (*messages.header(t_us, frame), *_camera_info(camera))
    return _entry(t_us, f"/{frame}/camera_info", "sensor_msgs/CameraInfo", info)


def _camera_info(camera: CameraCalibration) -> tuple[Any, ...]:
    """sensor_msgs/CameraInfo after its header."""
    model = camera.model
    (w, h), (fx, fy), (cx, cy) = model.size_px, model.focal_px, model.center_px
    name, d = "equidistant", [*model.distortion]
    if model.kind == "radtan":
        name, d = "plumb_bob", [*model.distortion, 0.0]
    k = (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    p = (fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0)
    return h, w, name, d, k, tuple(np.eye(3).ravel()), p, 0, 0, 0, 0, 0, 0, False


def _events(folder: Path, body: Body, camera: CameraCalibration) -> Iterator[Entry]:
    events = read_events(folder / layout.EVENTS_H5)
    if not len(events.t_us):
        return
    topic, frame = f"/{body.name}/events", f"{body.name}/{plain(camera.name)}"
    ends = np.arange(EVENTS_PERIOD_US, int(events.t_us[-1]) + EVENTS_PERIOD_US, EVENTS_PERIOD_US)
    cuts = np.searchsorted(events.t_us, ends, side="right").tolist()
    for low, high in zip([0, *cuts[:-1]], cuts, strict=True):
        if high > low:
            t_us, rows = int(events.t_us[high - 1]), slice(low, high)
            yield _info(t_us, frame, camera)
            leaves = (
                *messages.header(t_us, frame), *camera.model.size_px,
                events.t_us[rows], events.x[rows], events.y[rows], events.p[rows],
            )  # fmt: skip
            yield _entry(t_us, topic, "skyhaul_msgs/EventArray", leaves)


def _tensions(folder: Path, body: Body) -> Iterator[Entry]:
    stamps, values = read_table(folder / "mav0" / "load_cell0" / layout.DATA)
    for t_ns, (tension,) in zip(stamps.tolist(), values.tolist(), strict=True):
        leaves = (*messages.header(t_ns // 1000, body.name), tension)
        yield _entry(t_ns // 1000, f"/{body.name}/load_cell", "skyhaul_msgs/LoadCell", leaves)


def _entry(stamp_us: TimeUs, topic: str, type_name: str, leaves: tuple[Any, ...]) -> Entry:
    """A message; a clock that lags may stamp before the run begins, the log begins with it."""
    return Entry(max(stamp_us, 0), topic, type_name, leaves)


def _frames(body: Body) -> list[tuple[Any, ...]]:
    """Poses of a body's sensors on it, as geometry_msgs/TransformStamped."""
    cameras = all_cameras(body.known.rig)
    imu = _frame(body, "imu", body.known.imu)
    return [imu, *(_frame(body, plain(camera.name), camera) for camera in cameras)]


def _frame(body: Body, name: str, sensor: CameraCalibration | ImuCalibration) -> tuple[Any, ...]:
    p, R = _place(sensor)
    return (*messages.header(0, body.name), f"{body.name}/{name}", *messages.pose(p, R_to_quat(R)))


def _place(sensor: CameraCalibration | ImuCalibration) -> tuple[Array, Array]:
    if isinstance(sensor, ImuCalibration):
        return sensor.p_BI, sensor.R_BI
    return sensor.p_BC, sensor.R_BC
