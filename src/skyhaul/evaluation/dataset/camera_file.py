# SPDX-License-Identifier: Apache-2.0
"""What a camera is: EuRoC's `sensor.yaml`, or an entry of Kalibr's camera chain."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from skyhaul.errors import FileError
from skyhaul.evaluation.dataset.calibration import inverse
from skyhaul.evaluation.dataset.table_file import number
from skyhaul.geometry.camera import CameraModel, Equidistant, RadTan
from skyhaul.types import Array

MODELS = {"radial-tangential": RadTan, "radtan": RadTan, "equidistant": Equidistant}
SHIFT = "timeshift_cam_imu"
RIGID = 1e-3
"""Allowed error of a rotation's entries: files round."""
ARM_M = 100.0
"""A sensor farther from the IMU is a mistake [m]."""
SHIFT_S = 1.0
"""So is a larger offset of two clocks [s]."""

Tree = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class CameraKnown:
    """Lens, place and clock of a camera."""

    model: CameraModel
    T_IC: Array  # (4, 4)
    shift_s: float | None  # time by the IMU's clock less time by the camera's; None: not told


def read_description(file: Path) -> Tree:
    """A YAML mapping.

    Raises:
        FileError: When it is none, with the line where a parser stopped.
    """
    try:
        # OpenCV's header line is no YAML that a parser knows.
        tree = yaml.safe_load(file.read_text("utf-8-sig").replace("%YAML:1.0", ""))
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = f" at line {mark.line + 1}" if mark else ""
        raise FileError(f"{file}: is no YAML file{at}: {error.problem}") from None
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise FileError(f"{file}: is no YAML file") from error
    if not isinstance(tree, dict):
        raise FileError(f"{file}: is no description of a sensor (key: value)")
    return tree


def read_sensor(file: Path) -> CameraKnown:
    """A camera by its own file, in EuRoC's form or Kalibr's.

    Raises:
        FileError: With the key that is missing or wrong.
    """
    tree = read_description(file)
    entries = [v for v in tree.values() if isinstance(v, dict) and "intrinsics" in v]
    if len(entries) == 1 and "intrinsics" not in tree:
        tree = entries[0]
    return _camera(tree, _pose(tree, f"{file}"), f"{file}")


def read_chain(file: Path, names: list[str]) -> list[CameraKnown]:
    """Cameras of these names from Kalibr's `camchain-imucam.yaml`.

    Raises:
        FileError: With the camera and the key that is missing or wrong.
    """
    tree, known = read_description(file), []
    T_IC = None
    for name in names:
        entry, where = tree.get(name), f"{file}: {name}"
        if not isinstance(entry, dict):
            raise FileError(f"{where} is missing; there is a folder of this camera")
        if T_IC is not None and "T_cam_imu" not in entry and "T_cn_cnm1" in entry:
            T_IC = T_IC @ inverse(_rigid(entry["T_cn_cnm1"], f"{where}: T_cn_cnm1"))
        else:
            T_IC = _pose(entry, where)
        known.append(_camera(entry, T_IC, where))
    return known


def read_chain_shift(file: Path, name: str) -> float | None:
    """What a camera chain tells of a camera's clock as `CameraKnown` does, and nothing else of it.

    Raises:
        FileError: When it is no YAML file or the shift no number.
    """
    entry = read_description(file).get(name)
    return _shift_s(entry, f"{file}: {name}") if isinstance(entry, dict) else None


def check_body(file: Path) -> None:
    """Refuse an IMU that is not the body frame.

    Raises:
        FileError: When its T_BS is not the identity.
    """
    tree = read_description(file)
    if "T_BS" in tree and not np.allclose(_rigid(tree["T_BS"], f"{file}: T_BS"), np.eye(4)):
        raise FileError(
            f"{file}: T_BS is not the identity; the IMU must be the body: give the cameras' T_BS "
            f"in axes of the IMU, and the identity here"
        )


