# SPDX-License-Identifier: Apache-2.0
"""Tables in text files, read strictly: each refusal names file, line and cell."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skyhaul.errors import FileError
from skyhaul.types import IntArray

NS_PER_S = 1_000_000_000
NS_PER_US = 1_000
BEFORE_NS = NS_PER_S
"""No clock lags so much that it stamps earlier before time 0 [ns]."""
GYRO_RAD_S, ACCEL_MPS2 = 100.0, 4000.0
"""No IMU reads more, on any axis."""
OUTSIDE_S = 0.1
"""How far a frame may lie before the first or behind the last IMU sample [s]."""

Line = tuple[int, list[str]]
"""Number of a line and its cells."""


def read_lines(file: Path) -> list[Line]:
    """Lines of a CSV file that are neither empty nor comments (`#`).

    Raises:
        FileError: When it cannot be read, is no text or has no such line.
    """
    try:
        with file.open(encoding="utf-8-sig", newline="") as text:
            rows = csv.reader(text)
            lines = [(rows.line_num, [cell.strip() for cell in row]) for row in rows]
    except OSError as error:
        raise FileError(f"{file}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"{file}: is no text file; a CSV file is needed") from error
    kept = [(n, row) for n, row in lines if any(row) and not row[0].startswith("#")]
    if not kept:
        raise FileError(f"{file}: holds no line of data")
    return kept


def short(text: str) -> str:
    """A cell as a sentence may quote it."""
    return repr(text if len(text) <= 32 else text[:29] + "...")


def nanoseconds(text: str) -> int:
    """A time in whole nanoseconds; a clock that lags may stamp before time 0.

    Raises:
        ValueError: When it is none, with what is wrong.
    """
    if not (text.isascii() and text.removeprefix("-").isdigit()):
        unit = ", not seconds" if "." in text else ""
        raise ValueError(f"{short(text)} is no time in whole nanoseconds{unit}")
    if len(text) > 19 or int(text) > np.iinfo(np.int64).max:
        raise ValueError(f"{short(text)} ns is beyond the year 2262")
    if int(text) < -BEFORE_NS:
        raise ValueError(f"{short(text)} ns is more than a second before time 0")
    return int(text)


def number(text: str, name: str, most: float) -> float:
    """A finite number of at most this size.

    Raises:
        ValueError: When it is none, with what is wrong.
    """
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{name} is {short(text)}, no number") from None
    if not math.isfinite(value):
        raise ValueError(f"{name} is {short(text)}, not finite")
    if abs(value) > most:
        raise ValueError(f"{name} is {value:.4g}, at most {most:g} is possible; check its unit")
    return value


def check_growing(file: Path, lines: Sequence[int], time_ns: IntArray) -> None:
    """Refuse times that stand still or go back.

    Args:
        file: For the sentence.
        lines: Number of each time's line.
        time_ns: (m,).

    Raises:
        FileError: With the first line that is not later than the one before.
    """
    step_ns = np.diff(time_ns)
    if np.all(step_ns >= NS_PER_US):
        return
    i = int(np.argmax(step_ns < NS_PER_US))
    raise FileError(
        f"{file}: line {lines[i + 1]}: the time {time_ns[i + 1]} ns comes {step_ns[i]} ns after "
        f"that of line {lines[i]}; times must grow by {NS_PER_US} ns at least: sort the lines, "
        f"drop what stands twice, give nanoseconds"
    )


def check_imu_axes(file: Path, gyro: np.ndarray, accel: np.ndarray) -> None:
    """Refuse an IMU whose rates look like forces and the other way round.

    Raises:
        FileError: When the columns are swapped.
    """
    rate, force = (float(np.median(np.linalg.norm(v, axis=1))) for v in (gyro, accel))
    if 7.0 < rate < 14.0 and force < 5.0:
        raise FileError(
            f"{file}: rates of {rate:.3g} rad/s and forces of {force:.3g} m/s^2 (medians): the "
            f"columns of gyroscope and accelerometer are swapped; first w x y z, then a x y z"
        )


def check_spans(imu_file: Path, imu_ns: IntArray, file: Path, frame_ns: IntArray) -> None:
    """Refuse frames of times without IMU.

    Raises:
        FileError: When a frame lies before the first or behind the last sample.
    """
    slack = round(OUTSIDE_S * NS_PER_S)
    if imu_ns[0] - slack <= frame_ns[0] and frame_ns[-1] <= imu_ns[-1] + slack:
        return
    raise FileError(
        f"{file}: its times go from {seconds(frame_ns[0])} to {seconds(frame_ns[-1])} s, those of "
        f"{imu_file} from {seconds(imu_ns[0])} to {seconds(imu_ns[-1])} s; give both by one clock "
        f"and leave out frames without IMU"
    )


def seconds(time_ns: int) -> str:
    """A time [ns] as seconds."""
    whole, rest = divmod(abs(int(time_ns)), NS_PER_S)
    sign = "-" if time_ns < 0 else ""
    return f"{sign}{whole}.{rest // 1_000_000:03d}"
