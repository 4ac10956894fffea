# SPDX-License-Identifier: Apache-2.0
"""Files that are whole or not there."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Where to write a file: it gets its name at the end, and nothing is left if that fails.

    A reader, also after an interrupt, finds the file that was there before or the new one.
    """
    part = path.with_name(path.name + ".part")
    try:
        yield part
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