def _pose(tree: Tree, where: str) -> Array:
    if "T_BS" in tree:
        return _rigid(tree["T_BS"], f"{where}: T_BS")
    if "T_cam_imu" in tree:
        return inverse(_rigid(tree["T_cam_imu"], f"{where}: T_cam_imu"))
    raise FileError(
        f"{where}: needs T_BS (camera in IMU axes, rows, cols and 16 data) or Kalibr's T_cam_imu"
    )


def _camera(tree: Tree, T_IC: Array, where: str) -> CameraKnown:
    lens = tree.get("camera_model", "pinhole")
    if lens != "pinhole":
        raise FileError(f"{where}: camera_model {lens!r} is unknown; pinhole is allowed")
    kind = tree.get("distortion_model")
    if not isinstance(kind, str) or kind not in MODELS:
        raise FileError(f"{where}: distortion_model {kind!r} is unknown; allowed are {_known()}")
    size = _numbers(tree, "resolution", 2, 1e5, where)
    w, h = (int(v) for v in size)
    if [w, h] != size or min(w, h) < 8:
        raise FileError(f"{where}: resolution {size} is no size of an image [px], 8 x 8 at least")
    fx, fy, cx, cy = _numbers(tree, "intrinsics", 4, 1e6, where)
    if not (0.05 * w <= fx and 0.05 * w <= fy and 0.0 < cx < w and 0.0 < cy < h):
        raise FileError(
            f"{where}: intrinsics {[fx, fy, cx, cy]} are no fx fy cx cy [px] of an image of "
            f"{w} x {h} px"
        )
    names = ("distortion_coefficients", "distortion_coeffs")
    k = _numbers(tree, names[1] if names[1] in tree else names[0], 4, 1e3, where)
    model = MODELS[kind](
        size_px=(w, h), focal_px=(fx, fy), center_px=(cx, cy), distortion=(k[0], k[1], k[2], k[3])
    )
    return CameraKnown(model, T_IC, _shift_s(tree, where))


def _shift_s(tree: Tree, where: str) -> float | None:
    if SHIFT not in tree:
        return None
    return _number(tree[SHIFT], f"{where}: {SHIFT}", SHIFT_S)


def _known() -> str:
    return ", ".join(MODELS)


def _numbers(tree: Tree, key: str, count: int, most: float, where: str) -> list[float]:
    value = tree.get(key)
    if not isinstance(value, list) or len(value) != count:
        got = f"a list of {len(value)}" if isinstance(value, list) else f"{value!r:.40}"

        raise FileError(f"{where}: {key} needs {count} numbers, got {got}")
    return [_number(v, f"{where}: {key}", most) for v in value]


def _number(value: object, where: str, most: float) -> float:
    """YAML takes 1e-3 for a text: it is a number here."""
    text = "a list" if isinstance(value, list | dict) else str(value)
    try:
        return number(text, where, most)
    except ValueError as error:
        raise FileError(str(error)) from None


def _rigid(value: object, where: str) -> Array:
    """A pose, (4, 4), from EuRoC's matrix or Kalibr's four rows."""
    rows = value.get("data") if isinstance(value, dict) else value
    if isinstance(rows, list) and len(rows) == 4 and all(isinstance(r, list) for r in rows):
        rows = [v for row in rows for v in row[:5]]
    if not isinstance(rows, list) or len(rows) != 16:
        raise FileError(f"{where} needs 16 numbers, a 4 x 4 matrix by rows")
    T = np.array([_number(v, where, ARM_M) for v in rows]).reshape(4, 4)
    R = T[:3, :3]
    off = max(float(np.abs(R.T @ R - np.eye(3)).max()), float(np.abs(T[3] - [0, 0, 0, 1]).max()))
    if off > RIGID or np.linalg.det(R) < 0.0:
        raise FileError(
            f"{where} is no rigid motion: its rotation is off by {off:.2g} (a determinant of "
            f"{np.linalg.det(R):.3g}); give a rotation, the translation [m] and 0 0 0 1"
        )
    U, _, Vt = np.linalg.svd(R)  # what rounding of the file left is taken off
    T[:3, :3], T[3] = U @ Vt, [0.0, 0.0, 0.0, 1.0]
    return T
