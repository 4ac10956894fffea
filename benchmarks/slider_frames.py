# SPDX-License-Identifier: Apache-2.0
"""The slider_depth recording of a DAVIS240: frames, events, and frames in between along the flow.

Source: Mueggler et al., The event-camera dataset and simulator, IJRR 2017.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from skyhaul.sensors.api import EventReading
from skyhaul.sensors.events.kernel import View
from skyhaul.sensors.events.pixels import EventPixels
from skyhaul.types import Array, IntArray

BLACK_LEVEL = 5.0
"""Added to every grey value: the frames are clipped at black, their darkest texture is a few."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames, and the events of the first of them."""

    frame_us: IntArray  # (f,)
    frames: NDArray[np.float32]  # (f, 180, 240) grey
    events: EventReading


def data_folder() -> Path:
    """Where the recordings are: `SKYHAUL_DATA`, by default beside the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    return Path(os.environ.get("SKYHAUL_DATA", beside)) / "slider_depth"


def load_recording(folder: Path) -> Recording:
    """Read the recording."""
    listed = [line.split() for line in (folder / "images.txt").read_text("utf-8").splitlines()]
    frames = [cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE) for _, name in listed]
    t, x, y, p = np.loadtxt(folder / "events_chunk.txt").T
    events = EventReading(
        np.round(1e6 * t).astype(np.int64),
        x.astype(np.int16),
        y.astype(np.int16),
        np.where(p > 0.0, 1, -1).astype(np.int8),
    )
    frame_us = np.round(1e6 * np.array([float(s) for s, _ in listed])).astype(np.int64)
    return Recording(frame_us, np.array(frames, dtype=np.float32), events)


def view_of(frame: NDArray[np.float32]) -> View:
    """A frame as pixels see it: full scale is intensity 1, everything is one surface."""
    light = (frame / np.float32(255.0)).ravel()
    return View(light, np.zeros(light.size, np.int16), np.ones(light.size))


def frames_between(
    before: NDArray[np.float32], after: NDArray[np.float32], count: int
) -> list[NDArray[np.float32]]:
    """`count` frames that end with `after`: both warped along the flow between them, blended."""
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    bright = [np.clip(1.9 * f, 0.0, 255.0).astype(np.uint8) for f in (before, after)]
    forth, back = flow.calc(bright[0], bright[1], None), flow.calc(bright[1], bright[0], None)
    y, x = np.mgrid[0 : before.shape[0], 0 : before.shape[1]].astype(np.float32)
    out = []
    for s in (np.arange(1, count) / count).tolist():
        a = _warped(before, x - s * forth[..., 0], y - s * forth[..., 1])
        b = _warped(after, x - (1.0 - s) * back[..., 0], y - (1.0 - s) * back[..., 1])
        out.append(np.asarray((1.0 - s) * a + s * b, dtype=np.float32))
    return [*out, after]


def _warped(
    frame: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32]
) -> NDArray[np.float32]:
    warped = cv2.remap(frame, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, dtype=np.float32)


def simulate(
    params: EventPixels, frames: Iterator[tuple[int, NDArray[np.float32]]]
) -> EventReading:
    """Events of pixels that look at frames one after the other."""
    t_us, first = next(frames)
    width = first.shape[1]
    memory = params.init(view_of(first), width, t_us, np.random.default_rng(0))
    parts = []
    for t_us, frame in frames:
        memory, reading, _ = params.step(memory, view_of(frame), t_us)
        parts.append(reading)
    columns = ([getattr(r, key) for r in parts] for key in ("t_us", "x", "y", "p"))
    return EventReading(*(np.concatenate(c) for c in columns))


def net_count(events: EventReading, begin_us: int, end_us: int) -> Array:
    """ON minus OFF events of each pixel in [begin, end), (180, 240)."""
    inside = (events.t_us >= begin_us) & (events.t_us < end_us)
    net = np.zeros((180, 240))
    np.add.at(net, (events.y[inside], events.x[inside]), events.p[inside])
    return net
