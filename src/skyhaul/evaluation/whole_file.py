# SPDX-License-Identifier: Apache-2.0
"""A file that takes each write as a whole or not at all."""

import os
from pathlib import Path

from skyhaul.errors import FileError


class WholeFile:
    """A new file, written without a buffer; what the disk refuses leaves it as it was."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._end = 0
        self._tail = b""
        self.refused = False
        try:
            self._file = path.open("wb", buffering=0)
        except OSError as fault:
            raise self._fault(fault) from fault

    def write(self, data: bytes) -> int:
        """Append data.

        Raises:
            FileError: When the disk refuses; the file then is as it was before.
        """
        self._replace(data)
        self._end += len(data)
        return len(data)

    def write_with_tail(self, data: bytes, tail: bytes) -> None:
        """Append data before the tail, and put a new tail in the place of the old one.

        It is one system call: a process that is killed outside of it leaves either the file
        before or the file after.

        Raises:
            FileError: When the disk refuses; the file then is as it was before.
        """
        self._replace(data + tail)
        self._end += len(data)
        self._tail = tail

    def tell(self) -> int:
        """Where the next write goes [byte]."""
        return self._end

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Close the file; it has been whole before."""
        self._file.close()

    def _replace(self, data: bytes) -> None:
        """Write over the tail and on."""
        view = memoryview(data)
        try:
            self._file.seek(self._end)
            while len(view):
                view = view[self._file.write(view) :]
        except OSError as fault:
            self.refused = True
            self._restore()
            raise self._fault(fault) from fault

    def _restore(self) -> None:
        """Put the old tail back; its place on the disk is there already."""
        self._file.seek(self._end)
        self._file.write(self._tail)
        self._file.truncate(self._end + len(self._tail))

    def _fault(self, fault: OSError) -> FileError:
        why = os.strerror(fault.errno) if fault.errno else str(fault)
        return FileError(f"{self._path} cannot be written: {why}")
