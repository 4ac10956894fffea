# SPDX-License-Identifier: Apache-2.0
"""`flight.png`: the whole flight in one picture."""

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyhaul.errors import FileError
from skyhaul.evaluation.folder import FIGURE
from skyhaul.evaluation.series import Run
from skyhaul.evaluation.stage import Look, Stage
from skyhaul.whole import whole

WIDTH, HEIGHT = 1600, 1000
"""Size of the picture [px]."""


def write_figure(run: Run, exposures: int = 7) -> Path:
    """Draw the flight with the team at several times of its way; returns the file.

    Raises:
        FileError: when the run has no rows.
    """
    if not len(run.t_s):
        raise FileError(f"{run.folder} holds no rows to draw: the run ended at once")
    stage = Stage(run)
    look = Look(exposures=exposures, plan=False, line_px=2.0)
    image = stage.draw(len(run.t_s) - 1, stage.overview(), WIDTH, HEIGHT, look)
    path = run.folder / FIGURE
    with whole(path) as part:
        part.write_bytes(png(image.pixels()))
    return path


def png(pixels: NDArray[np.uint8]) -> bytes:
    """A PNG file of (height, width, 3) bytes."""
    height, width, _ = pixels.shape
    rows = pixels.reshape(height, 3 * width)
    data = np.concatenate([np.zeros((height, 1), dtype=np.uint8), rows], axis=1).tobytes()
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(data, 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )
