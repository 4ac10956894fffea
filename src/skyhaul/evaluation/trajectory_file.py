# SPDX-License-Identifier: Apache-2.0
"""Trajectories in files: TUM text, and the ground truth of EuRoC."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skyhaul.errors import FileError
from skyhaul.evaluation.trajectory_error import NS_PER_S, Trajectory

_KINDS = (
    "EuRoC CSV (time [ns], p x y z, q w x y z, ...) and TUM text (time [s] x y z qx qy qz qw) are"
)


def read_trajectory(path: Path) -> Trajectory:
    """Poses of a file: EuRoC CSV where its lines have commas, TUM text where they have none.

    Raises:
        FileError: When the file is missing, is no text or has a line that is no pose.
    """
    lines = _lines(path)
    comma = "," in lines[0][1]
    times, numbers = [], []
    for at, line in lines:
        cells = [c.strip() for c in line.split(",")] if comma else line.split()
        try:
            times.append(int(cells[0]) if comma else _nanoseconds(cells[0]))
            numbers.append([float(c) for c in cells[1:8]])
        except (ValueError, IndexError) as error:
            raise FileError(f"{path}: line {at} is no pose; {_KINDS} allowed") from error
        if len(numbers[-1]) != 7:
            raise FileError(f"{path}: line {at} has {len(cells)} numbers; {_KINDS} allowed")
    table = np.array(numbers)
    q = table[:, 3:] if comma else table[:, [6, 3, 4, 5]]
    length = np.linalg.norm(q, axis=1)
    if not (np.all(np.isfinite(table)) and np.all(np.abs(length - 1.0) < 1e-2)):
        raise FileError(
            f"{path}: holds numbers that are no pose (no unit quaternion); {_KINDS} allowed"
        )
    time_ns = np.array(times, dtype=np.int64)
    if len(times) > 1 and not np.all(np.diff(time_ns) > 0):
        raise FileError(f"{path}: its times must grow from line to line")
    return Trajectory(time_ns, table[:, :3].copy(), q / length[:, None])


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write TUM text: time [s] x y z [m] qx qy qz qw.

    Raises:
        FileError: When the file cannot be written.
    """
    rows = ["# timestamp [s] tx ty tz [m] qx qy qz qw"]
    for t, p, q in zip(trajectory.time_ns.tolist(), trajectory.p, trajectory.q, strict=True):
        values = " ".join(f"{v:.9f}" for v in (*p, q[1], q[2], q[3], q[0]))
        rows.append(f"{t // NS_PER_S}.{t % NS_PER_S:09d} {values}")
    try:
        path.write_text("\n".join(rows) + "\n", "utf-8")
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror}") from error


def _lines(path: Path) -> Sequence[tuple[int, str]]:
    """Lines with content and their numbers."""
    try:
        text = path.read_text("utf-8")
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: is no text file; {_KINDS} allowed") from error
    lines = [(i, line.strip()) for i, line in enumerate(text.splitlines(), 1)]
    kept = [(i, line) for i, line in lines if line and not line.startswith("#")]
    if not kept:
        raise FileError(f"{path}: holds no pose; {_KINDS} allowed")
    return kept


def _nanoseconds(seconds: str) -> int:
    """Time in seconds as text to nanoseconds; a double would round it."""
    whole, _, rest = seconds.partition(".")
    if not (whole.isdigit() and (rest.isdigit() or not rest)):
        return round(float(seconds) * NS_PER_S)
    return int(whole) * NS_PER_S + int((rest + "0" * 9)[:9])
