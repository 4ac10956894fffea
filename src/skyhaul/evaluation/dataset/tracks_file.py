# SPDX-License-Identifier: Apache-2.0
"""Feature tracks and IMU of one camera in a CSV file, as EqVIO writes them; see docs/vio.md."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyhaul.errors import FileError
from skyhaul.evaluation.dataset.table_file import (
    ACCEL_MPS2,
    GYRO_RAD_S,
    NS_PER_S,
    check_growing,
    check_imu_axes,
    check_spans,
    number,
    read_lines,
    short,
)
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.types import Array, IntArray

_IMU = ("gx", "gy", "gz", "ax", "ay", "az")
_POSITION = ("T_ci_tx", "T_ci_ty", "T_ci_tz")
_TURN = ("T_ci_qw", "T_ci_qx", "T_ci_qy", "T_ci_qz")
_COLUMNS = ("row_type", "t_abs", "landmark_id", "u_norm", "v_norm", "key", "value", *_IMU)
_MOST = dict.fromkeys(_IMU[:3], GYRO_RAD_S) | dict.fromkeys(_IMU[3:], ACCEL_MPS2)
FLATTEST = 20.0
"""Largest x / z and y / z of a sight: 87 deg off the axis. Pixels are more."""
LATEST_S = 9_000_000_000
"""No clock shows more seconds."""
ARM_M = 100.0
"""A camera farther from the IMU is a mistake [m]."""
FOCAL_PX = (10.0, 1e5)
"""Focal lengths that there are [px]."""


@dataclass(frozen=True, eq=False)
class Row:
    """A line by its columns."""

    line: int
    cells: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class RecordedTracks:
    """What a feature-track file holds, times by its clock."""

    R_IC: Array  # (3, 3)
    p_IC: Array  # (3,) [m]
    focal_px: float
    imu_ns: IntArray  # (n,) growing
    gyro_I: Array  # (n, 3) [rad/s]
    accel_I: Array  # (n, 3) [m/s^2]
    sight_ns: IntArray  # (k,) never falling
    track_id: IntArray  # (k,) each at most once at a time
    xy: Array  # (k, 2) normalised


def read_tracks(path: Path) -> RecordedTracks:
    """Read IMU, tracks and extrinsics of one camera.

    Raises:
        FileError: When the file is missing or no such table, with line and column.
    """
    kinds = _rows_by_kind(path)
    imu_ns = _times(path, kinds["imu"])
    check_growing(path, [row.line for row in kinds["imu"]], imu_ns)
    values = _table(path, kinds["imu"], _MOST)
    check_imu_axes(path, values[:, :3], values[:, 3:])
    sights = kinds["vision_feature"]
    sight_ns, ids = _times(path, sights), _ids(path, sights)
    xy = _table(path, sights, {"u_norm": FLATTEST, "v_norm": FLATTEST})
    _check_sights(path, sights, sight_ns, ids)
    check_spans(path, imu_ns, path, sight_ns)
    R_IC, p_IC, focal_px = _camera(path, kinds["meta"])
    gyro, accel = values[:, :3], values[:, 3:]
    return RecordedTracks(R_IC, p_IC, focal_px, imu_ns, gyro, accel, sight_ns, ids, xy)


def _rows_by_kind(path: Path) -> dict[str, list[Row]]:
    kinds: dict[str, list[Row]] = {"meta": [], "imu": [], "vision_feature": []}
    (_, head), *lines = read_lines(path)
    missing = [c for c in _COLUMNS if c not in head]
    if missing:
        raise FileError(
            f"{path}: is no feature-track file: column {missing[0]} is missing; "
            f"docs/vio.md describes the format"
        )
    for n, cells in lines:
        if len(cells) != len(head):
            raise FileError(
                f"{path}: line {n} has {len(cells)} columns, the header has {len(head)}; the file "
                f"may be cut off"
            )
        row = Row(n, dict(zip(head, cells, strict=True)))
        kind = row.cells["row_type"]
        if kind not in kinds:
            raise FileError(
                f"{path}: line {n}: row_type {short(kind)} is unknown; "
                f"allowed are {', '.join(kinds)}"
            )
        kinds[kind].append(row)
    for kind in ("imu", "vision_feature"):
        if not kinds[kind]:
            raise FileError(f"{path}: holds no row of kind {kind}; it needs IMU and tracks")
    return kinds


def _times(path: Path, rows: Sequence[Row]) -> IntArray:
    """Times of rows [ns]: seconds with 9 digits are split before they become a double."""
    out = []
    for row in rows:
        text = row.cells["t_abs"]
        whole, _, rest = text.partition(".")
        plain = text.isascii() and whole.isdigit() and (rest.isdigit() or not rest)
        if not plain or len(whole) > 10 or int(whole) > LATEST_S:
            unit = "; give seconds, not nanoseconds" if plain else ", as in 1403715273.262"
            raise FileError(
                f"{path}: line {row.line}: t_abs {short(text)} is no time in seconds{unit}"
            )
        out.append(int(whole) * NS_PER_S + int((rest + "000000000")[:9]))
    return np.array(out, dtype=np.int64)


def _table(path: Path, rows: Sequence[Row], most: Mapping[str, float]) -> Array:
    return np.array([[_number(path, row, c, limit) for c, limit in most.items()] for row in rows])


def _number(path: Path, row: Row, column: str, most: float) -> float:
    try:
        return number(row.cells[column], column, most)
    except ValueError as error:
        kind = row.cells["row_type"]
        raise FileError(f"{path}: line {row.line} ({kind}): {error}") from None


def _ids(path: Path, rows: Sequence[Row]) -> IntArray:
    for row in rows:
        text = row.cells["landmark_id"]
        if not (text.isascii() and text.isdigit() and len(text) <= 15):
            raise FileError(
                f"{path}: line {row.line}: landmark_id {short(text)} is no whole number, 0 or more"
            )
    return np.array([int(row.cells["landmark_id"]) for row in rows], dtype=np.int64)


def _check_sights(path: Path, rows: Sequence[Row], time_ns: IntArray, ids: IntArray) -> None:
    """Refuse times that go back, and a point that is seen twice at a time."""
    if np.any(np.diff(time_ns) < 0):
        i = int(np.argmax(np.diff(time_ns) < 0))
        raise FileError(
            f"{path}: line {rows[i + 1].line}: a vision_feature at t_abs "
            f"{rows[i + 1].cells['t_abs']} comes after one at {rows[i].cells['t_abs']}; sort them "
            f"by time"
        )
    _, first = np.unique(np.column_stack([time_ns, ids]), axis=0, return_index=True)
    if len(first) < len(ids):
        row = rows[int(np.setdiff1d(np.arange(len(ids)), first)[0])]
        raise FileError(
            f"{path}: line {row.line}: landmark_id {row.cells['landmark_id']} stands twice at "
            f"t_abs {row.cells['t_abs']}; a camera sees a point once"
        )


def _camera(path: Path, rows: Sequence[Row]) -> tuple[Array, Array, float]:
    """R_IC, p_IC and focal length [px]."""
    meta = {row.cells["key"]: row for row in rows}
    wanted = (*_POSITION, *_TURN, "camera_fx")
    missing = [name for name in wanted if name not in meta]
    if missing:
        raise FileError(
            f"{path}: needs meta rows {', '.join(wanted)} with numbers (camera in IMU axes); "
            f"{missing[0]} is missing"
        )
    space = meta["measurement_space"].cells["value"] if "measurement_space" in meta else ""
    if space not in ("", "normalized"):
        raise FileError(
            f"{path}: measurement_space {short(space)} is unknown; give u_norm v_norm undistorted, "
            f"x/z and y/z: normalized"
        )
    p = [_meta(path, meta[name], ARM_M) for name in _POSITION]
    q_IC = np.array([_meta(path, meta[name], 2.0) for name in _TURN])
    focal_px = _meta(path, meta["camera_fx"], FOCAL_PX[1])
    length = float(np.linalg.norm(q_IC))
    if not abs(length - 1.0) < 1e-3 or focal_px < FOCAL_PX[0]:
        raise FileError(
            f"{path}: {', '.join(_TURN)} must be a unit quaternion and camera_fx {FOCAL_PX[0]:g} px"
            f" at least, got length {length:.3g} and {focal_px:.3g} px"
        )
    return quat_to_R(q_IC / length), np.array(p), focal_px


def _meta(path: Path, row: Row, most: float) -> float:
    try:
        return number(row.cells["value"], row.cells["key"], most)
    except ValueError as error:
        raise FileError(f"{path}: line {row.line} (meta): {error}") from None
