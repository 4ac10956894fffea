# SPDX-License-Identifier: Apache-2.0
"""Recorded events: text, Event Stream, HDF5, and what faery reads; the files beside them."""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from skyhaul.errors import FileError
from skyhaul.geometry.camera import RadTan
from skyhaul.jit import njit
from skyhaul.sensors.api import EventReading
from skyhaul.types import US_PER_S, Array, IntArray

_SIGNATURE = b"Event Stream"
_HDF5 = b"\x89HDF\r\n\x1a\n"
_HEADER_BYTES = 20
_DVS = 1
_OVERFLOW = 127
Numbers = NDArray[np.float64] | NDArray[np.integer] | NDArray[np.bool_]
FAERY_SUFFIXES = (".aedat", ".aedat4", ".raw", ".dat")


@dataclass(frozen=True, eq=False)
class Recording:
    """Events of a file and the size of their image."""

    events: EventReading
    width: int
    height: int


def read_recording(path: Path) -> Recording:
    """Read events by what the file is: Event Stream, HDF5, AEDAT4 and Prophesee by faery, or text.

    Raises:
        FileError: When there is no such file, or it holds no events.
    """
    if not path.is_file():
        raise FileError(f"{path}: no such file; give a recording of events")
    with path.open("rb") as file:
        head = file.read(4096)
    if head.startswith(_SIGNATURE):
        made = _read_event_stream(path)
    elif head.startswith(_HDF5):
        made = _read_hdf5(path)
    elif path.suffix.lower() in FAERY_SUFFIXES:
        made = _read_with_faery(path)
    else:
        made = _read_text(path, head)
    if len(made.events.t_us) == 0:
        raise FileError(f"{path}: holds no events; give a recording with at least one")
    return made


def read_calibration(path: Path, size_px: tuple[int, int]) -> RadTan:
    """A lens from one line of text, `fx fy cx cy k1 k2 p1 p2 k3` [px].

    Raises:
        FileError: When the file is none of these.
    """
    row = _numbers(path, (4, 8, 9), "fx fy cx cy k1 k2 p1 p2 k3")
    d = np.concatenate([row[4:], np.zeros(9 - len(row))])
    if d[4] != 0.0:
        raise FileError(f"{path}: k3 is {d[4]:g}; only lenses with k3 = 0 can be used")
    fx, fy, cx, cy = (float(v) for v in row[:4])
    try:
        return RadTan(
            size_px=size_px, focal_px=(fx, fy), center_px=(cx, cy),
            distortion=(float(d[0]), float(d[1]), float(d[2]), float(d[3])),
        )  # fmt: skip
    except ValueError as error:
        raise FileError(f"{path}: {error}") from error


def read_rate(path: Path) -> Array:
    """The camera's mean angular rate from one line of text, `wx wy wz` in C axes [rad/s]: (3,).

    Raises:
        FileError: When the file is none of these.
    """
    return _numbers(path, (3,), "wx wy wz")


def _numbers(path: Path, lengths: tuple[int, ...], layout: str) -> Array:
    if not path.is_file():
        raise FileError(f"{path}: no such file; give one line `{layout}`")
    try:
        row = np.array(path.read_text("utf-8").split(), dtype=np.float64)
    except (ValueError, UnicodeDecodeError):
        row = np.array([np.nan])
    if len(row) not in lengths or not np.all(np.isfinite(row)):
        raise FileError(f"{path}: expected one line of numbers, `{layout}`")
    return row


def _reading(t_us: Numbers, x: Numbers, y: Numbers, on: Numbers) -> EventReading:
    p = np.where(on, 1, -1).astype(np.int8)
    return EventReading(t_us.astype(np.int64), x.astype(np.int16), y.astype(np.int16), p)


