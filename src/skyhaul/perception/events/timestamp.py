# SPDX-License-Identifier: Apache-2.0
"""`kind: timestamp`: movers by the mean time of the events at each pixel, camera turn removed.

Events of a window are moved to where the camera sees them now. Where something stands, its edge
has fired there throughout, and the mean time of a pixel is that of the window; where something has
just come, it is newer:

    rho = (mean time around the pixel - mean time of the window) / window

and an event in a place with rho above a threshold, which grows with the camera's rate, is a
mover's.

Source:    Falanga, Kleber and Scaramuzza, "Dynamic obstacle avoidance for quadrotors with event
    cameras" (Science Robotics 2020); Mitrokhin et al., "Event-based moving object detection and
    tracking" (IROS 2018). Our own words and code.
Deviation: They judge every event of a window at its end; we judge the events of the newest reading
    in the window that ends with it, so that a mover's events are all in its newest part.
Limits:    Needs no training, and knows rotation only: what is near and stands moves in the image
    as the camera flies by, and is called a mover. What moves less than a few pixels per window, or
    the inside of what is textured and large, is missed.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.ndimage import uniform_filter

from skyhaul.params import Params
from skyhaul.perception.events.api import EventScores, Float32, Work
from skyhaul.perception.events.lens import EventLens
from skyhaul.perception.events.rotation import derotated
from skyhaul.sensors.api import EventReading
from skyhaul.types import US_PER_S, Array, IntArray


@dataclass(frozen=True, eq=False)
class WindowMemory:
    """Events of the window so far."""

    lens: EventLens
    events: EventReading
    turn_C: Array  # (k, 3) [rad]
    begin_us: int | None = None  # first event of all
    done: Work = field(default_factory=Work)


@dataclass(frozen=True, kw_only=True)
class TimestampParams(Params):
    """Window and thresholds of the recipe."""

    kind: Literal["timestamp"] = "timestamp"
    window_us: int = 30_000
    """Length of the window [us]."""
    blur_px: int = 2
    """Times are averaged over squares that reach so far [px]."""
    prior_count: float = 6.0
    """So many events at the window's mean time are added to each square: few tell little."""
    threshold: float = 0.1
    """Smallest rho of a mover while the camera does not turn."""
    threshold_per_radps: float = 0.02
    """What each rad/s of the camera's rate adds to it."""
    softness: float = 0.03
    """Change of rho that takes the probability from 1/2 to 0.73."""
    cell_px: int = 16
    """Edge of the cells of `EventScores.objectness` [px]."""

    def __post_init__(self) -> None:
        for name in ("window_us", "blur_px", "prior_count", "softness", "cell_px"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not 0.0 < self.threshold < 0.5:
            raise ValueError(f"threshold must lie in (0, 0.5), got {self.threshold}")
        if self.threshold_per_radps < 0.0:
            raise ValueError(f"threshold_per_radps must be >= 0, got {self.threshold_per_radps}")

    def init(self, lens: EventLens) -> WindowMemory:
        """See `EventClassifier.init`."""
        none = np.zeros(0, np.int64)
        empty = EventReading(
            none, none.astype(np.int16), none.astype(np.int16), none.astype(np.int8)
        )
        return WindowMemory(lens, empty, np.zeros((0, 3)))

    def step(
        self,
        memory: WindowMemory,
        events: EventReading,
        turn_C: Array,
        v_WC_C: Array | None = None,
    ) -> tuple[WindowMemory, EventScores]:
        """See `EventClassifier.step`; a reading of some 10 ms is what it judges best.

        The camera's velocity is not used.
        """
        k, lens = len(events.t_us), memory.lens
        shape = (-(-lens.height // self.cell_px), -(-lens.width // self.cell_px))
        if k == 0:
            newest = int(memory.events.t_us[-1]) if len(memory.events.t_us) else 0
            none = np.zeros(0, np.float32)
            return memory, EventScores(newest, none, np.zeros(shape, np.float32), self.cell_px)
        now = int(events.t_us[-1])
        begin = int(events.t_us[0]) if memory.begin_us is None else memory.begin_us
        window, turns = _joined(memory, events, turn_C, now - self.window_us)
        done = memory.done._replace(events=memory.done.events + k)
        after = WindowMemory(lens, window, turns, begin, done)
        p_mover = np.zeros(k, np.float32)
        if now - begin >= self.window_us // 2:
            p_mover = self._probability(after, min(now - begin, self.window_us), k)
        cells = np.zeros(shape, np.float32)
        np.maximum.at(cells, (events.y // self.cell_px, events.x // self.cell_px), p_mover)
        return after, EventScores(now, p_mover, cells, self.cell_px)

    def work(self, memory: WindowMemory) -> Work:
        """See `EventClassifier.work`."""
        return memory.done

    def _probability(self, memory: WindowMemory, span_us: int, newest: int) -> Float32:
        """Of the newest events of the window."""
        rho = self.normalised_time(memory, span_us)[-newest:]
        turned = memory.turn_C[-1] - memory.turn_C[0]
        held_us = max(int(memory.events.t_us[-1] - memory.events.t_us[0]), 1)
        rate = float(np.linalg.norm(turned)) * US_PER_S / held_us
        threshold = self.threshold + self.threshold_per_radps * rate
        p: Array = 1.0 / (1.0 + np.exp(-(rho - threshold) / self.softness))
        return p.astype(np.float32)

    def normalised_time(self, memory: WindowMemory, span_us: int) -> Array:
        """Rho of every event of the window, (k,); -0.5 outside the image."""
        lens, events = memory.lens, memory.events
        uv = derotated(lens, events, memory.turn_C, memory.turn_C[-1])
        pixel = np.where(np.isfinite(uv), np.round(uv), -1.0).astype(np.int64)
        inside = np.all((pixel >= 0) & (pixel < [lens.width, lens.height]), axis=1)
        since = (events.t_us - events.t_us[-1]) / span_us
        flat = pixel[:, 1] * lens.width + pixel[:, 0]
        shape, size = (lens.height, lens.width), 2 * self.blur_px + 1
        count = self._blurred(flat[inside], np.ones(int(inside.sum())), shape, size)
        total = self._blurred(flat[inside], since[inside], shape, size)
        rho, here = np.full(len(since), -0.5), flat[inside]
        off = total[here] - count[here] * since[inside].mean()
        rho[inside] = off / (count[here] + self.prior_count)
        return rho

    @staticmethod
    def _blurred(flat: IntArray, weight: Array, shape: tuple[int, int], size: int) -> Array:
        """Sums over the squares around the pixels, (height * width,)."""
        image = np.bincount(flat, weight, minlength=shape[0] * shape[1]).reshape(shape)
        sums = np.asarray(uniform_filter(image, size, mode="constant"), dtype=np.float64)
        flat_sums: Array = sums.ravel() * size**2
        return flat_sums


def _joined(
    memory: WindowMemory, events: EventReading, turn_C: Array, from_us: int
) -> tuple[EventReading, Array]:
    """The window with new events and without those before a time."""
    old = memory.events
    keep = slice(int(np.searchsorted(old.t_us, from_us)), None)
    window = EventReading(
        np.concatenate([old.t_us[keep], events.t_us]),
        np.concatenate([old.x[keep], events.x]),
        np.concatenate([old.y[keep], events.y]),
        np.concatenate([old.p[keep], events.p]),
    )
    return window, np.concatenate([memory.turn_C[keep], turn_C])
