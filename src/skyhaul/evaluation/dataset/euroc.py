# SPDX-License-Identifier: Apache-2.0
"""The sensors of one body as an EuRoC folder: `mav0/cam0 .. camN`, `imu0`, ground truth."""

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

import cv2
import numpy as np

from skyhaul.errors import FileError
from skyhaul.evaluation.dataset import calibration, layout
from skyhaul.evaluation.dataset.events_file import EventsWriter
from skyhaul.sensors.api import (
    CameraFrame,
    ImuCalibration,
    ImuReading,
    LoadCellReading,
    RigCalibration,
    VehicleCalibration,
    VehicleReading,
)
from skyhaul.sensors.truth_api import LabelName, SensorTruth
from skyhaul.types import Array, IntArray


class EurocWriter:
    """Writes one body's folder while its readings come in; stamps become nanoseconds.

    Leaving the context finishes the files.
    """

    def __init__(
        self,
        folder: Path,
        known: VehicleCalibration,
        name: str,
        labels: Sequence[LabelName] = (),
    ) -> None:
        """Make the folder and the files that do not grow.

        Args:
            folder: Where to; must not exist.
            known: The body's sensors.
            name: Of the body, for topics and comments.
            labels: What the labels of its events mean.

        Raises:
            FileError: When the disk refuses, as for all that follows.
        """
        self._open, self._mav = ExitStack(), folder / "mav0"
        try:
            with layout.writing(folder):
                self._begin(folder, known, name, labels)
        except BaseException:
            self._open.close()
            raise

    def _begin(
        self, folder: Path, known: VehicleCalibration, name: str, labels: Sequence[LabelName]
    ) -> None:
        self._mav.mkdir(parents=True)
        (self._mav / "body.yaml").write_text(calibration.body_yaml(known.imu, name), "utf-8")
        rig = known.rig
        topics = [f"/{name}/{calibration.plain(camera.name)}/image" for camera in rig.cameras]
        if rig.event_camera is not None:
            topics.append(f"/{name}/events")
        if topics:
            text = calibration.kalibr_cameras(known, topics)
            (folder / layout.KALIBR_CAMERAS).write_text(text, "utf-8")
        text = calibration.kalibr_imu(known.imu, f"/{name}/imu")
        (folder / layout.KALIBR_IMU).write_text(text, "utf-8")
        self._imu = self._sensor("imu0", calibration.imu_yaml(known.imu, name), layout.IMU_HEAD)
        self._cameras = [
            self._sensor(f"cam{i}", calibration.camera_yaml(known.imu, c), layout.CAMERA_HEAD)
            for i, c in enumerate(rig.cameras)
        ]
        for i in range(len(rig.cameras)):
            (self._mav / f"cam{i}" / "data").mkdir()
        camera = rig.event_camera
        self._events = EventsWriter(folder, camera.model.size_px, labels) if camera else None
        if self._events is not None:
            self._open.callback(self._events.close)
        self._load_cell = None
        if known.load_cell_rate_hz is not None:
            about = f"sensor_type: load-cell\nrate_hz: {known.load_cell_rate_hz}\n"
            self._load_cell = self._sensor("load_cell0", about, layout.LOAD_CELL_HEAD)

    def add(self, reading: VehicleReading, beside: SensorTruth) -> None:
        """Append a reading of a vehicle."""
        self.add_imu(reading.imu)
        events, labels = reading.events, beside.labels
        with layout.writing(self._mav):
            for frame in reading.frames:
                self._add_frame(frame)
            if self._events is not None and events is not None and labels is not None:
                self._events.add(events, labels)
            if self._load_cell is not None and reading.load_cell is not None:
                self._add_tension(self._load_cell, reading.load_cell)

    def add_imu(self, samples: ImuReading) -> None:
        """Append samples of the IMU."""
        rows = zip(
            samples.stamp_us.tolist(), samples.gyro_I.tolist(), samples.accel_I.tolist(),
            strict=True,
        )  # fmt: skip
        with layout.writing(self._mav):
            self._imu.writelines(_row(1000 * t, [*w, *f]) for t, w, f in rows)

    def add_truth(self, t_us: IntArray, states: Array, bias: Array) -> None:
        """Write the ground truth.

        Args:
            t_us: Times, (m,).
            states: p_WI, q_WI, v_WI, (m, 10).
            bias: Biases of gyro and accelerometer, (m, 6).
        """
        rows = zip(t_us.tolist(), np.column_stack([states, bias]).tolist(), strict=True)
        with layout.writing(self._mav):
            file = self._sensor(layout.TRUTH, calibration.truth_yaml(), layout.TRUTH_HEAD)
            file.writelines(_row(1000 * t, row) for t, row in rows)

    def __enter__(self) -> "EurocWriter":
        return self

    def __exit__(self, *_: object) -> None:
        """Finish all files."""
        with layout.writing(self._mav):
            self._open.close()

    def _sensor(self, name: str, about: str, head: str) -> TextIO:
        """Folder of a sensor with its description; its open table."""
        folder = self._mav / name
        folder.mkdir()
        (folder / layout.SENSOR).write_text(about, "utf-8")
        file = self._open.enter_context((folder / layout.DATA).open("w", encoding="ascii"))
        file.write(head + "\n")
        return file

    def _add_frame(self, frame: CameraFrame) -> None:
        stamp = _stamp(1000 * frame.stamp_us)
        name = f"{stamp}.png"
        path = self._mav / f"cam{frame.camera}" / "data" / name
        with path.open("xb") as file:  # never over an image that is there
            file.write(png_bytes(frame.image))
        self._cameras[frame.camera].write(f"{stamp},{name}\n")

    def _add_tension(self, file: TextIO, reading: LoadCellReading) -> None:
        rows = zip(reading.stamp_us.tolist(), reading.tension.tolist(), strict=True)
        file.writelines(_row(1000 * t, [tension]) for t, tension in rows)


def png_bytes(image: np.ndarray) -> bytes:
    """A grey image as a PNG file."""
    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert done, "a grey image can be encoded"
    return data.tobytes()


def read_table(path: Path) -> tuple[IntArray, Array]:
    """Stamps (m,) [ns] and values (m, k) of a `data.csv` of numbers.

    Raises:
        FileError: When it is missing or no such table.
    """
    try:
        lines = path.read_text("ascii").splitlines()[1:]
        cells = [line.split(",") for line in lines]
        stamps = np.array([int(row[0]) for row in cells], dtype=np.int64)
        values = np.array([[float(v) for v in row[1:]] for row in cells], dtype=np.float64)
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except (OSError, ValueError) as fault:
        raise FileError(f"{path} is no table of numbers: {fault}") from fault
    return stamps, values


def read_frames(path: Path) -> list[tuple[int, str]]:
    """Stamp [ns] and file name of each image in a camera's `data.csv`.

    Raises:
        FileError: When it is missing or no such table.
    """
    try:
        lines = path.read_text("ascii").splitlines()[1:]
        return [(int(stamp), name) for stamp, _, name in (s.partition(",") for s in lines)]
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except (OSError, ValueError) as fault:
        raise FileError(f"{path} is no table of images: {fault}") from fault


def imu_only(imu: ImuCalibration) -> VehicleCalibration:
    """A body that carries nothing but an IMU."""
    return VehicleCalibration(imu, RigCalibration((), None), None)


def _stamp(t_ns: int) -> str:
    """As long as EuRoC's own: names sort by time, and the last nine digits are nanoseconds."""
    return f"{t_ns:019d}"


def _row(t_ns: int, values: Iterable[float]) -> str:
    return f"{_stamp(t_ns)},{','.join(map(repr, values))}\n"