def _read_text(path: Path, head: bytes) -> Recording:
    if b"\0" in head:
        raise FileError(f"{path}: a binary file of no known kind; give `t x y p` text, .es, .h5 or "
                        f"{', '.join(FAERY_SUFFIXES)}")  # fmt: skip
    if not head.strip():
        raise FileError(f"{path}: the file is empty; give a recording of events")
    try:
        rows = np.loadtxt(path, dtype=np.float64, ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise FileError(f"{path}: no `t x y p` text: {reason}") from error
    if rows.shape[1] != 4:
        raise FileError(f"{path}: {rows.shape[1]} numbers a line; an event is `t x y p`")
    t, x, y, p = rows.T
    whole = np.array_equal(rows[:, 1:], np.round(rows[:, 1:])) and np.all(np.isfinite(t))
    if not whole or min(x.min(), y.min()) < 0 or max(x.max(), y.max()) > 4096:
        raise FileError(f"{path}: x, y, p must be whole and x, y pixels of an image (0 to 4096)")
    if not np.all(np.isin(p, (-1, 0, 1))):
        raise FileError(
            f"{path}: p must be 0 or 1 (or -1 or 1), got {p[~np.isin(p, (-1, 0, 1))][0]:g}"
        )
    if np.any(np.diff(t) < 0.0):
        raise FileError(f"{path}: times fall at line {int(np.argmax(np.diff(t) < 0.0)) + 2}; "
                        "events come in order of time")  # fmt: skip
    events = _reading(np.round(t * US_PER_S), x, y, p > 0)
    return Recording(events, int(x.max()) + 1, int(y.max()) + 1)


def _read_hdf5(path: Path) -> Recording:
    """HDF5 as DSEC lays it out, and as `skyhaul record` writes it: `events/t`, `x`, `y`, `p`."""
    try:
        with h5py.File(path, "r") as file:
            t, x, y, p = (np.asarray(file[f"events/{name}"]) for name in "txyp")
            begin_us = int(file["t_offset"][()]) if "t_offset" in file else 0
            size = [int(file.attrs.get(name, 0)) for name in ("width", "height")]
    except (OSError, KeyError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise FileError(
            f"{path}: no events in HDF5 as `skyhaul record` or DSEC write them (events/t, x, y, p; "
            f"gzip or none): {reason}"
        ) from error
    if not len(t) == len(x) == len(y) == len(p):
        raise FileError(f"{path}: events/t, x, y and p differ in length")
    if np.any(np.diff(t.astype(np.int64)) < 0):
        raise FileError(f"{path}: times fall; events come in order of time")
    events = _reading(t.astype(np.int64) + begin_us, x, y, p > 0)
    if not len(t):
        return Recording(events, *size)
    return Recording(events, max(size[0], int(x.max()) + 1), max(size[1], int(y.max()) + 1))


def _read_event_stream(path: Path) -> Recording:
    """Event Stream version 2 with DVS events.

    After `Event Stream`, three bytes of version, one of type, width and height (u16): of each
    event one byte with the time since the one before in its upper 7 bits (all ones: 127 us more
    and no event) and the polarity in its lowest, then x and y (u16). Its y points up.
    """
    data = np.fromfile(path, np.uint8)
    if len(data) < _HEADER_BYTES or data[12] != 2 or data[15] != _DVS:
        raise FileError(f"{path}: only Event Stream version 2 with DVS events can be read")
    width, height = (int(v) for v in data[16:20].view("<u2"))
    room = tuple(np.empty(len(data) // 5 + 1, np.int64) for _ in range(4))
    n = _decode_dvs(data[_HEADER_BYTES:], *room)
    t, x, y, on = (a[: max(n, 0)] for a in room)
    if n < 0 or (n and (x.max() >= width or y.max() >= height)):
        raise FileError(f"{path}: the Event Stream is cut off or damaged")
    return Recording(_reading(t, x, height - 1 - y, on), width, height)


@njit
def _decode_dvs(
    data: NDArray[np.uint8], t: IntArray, x: IntArray, y: IntArray, on: IntArray
) -> int:
    """Events into the arrays; how many, or -1 if the last one is cut off."""
    at, now, n = 0, 0, 0
    while at < data.shape[0]:
        since = data[at] >> 1
        if since == _OVERFLOW:
            now += _OVERFLOW
            at += 1
            continue
        if at + 5 > data.shape[0]:
            return -1
        now += since
        t[n], on[n] = now, data[at] & 1
        x[n] = data[at + 1] + 256 * np.int64(data[at + 2])
        y[n] = data[at + 3] + 256 * np.int64(data[at + 4])
        at += 5
        n += 1
    return n


def _read_with_faery(path: Path) -> Recording:
    try:
        import faery
    except ImportError as error:
        raise FileError(
            f"{path}: reading {path.suffix} needs `pip install skyhaul[recordings]`"
        ) from error
    try:
        stream = faery.events_stream_from_file(path)
        width, height = stream.dimensions()
        rows = stream.to_array()
    except Exception as error:
        reason = " ".join(str(error).split())
        raise FileError(f"{path}: faery cannot read it: {reason}") from error
    t = rows["t"].astype(np.int64)
    return Recording(_reading(t, rows["x"], rows["y"], rows["on"]), int(width), int(height))
