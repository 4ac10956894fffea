# SPDX-License-Identifier: Apache-2.0
"""Event files: HDF5 as DSEC lays it out, and the text `t x y p` of the ijrr recordings."""

from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, TextIO

import h5py
import numpy as np
from numpy.typing import NDArray

from skyhaul.errors import FileError
from skyhaul.evaluation.dataset.layout import EVENTS_H5, EVENTS_TXT, LABELS_H5
from skyhaul.sensors.api import EventReading
from skyhaul.sensors.truth_api import EventLabels, LabelName
from skyhaul.types import US_PER_S

_CHUNK = 1 << 16
_BLOCK = 1 << 22
"""By which a file in memory grows [bytes]."""


class EventsWriter:
    """Writes `events.h5`, `events.txt` and, apart, `events_labels.h5`.

    `events/x`, `/y` (uint16), `/t` (int64, us), `/p` (uint8, 1 ON, 0 OFF), all of one length;
    `ms_to_idx[k]` is the first event at or after k ms; `t_offset` is 0. Labels: `object_id` of each
    event, and what it means: `ids`, with `names` and `kinds` in the same order. HDF5 files are
    kept in memory, compressed, and written at the end.
    """

    def __init__(
        self, folder: Path, size_px: tuple[int, int], labels: Sequence[LabelName] = ()
    ) -> None:
        """Make the files.

        Args:
            folder: Where to.
            size_px: Columns and rows of the camera.
            labels: What the labels mean.
        """
        with ExitStack() as files:
            self._events = files.enter_context(closing(_in_memory(folder / EVENTS_H5)))
            self._labels = files.enter_context(closing(_in_memory(folder / LABELS_H5)))
            text = (folder / EVENTS_TXT).open("w", encoding="ascii")
            self._text: TextIO = files.enter_context(text)
            self._begin(size_px, labels)
            self._files = files.pop_all()

    def _begin(self, size_px: tuple[int, int], labels: Sequence[LabelName]) -> None:
        self._events.attrs["width"], self._events.attrs["height"] = size_px
        for name, dtype in (("x", "u2"), ("y", "u2"), ("t", "i8"), ("p", "u1")):
            _growing(self._events, f"events/{name}", dtype)
        self._events["t_offset"] = np.int64(0)
        _growing(self._labels, "object_id", "i2")
        self._labels["ids"] = np.array([label.id for label in labels], dtype=np.int16)
        for key, words in (
            ("names", [label.name for label in labels]),
            ("kinds", [label.kind for label in labels]),
        ):
            self._labels.create_dataset(key, data=words, dtype=h5py.string_dtype())
        self._counts: list[int] = []
        self._n = 0

    def add(self, events: EventReading, labels: EventLabels) -> None:
        """Append the events of a reading."""
        on = (events.p > 0).astype(np.uint8)
        _append(self._events["events/x"], events.x)
        _append(self._events["events/y"], events.y)
        _append(self._events["events/t"], events.t_us)
        _append(self._events["events/p"], on)
        _append(self._labels["object_id"], labels.object_id)
        self._index(events.t_us)
        rows = zip(events.t_us.tolist(), events.x.tolist(), events.y.tolist(), on.tolist(),
                   strict=True)  # fmt: skip
        self._text.writelines(
            f"{t // US_PER_S}.{t % US_PER_S:06d} {x} {y} {p}\n" for t, x, y, p in rows
        )

    def close(self) -> None:
        """Write and close the files; they are closed whatever the disk says.

        Raises:
            OSError: When the disk refuses.
        """
        with self._files:
            self._events["ms_to_idx"] = np.array(self._counts, dtype=np.uint64)
            for file in (self._events, self._labels):
                file.flush()
                Path(file.filename).write_bytes(file.id.get_file_image())

    def _index(self, t_us: NDArray[np.int64]) -> None:
        """Note where each millisecond begins, up to the last event."""
        if len(t_us):
            first = len(self._counts)
            marks = 1000 * np.arange(first, int(t_us[-1]) // 1000 + 1)
            self._counts += (self._n + np.searchsorted(t_us, marks)).tolist()
        self._n += len(t_us)


def read_events(path: Path) -> EventReading:
    """All events of an HDF5 file.

    Raises:
        FileError: When it is missing or holds no events.
    """
    try:
        with h5py.File(path, "r") as file:
            t_us = file["events/t"][:].astype(np.int64)
            if "t_offset" in file:
                t_us += int(file["t_offset"][()])
            p = np.where(file["events/p"][:] > 0, 1, -1).astype(np.int8)
            x, y = file["events/x"][:].astype(np.int16), file["events/y"][:].astype(np.int16)
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except (OSError, KeyError) as fault:
        raise FileError(f"{path} holds no events as events/x, y, t, p: {fault}") from fault
    return EventReading(t_us, x, y, p)


def _in_memory(path: Path) -> Any:  # noqa: ANN401
    """An HDF5 file that is not on the disk yet: HDF5 crashes where a disk is full."""
    return h5py.File(path, "w", driver="core", backing_store=False, block_size=_BLOCK)


def _growing(file: Any, name: str, dtype: str) -> None:  # noqa: ANN401  h5py is not typed
    file.create_dataset(
        name, (0,), dtype=dtype, maxshape=(None,), chunks=(_CHUNK,), compression="gzip",
        compression_opts=1, shuffle=True,
    )  # fmt: skip


def _append(dataset: Any, values: NDArray[Any]) -> None:  # noqa: ANN401
    n = len(dataset)
    dataset.resize(n + len(values), axis=0)
    dataset[n:] = values
