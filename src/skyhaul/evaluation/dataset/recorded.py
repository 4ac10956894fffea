# SPDX-License-Identifier: Apache-2.0
"""A recording in the layout of EuRoC: `mav0/imu0` and `mav0/cam0 .. camN`, checked as a whole."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyhaul.errors import FileError
from skyhaul.evaluation.dataset import layout
from skyhaul.evaluation.dataset.camera_file import (
    SHIFT,
    CameraKnown,
    check_body,
    read_chain,
    read_chain_shift,
    read_sensor,
)
from skyhaul.evaluation.dataset.table_file import (
    ACCEL_MPS2,
    GYRO_RAD_S,
    NS_PER_S,
    Line,
    check_growing,
    check_imu_axes,
    check_spans,
    nanoseconds,
    number,
    read_lines,
    short,
)
from skyhaul.types import Array, IntArray

TOGETHER_NS = 2_000_000
"""Images of several cameras within this time are one frame of the rig [ns]."""
SAME_SHIFT_S = 1e-6
"""Time shifts of two files closer than this are one [s]."""
_AXES = ("w x", "w y", "w z", "a x", "a y", "a z")


@dataclass(frozen=True, eq=False)
class RecordedCamera:
    """One camera and its images, by the clock of the first camera."""

    known: CameraKnown
    time_ns: IntArray  # (m,) growing
    files: tuple[Path, ...]  # all there


@dataclass(frozen=True, eq=False)
class RecordedFolder:
    """What a folder holds, times by the clock of the first camera."""

    imu_file: Path
    imu_ns: IntArray  # (n,) growing
    gyro_I: Array  # (n, 3) [rad/s]
    accel_I: Array  # (n, 3) [m/s^2]
    cameras: tuple[RecordedCamera, ...]


def read_folder(folder: Path) -> RecordedFolder:
    """Read IMU, calibration and lists of images; the images stay where they are.

    Args:
        folder: Holds `mav0`, or is it.

    Raises:
        FileError: When something is missing, malformed or contradicts the rest.
    """
    mav = folder / "mav0" if (folder / "mav0").is_dir() else folder
    names = _camera_names(folder, mav)
    imu_file = mav / "imu0" / layout.DATA
    if (mav / "imu0" / layout.SENSOR).exists():
        check_body(mav / "imu0" / layout.SENSOR)
    imu_ns, values = _imu(imu_file)
    chains = sorted({*folder.glob("*camchain*.yaml"), *mav.glob("*camchain*.yaml")})
    known = _known(folder, mav, names, chains)
    shift_ns = [_shift_ns(mav / name, k, chains) for name, k in zip(names, known, strict=True)]
    imu_ns = imu_ns - shift_ns[0]
    cameras = []
    for name, camera, shift in zip(names, known, shift_ns, strict=True):
        time_ns, files = _images(mav / name, camera)
        time_ns = time_ns + shift - shift_ns[0]
        cameras.append(RecordedCamera(camera, time_ns, files))
        check_spans(imu_file, imu_ns, mav / name / layout.DATA, time_ns)
    _check_together(mav, names, cameras)
    return RecordedFolder(imu_file, imu_ns, values[:, :3], values[:, 3:], tuple(cameras))


def _camera_names(folder: Path, mav: Path) -> list[str]:
    found = [
        p.name for p in mav.glob("cam[0-9]*") if p.is_dir() and re.fullmatch("cam\\d+", p.name)
    ]
    names = [f"cam{i}" for i in range(len(found))]
    if not (mav / "imu0").is_dir() or not found:
        raise FileError(
            f"{folder}: is no EuRoC folder: mav0/imu0 and mav0/cam0 are needed; give one, or a "
            f"feature-track CSV"
        )
    missing = [name for name in names if name not in found]
    if missing:
        raise FileError(
            f"{mav}: has {', '.join(sorted(found))}, but no folder {missing[0]}; number the "
            f"cameras from cam0 without a gap"
        )
    return names


def _known(
    folder: Path, mav: Path, names: Sequence[str], chains: Sequence[Path]
) -> list[CameraKnown]:
    """Of each camera: from its own file, or all from the one camera chain."""
    with_file = [name for name in names if (mav / name / layout.SENSOR).exists()]
    if not with_file and not chains:
        raise FileError(
            f"{mav / names[0]}: has no {layout.SENSOR}, and {folder} no *camchain*.yaml; one of "
            f"them must tell lens and place of the cameras"
        )
    if with_file:
        return [read_sensor(mav / name / layout.SENSOR) for name in names]
    if len(chains) > 1:
        raise FileError(
            f"{folder}: has several camera chains, {chains[0].name} and {chains[1].name}; leave "
            f"one, or give each camera a {layout.SENSOR}"
        )
    return read_chain(chains[0], list(names))


def _shift_ns(folder: Path, known: CameraKnown, chains: Sequence[Path]) -> int:
    """Time by the IMU's clock less time by a camera's [ns], by its own file or the chains.

    Raises:
        FileError: When they disagree.
    """
    told = {folder / layout.SENSOR: known.shift_s}
    told |= {chain: read_chain_shift(chain, folder.name) for chain in chains}
    (file, shift_s), *others = [(f, s) for f, s in told.items() if s is not None] or [(folder, 0.0)]
    for other, other_s in others:
        if abs(other_s - shift_s) > SAME_SHIFT_S:
            raise FileError(
                f"{file} and {other} disagree on {SHIFT} of {folder.name}: {shift_s:g} s and "
                f"{other_s:g} s; correct one, or take it out"
            )
    return round(shift_s * NS_PER_S)


def _imu(file: Path) -> tuple[IntArray, Array]:
    lines = read_lines(file)
    try:
        stamps, values = zip(*(_sample(line) for line in lines), strict=True)
    except ValueError as error:
        raise FileError(
            f"{file}: {error}; time [ns], w x y z [rad/s], a x y z [m/s^2] are needed"
        ) from None
    time_ns, table = np.array(stamps, dtype=np.int64), np.array(values)
    check_growing(file, [n for n, _ in lines], time_ns)
    check_imu_axes(file, table[:, :3], table[:, 3:])
    return time_ns, table


def _sample(line: Line) -> tuple[int, list[float]]:
    n, cells = line
    try:
        if len(cells) != 7:
            raise ValueError(f"it has {len(cells)} columns, not 7")
        limits = (GYRO_RAD_S,) * 3 + (ACCEL_MPS2,) * 3
        return nanoseconds(cells[0]), [
            number(c, name, most) for c, name, most in zip(cells[1:], _AXES, limits, strict=True)
        ]
    except ValueError as error:
        raise ValueError(f"line {n} is no IMU sample: {error}") from None


def _images(folder: Path, known: CameraKnown) -> tuple[IntArray, tuple[Path, ...]]:
    file = folder / layout.DATA
    times, files = [], []
    lines = read_lines(file)
    for n, cells in lines:
        try:
            if len(cells) != 2 or not cells[1]:
                raise ValueError(f"it has {len(cells)} columns, not 2")
            times.append(nanoseconds(cells[0]))
        except ValueError as error:
            raise FileError(
                f"{file}: line {n} is no image: {error}; time [ns] and file are needed"
            ) from None
        files.append(folder / "data" / cells[1])
    time_ns = np.array(times, dtype=np.int64)
    check_growing(file, [n for n, _ in lines], time_ns)
    gone = [i for i, path in enumerate(files) if not path.is_file()]
    if gone:
        w, h = known.model.size_px
        n, cells = lines[gone[0]]
        raise FileError(
            f"{file}: line {n}: {short(cells[1])} is no image of {w} x {h} px: there is no such "
            f"file in {folder / 'data'} ({len(gone)} of {len(files)} are missing); give all "
            f"images, or leave out their lines"
        )
    return time_ns, tuple(files)


def _check_together(mav: Path, names: Sequence[str], cameras: Sequence[RecordedCamera]) -> None:
    """Refuse cameras that never fire with the first one, or the same camera given twice."""
    first = cameras[0]
    for i, camera in enumerate(cameras[1:], 1):
        file = mav / names[i] / layout.DATA
        near = _nearest_ns(camera.time_ns, first.time_ns)
        if (
            np.mean(near <= TOGETHER_NS) < 0.5
            and np.mean(_nearest_ns(first.time_ns, camera.time_ns) <= TOGETHER_NS) < 0.5
        ):
            raise FileError(
                f"{file}: its images are {np.median(near) / 1e6:.3g} ms (median) from those of "
                f"cam0; the cameras must fire together, within {TOGETHER_NS / 1e6:g} ms"
            )
        for j in range(i):
            if np.allclose(camera.known.T_IC, cameras[j].known.T_IC, rtol=0.0, atol=1e-9):
                raise FileError(
                    f"{mav}: {names[j]} and {names[i]} have the same T_BS; give each camera its "
                    f"own place, or leave one out"
                )


def _nearest_ns(time_ns: IntArray, other_ns: IntArray) -> IntArray:
    """Distance of each time to the nearest of others (growing)."""
    after = np.clip(np.searchsorted(other_ns, time_ns), 1, max(len(other_ns) - 1, 1))
    before, after = after - 1, np.minimum(after, len(other_ns) - 1)
    nearest: IntArray = np.minimum(
        np.abs(time_ns - other_ns[before]), np.abs(time_ns - other_ns[after])
    )
    return nearest
