# SPDX-License-Identifier: Apache-2.0
"""Trajectories in files: TUM text, and the ground truth of EuRoC."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skyhaul.errors import FileError
from skyhaul.evaluation.trajectory_error import NS_PER_S, Trajectory
from skyhaul.whole import whole

_KINDS = (
    "EuRoC CSV (time [ns], p x y z, q w x y z, ...) and TUM text (time [s] x y z qx qy qz qw) are"
)

FARTHEST_M = 1e7
"""No trajectory that we score leads farther [m]."""
LATEST_NS = np.iinfo(np.int64).max
UNIT = 1e-2
"""Allowed error of a quaternion's length: files round."""


def read_trajectory(path: Path) -> Trajectory:
    """Poses of a file: EuRoC CSV where its lines have commas, TUM text where they have none.

    Raises:
        FileError: When the file is missing, is no text or has a line that is no pose.
    """
    lines = _lines(path)
    comma = "," in lines[0][1]
    poses = [_pose(path, at, line, comma=comma) for at, line in lines]
    time_ns = np.array([time for time, _ in poses], dtype=np.int64)
    table = np.array([numbers for _, numbers in poses])
    late = np.flatnonzero(np.diff(time_ns) <= 0)
    if len(late):
        i = int(late[0])
        raise FileError(
            f"{path}: line {lines[i + 1][0]}: its time is that of line {lines[i][0]} or earlier; "
            f"its times must grow from line to line"
        )
    return Trajectory(time_ns, table[:, :3].copy(), table[:, 3:].copy())


def _pose(path: Path, at: int, line: str, *, comma: bool) -> tuple[int, list[float]]:
    """Time [ns], p and q (w x y z) of a line."""
    cells = [c.strip() for c in line.split(",")] if comma else line.split()
    try:
        if len(cells) < 8 or (len(cells) > 8 and not comma):
            raise ValueError(f"it has {len(cells)} numbers")
        time_ns = _whole(cells[0]) if comma else _nanoseconds(cells[0])
        p = [_number(c, FARTHEST_M) for c in cells[1:4]]
        q = [_number(c, 1e6) for c in cells[4:8]]
        length = math.sqrt(sum(v * v for v in q))
        if not abs(length - 1.0) < UNIT:
            raise ValueError(f"its quaternion has the length {length:.4g}, no unit quaternion")
    except ValueError as error:
        raise FileError(f"{path}: line {at} is no pose: {error}; {_KINDS} allowed") from None
    w = q if comma else [q[3], *q[:3]]
    return time_ns, [*p, *(v / length for v in w)]


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write TUM text, whole or not at all: time [s] x y z [m] qx qy qz qw.

    Raises:
        FileError: When the file cannot be written.
    """
    rows = ["# timestamp [s] tx ty tz [m] qx qy qz qw"]
    for t, p, q in zip(trajectory.time_ns.tolist(), trajectory.p, trajectory.q, strict=True):
        values = " ".join(f"{v:.9f}" for v in (*p, q[1], q[2], q[3], q[0]))
        rows.append(f"{t // NS_PER_S}.{t % NS_PER_S:09d} {values}")
    try:
        with whole(path) as part:
            part.write_text("\n".join(rows) + "\n", "utf-8")
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def check_out(path: Path) -> None:
    """Refuse a file that is there, or that cannot be made, before there is anything to write.

    Raises:
        FileError: With what is in the way.
    """
    try:
        if path.is_dir() or path.exists():
            what = "a folder" if path.is_dir() else "there already"
            raise FileError(f"{path}: is {what}; give the name of a new file")
        part = path.with_name(path.name + ".part")
        part.touch(exist_ok=False)
        part.unlink()
    except (OSError, ValueError) as error:
        name, why = getattr(error, "filename", None), getattr(error, "strerror", None)
        raise FileError(f"{name or path}: cannot be written: {why or error}") from None


def _lines(path: Path) -> Sequence[tuple[int, str]]:
    """Lines with content and their numbers."""
    try:
        text = path.read_text("utf-8-sig")
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: is no text file; {_KINDS} allowed") from error
    lines = [(i, line.strip()) for i, line in enumerate(text.splitlines(), 1)]
    kept = [(i, line) for i, line in lines if line and not line.startswith("#")]
    if not kept:
        raise FileError(f"{path}: holds no pose; {_KINDS} allowed")
    return kept


def _whole(text: str) -> int:
    """Time in whole nanoseconds."""
    if not (text.isascii() and text.isdigit() and len(text) <= 19 and int(text) <= LATEST_NS):
        raise ValueError(f"{text[:32]!r} is no time in whole nanoseconds")
    return int(text)


def _nanoseconds(text: str) -> int:
    """Time in seconds as text to nanoseconds; a double would round it."""
    whole, _, rest = text.partition(".")
    if not (text.isascii() and whole.isdigit() and (rest.isdigit() or not rest)):
        return round(_number(text, LATEST_NS / NS_PER_S) * NS_PER_S)
    if len(whole) > 10 or int(whole) >= LATEST_NS // NS_PER_S:
        raise ValueError(f"{text[:32]!r} is no time in seconds, rather nanoseconds")
    return int(whole) * NS_PER_S + int((rest + "0" * 9)[:9])


def _number(text: str, most: float) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{text[:32]!r} is no number") from None
    if not abs(value) <= most:
        raise ValueError(f"{text[:32]!r} is not finite or beyond {most:g}")
    return value
