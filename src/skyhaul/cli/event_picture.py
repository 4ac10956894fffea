# SPDX-License-Identifier: Apache-2.0
"""Events as pictures: movers and tracks over all events, as a video or, without PyAV, a PNG."""

from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyhaul.errors import FileError
from skyhaul.evaluation.figures import png
from skyhaul.perception.events.lens import EventLens
from skyhaul.perception.obstacles.watch import Watched
from skyhaul.whole import whole

Pixels = NDArray[np.uint8]

GROUND, STANDS, MOVES, BOX = (18, 20, 26), (120, 130, 145), (255, 120, 40), (70, 220, 255)
SCALE = 2
RATE_HZ = 25
SHOWN_IN_PNG = 6
PNG_COLUMNS = 3
GAP, BETWEEN = 3, 70


def write_picture(folder: Path, lens: EventLens, steps: list[Watched]) -> Path:
    """Write `movers.mp4`, or `movers.png` with some of its frames; returns the file.

    Raises:
        FileError: When the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if find_spec("av") is not None:
            return _write_video(folder / "movers.mp4", lens, steps)
        return write_frames(folder / "movers.png", lens, steps)
    except OSError as error:
        raise FileError(f"{folder}: cannot be written: {error.strerror}") from error


def write_frames(path: Path, lens: EventLens, steps: list[Watched]) -> Path:
    """Some frames, evenly spread over the recording, in one PNG."""
    count = min(SHOWN_IN_PNG, len(steps))
    which = np.linspace(0, len(steps) - 1, count + 1).round().astype(int)[1:] if count > 1 else [0]
    edge = ((GAP, GAP), (GAP, GAP), (0, 0))
    frames = [np.pad(frame(lens, steps[i]), edge, constant_values=BETWEEN) for i in which]
    frames += [np.zeros_like(frames[0])] * (-len(frames) % PNG_COLUMNS)
    rows = [np.hstack(frames[i : i + PNG_COLUMNS]) for i in range(0, len(frames), PNG_COLUMNS)]
    with whole(path) as part:
        part.write_bytes(png(np.ascontiguousarray(np.vstack(rows))))
    return path


def frame(lens: EventLens, step: Watched) -> Pixels:
    """One step: what stands grey, what moves orange, boxes of confirmed tracks blue."""
    image = np.empty((lens.height, lens.width, 3), dtype=np.uint8)
    image[:] = GROUND
    moves = step.scores.mover
    for which, colour in ((~moves, STANDS), (moves, MOVES)):
        image[step.kept.y[which], step.kept.x[which]] = colour
    large: Pixels = np.repeat(np.repeat(image, SCALE, axis=0), SCALE, axis=1)
    tracks = step.tracks
    for i in np.flatnonzero(tracks.confirmed):
        _draw_box(large, SCALE * tracks.middle[i], SCALE * tracks.half_size[i])
    return large[: large.shape[0] // 2 * 2, : large.shape[1] // 2 * 2]


def _draw_box(image: Pixels, middle: NDArray[np.float64], half: NDArray[np.float64]) -> None:
    height, width = image.shape[:2]
    x0, y0 = np.clip(np.round(middle - half), 0, [width - 2, height - 2]).astype(int)
    x1, y1 = np.clip(np.round(middle + half), 1, [width - 1, height - 1]).astype(int)
    for y in (y0, y1):
        image[y : y + 2, x0 : x1 + 1] = BOX
    for x in (x0, x1):
        image[y0 : y1 + 1, x : x + 2] = BOX


def _write_video(path: Path, lens: EventLens, steps: list[Watched]) -> Path:
    """One frame per step: a step of 10 ms is shown for 40 ms."""
    import av

    with whole(path) as part, av.open(str(part), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(RATE_HZ))
        stream.height, stream.width = frame(lens, steps[0]).shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "21", "preset": "veryfast"}
        for step in steps:
            picture = np.ascontiguousarray(frame(lens, step))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return path
