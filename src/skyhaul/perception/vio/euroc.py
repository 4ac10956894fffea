# SPDX-License-Identifier: Apache-2.0
"""Recordings in the layout of EuRoC: mav0/imu0 and mav0/cam0 .. camN with images."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from skyhaul.errors import FileError
from skyhaul.geometry.camera import CameraModel, Equidistant, RadTan
from skyhaul.perception.vio.api import CameraRig, TrackFrame
from skyhaul.perception.vio.front_end import FrontEnd
from skyhaul.perception.vio.imu import ImuNoise, segments
from skyhaul.perception.vio.preintegration import preintegrate
from skyhaul.perception.vio.recording import Images, Recording, Views
from skyhaul.sensors.api import CameraFrame, GreyImage, ImuReading
from skyhaul.types import Array

TOGETHER_NS = 2_000_000
"""Images of several cameras within this time are one frame of the rig [ns]."""


@dataclass(frozen=True, eq=False)
class CameraFolder:
    """One camera of a recording."""

    model: CameraModel
    T_IC: Array  # (4, 4)
    time_ns: tuple[int, ...]
    files: tuple[Path, ...]


def read_euroc(folder: Path, sigma_px: float, front_end: FrontEnd) -> Recording:
    """Read IMU, calibration and lists of images; images are read while it plays.

    Args:
        folder: Holds `mav0`, or is it.
        sigma_px: Standard deviation of a track [px].
        front_end: How features are followed.

    Raises:
        FileError: When a file is missing or malformed.
    """
    mav = folder / "mav0" if (folder / "mav0").is_dir() else folder
    names = sorted(mav.glob("cam[0-9]*"), key=lambda p: (len(p.name), p.name))
    if not (mav / "imu0").is_dir() or not names:
        raise FileError(
            f"{folder}: is no EuRoC folder: mav0/imu0 and mav0/cam0 are needed; give one, or a "
            f"feature-track CSV"
        )
    imu_ns, imu = _imu(mav / "imu0" / "data.csv")
    epoch_ns = int(imu_ns[0])
    cameras = [_camera(name) for name in names]
    reading = ImuReading((imu_ns - epoch_ns) // 1000, imu[:, :3].copy(), imu[:, 3:].copy())
    rig = CameraRig(
        np.array([c.T_IC[:3, :3] for c in cameras]), np.array([c.T_IC[:3, 3] for c in cameras])
    )
    focal_px = float(np.mean([c.model.focal_px for c in cameras]))

    def views() -> Iterator[tuple[TrackFrame, Views]]:
        return _tracks(cameras, rig, reading, epoch_ns, front_end)

    def frames() -> Iterator[TrackFrame]:
        return (frame for frame, _ in views())

    images = Images(tuple(c.model.arrays() for c in cameras), views)
    return Recording(rig, reading, frames, sigma_px / focal_px, epoch_ns, images)


def _tracks(
    cameras: Sequence[CameraFolder],
    rig: CameraRig,
    imu: ImuReading,
    epoch_ns: int,
    front_end: FrontEnd,
) -> Iterator[tuple[TrackFrame, Views]]:
    tracker = front_end.build([c.model for c in cameras], rig)
    memory, last_us, zero = tracker.init(), None, np.zeros(3)
    noise = ImuNoise().densities()
    for time_ns, files in _together(cameras):
        now_us = (time_ns - epoch_ns) // 1000
        turn = np.eye(3)
        if last_us is not None:
            turn = preintegrate(segments(imu, last_us, now_us), zero, zero, noise).R_ij
        frames = [CameraFrame(now_us, c, _image(file, cameras[c])) for c, file in files]
        memory, tracks = tracker.step(memory, frames, now_us, turn)
        last_us = now_us
        yield tracks, memory.cameras


def _together(cameras: Sequence[CameraFolder]) -> Iterator[tuple[int, list[tuple[int, Path]]]]:
    """Images that were taken together: time of the first one [ns], cameras and files."""
    entries = sorted(
        (t, c, file)
        for c, camera in enumerate(cameras)
        for t, file in zip(camera.time_ns, camera.files, strict=True)
    )
    group: list[tuple[int, Path]] = []
    began = 0
    for t, c, file in entries:
        if group and t - began > TOGETHER_NS:
            yield began, group
            group = []
        if not group:
            began = t
        group.append((c, file))
    if group:
        yield began, group


def _image(file: Path, camera: CameraFolder) -> GreyImage:
    image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    size = camera.model.size_px
    if image is None or image.shape != (size[1], size[0]):
        raise FileError(
            f"{file}: is no image of {size[0]} x {size[1]} px, the resolution in sensor.yaml"
        )
    return np.asarray(image, dtype=np.uint8)


def _imu(file: Path) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], Array]:
    rows = _rows(file)
    try:
        stamps = np.array([int(row[0]) for row in rows], dtype=np.int64)
        values = np.array([[float(v) for v in row[1:7]] for row in rows])
    except ValueError as error:
        raise FileError(f"{file}: a line is no IMU sample: time [ns], w x y z, a x y z") from error
    if values.ndim != 2 or values.shape[1] != 6:
        raise FileError(f"{file}: a line is no IMU sample: time [ns], w x y z, a x y z")
    return stamps, values


def _camera(folder: Path) -> CameraFolder:
    model, T_IC = _calibration(folder / "sensor.yaml")
    rows = _rows(folder / "data.csv")
    try:
        times = tuple(int(row[0]) for row in rows)
        files = tuple(folder / "data" / row[1].strip() for row in rows)
    except (ValueError, IndexError) as error:
        raise FileError(f"{folder / 'data.csv'}: a line is no image: time [ns], file") from error
    return CameraFolder(model, T_IC, times, files)


def _calibration(file: Path) -> tuple[CameraModel, Array]:
    tree = _yaml(file)
    try:
        T_IC = np.array(tree["T_BS"]["data"], dtype=np.float64).reshape(4, 4)
        fx, fy, cx, cy = (float(v) for v in tree["intrinsics"])
        k = [float(v) for v in tree["distortion_coefficients"]]
        size = (int(tree["resolution"][0]), int(tree["resolution"][1]))
        kind = str(tree["distortion_model"])
        models = {"radial-tangential": RadTan, "radtan": RadTan, "equidistant": Equidistant}
        model = models[kind](
            size_px=size,
            focal_px=(fx, fy),
            center_px=(cx, cy),
            distortion=(k[0], k[1], k[2], k[3]),
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise FileError(
            f"{file}: needs T_BS, intrinsics, resolution, distortion_coefficients (4) and "
            f"distortion_model radial-tangential or equidistant; {error!r} is wrong or missing"
        ) from error
    return model, T_IC


def _yaml(file: Path) -> Mapping[str, Any]:
    try:
        # OpenCV's header line is no YAML that a parser knows.
        text = file.read_text("utf-8").replace("%YAML:1.0", "")
        tree = yaml.safe_load(text)
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise FileError(f"{file}: is no YAML file") from error
    if not isinstance(tree, dict):
        raise FileError(f"{file}: is no description of a sensor")
    return tree


def _rows(file: Path) -> list[list[str]]:
    """Lines of a CSV file without its comments."""
    try:
        with file.open(encoding="utf-8", newline="") as lines:
            rows = [r for r in csv.reader(lines) if r and not r[0].lstrip().startswith("#")]
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"{file}: is no text file") from error
    if not rows:
        raise FileError(f"{file}: holds no line of data")
    return rows
