# SPDX-License-Identifier: Apache-2.0
"""Feature tracks and IMU of one camera in a CSV file, as EqVIO writes them; see docs/vio.md."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from skyhaul.errors import FileError
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.perception.vio.api import CameraRig, TrackFrame
from skyhaul.perception.vio.recording import Recording
from skyhaul.sensors.api import ImuReading
from skyhaul.types import Array

_IMU = ("gx", "gy", "gz", "ax", "ay", "az")
_POSITION = ("T_ci_tx", "T_ci_ty", "T_ci_tz")
_TURN = ("T_ci_qw", "T_ci_qx", "T_ci_qy", "T_ci_qz")
_COLUMNS = ("row_type", "t_abs", "landmark_id", "u_norm", "v_norm", "key", "value", *_IMU)
NS_PER_S = 1_000_000_000

Row = Mapping[str, str]


def read_track_file(path: Path, sigma_px: float) -> Recording:
    """Read IMU, tracks and extrinsics of one camera.

    Args:
        path: The CSV file.
        sigma_px: Standard deviation of a track [px]; the file's focal length makes it an angle.

    Raises:
        FileError: When the file is missing, is no text, lacks a column or holds no IMU or track.
    """
    kinds = _rows_by_kind(path)
    meta = {row["key"]: row["value"] for row in kinds["meta"]}
    imu_ns = _times(path, kinds["imu"])
    epoch_ns = int(imu_ns[0])
    values = _table(path, kinds["imu"], _IMU)
    imu = ImuReading((imu_ns - epoch_ns) // 1000, values[:, :3], values[:, 3:])
    frames = _frames(path, kinds["vision_feature"], epoch_ns)
    rig, focal_px = _camera(path, meta)
    return Recording(rig, imu, lambda: iter(frames), sigma_px / focal_px, epoch_ns)


def _rows_by_kind(path: Path) -> dict[str, list[Row]]:
    kinds: dict[str, list[Row]] = {"meta": [], "imu": [], "vision_feature": []}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            missing = [c for c in _COLUMNS if c not in (reader.fieldnames or ())]
            if missing:
                raise FileError(
                    f"{path}: is no feature-track file: column {missing[0]} is missing; "
                    f"docs/vio.md describes the format"
                )
            for row in reader:
                if row["row_type"] not in kinds:
                    raise FileError(
                        f"{path}: line {reader.line_num}: row_type {row['row_type']!r} is unknown; "
                        f"allowed are {', '.join(kinds)}"
                    )
                kinds[row["row_type"]].append(row)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(
            f"{path}: is no text file; give a feature-track CSV or an EuRoC folder"
        ) from error
    for kind in ("imu", "vision_feature"):
        if not kinds[kind]:
            raise FileError(f"{path}: holds no row of kind {kind}; it needs IMU and tracks")
    return kinds


def _times(path: Path, rows: Sequence[Row]) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Times of rows [ns]: seconds with 9 digits are split before they become a double."""
    out = []
    for row in rows:
        whole, _, rest = row["t_abs"].partition(".")
        if not (whole.isdigit() and (rest.isdigit() or not rest)):
            raise FileError(f"{path}: t_abs {row['t_abs']!r} is no time in seconds")
        out.append(int(whole) * NS_PER_S + int((rest + "000000000")[:9]))
    return np.array(out, dtype=np.int64)


def _table(path: Path, rows: Sequence[Row], columns: Sequence[str]) -> Array:
    try:
        table = np.array([[float(row[c]) for c in columns] for row in rows])
    except (TypeError, ValueError) as error:
        raise FileError(f"{path}: a row lacks a number in {', '.join(columns)}") from error
    if not np.all(np.isfinite(table)):
        raise FileError(f"{path}: {', '.join(columns)} must be finite; a row is not")
    return table


def _frames(path: Path, rows: Sequence[Row], epoch_ns: int) -> tuple[TrackFrame, ...]:
    stamps = (_times(path, rows) - epoch_ns) // 1000
    ids = _table(path, rows, ("landmark_id",))[:, 0].astype(np.int64)
    xy = _table(path, rows, ("u_norm", "v_norm"))
    order = np.argsort(stamps, kind="stable")
    cuts = np.flatnonzero(np.diff(stamps[order])) + 1
    return tuple(
        TrackFrame(int(stamps[i[0]]), ids[i], np.zeros(len(i), dtype=np.int64), xy[i])
        for i in np.split(order, cuts)
    )


def _camera(path: Path, meta: Mapping[str, str]) -> tuple[CameraRig, float]:
    """Rig of one camera and its focal length [px]."""
    wanted = (*_POSITION, *_TURN, "camera_fx")
    try:
        numbers = [float(meta[name]) for name in wanted]
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(
            f"{path}: needs meta rows {', '.join(wanted)} with numbers (camera in IMU axes)"
        ) from error
    q_IC, focal_px = np.array(numbers[3:7]), numbers[7]
    length = float(np.linalg.norm(q_IC))
    if not abs(length - 1.0) < 1e-3 or not 0.0 < focal_px < math.inf:
        raise FileError(
            f"{path}: {', '.join(_TURN)} must be a unit quaternion and camera_fx > 0, "
            f"got length {length:.3g} and {focal_px:.3g} px"
        )
    rig = CameraRig(quat_to_R(q_IC / length)[None], np.array([numbers[:3]]))
    return rig, focal_px
