# SPDX-License-Identifier: Apache-2.0
"""Drops events that no edge caused: background noise, flickering lights, the image at start."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit
from skyhaul.params import Params
from skyhaul.sensors.api import EventReading
from skyhaul.types import US_PER_S, IntArray

KEPT, NOISE, FLICKER, FLASH = 0, 1, 2, 3
"""Why an event was kept or dropped."""

_NEVER = -(2**62)
_PERIOD_TOLERANCE = 0.1


class FilterMemory(NamedTuple):
    """Of every pixel, (height, width); moved on in place."""

    last_us: IntArray  # newest event
    rise_us: IntArray  # newest change from OFF to ON
    period_us: IntArray  # between the two newest of these
    repeats: IntArray  # how often in a row it was about the same
    polarity: NDArray[np.int8]  # of the newest event


@dataclass(frozen=True, kw_only=True)
class NoiseFilter(Params):
    """What passes: events with a fresh neighbour, at pixels that do not flicker."""

    support_us: int = 5_000
    """One of the eight pixels around must have fired within this time [us]; 0 keeps all."""
    flicker_hz: tuple[float, float] = (70.0, 500.0)
    """Lowest and highest frequency of lights that are dropped [Hz]."""
    flicker_repeats: int = 4
    """Periods in a row, within 10 %, that make a flicker; 0 keeps all."""
    flash_fraction: float = 0.25
    """Events of one stamp at more than this share of the pixels are an image, not edges."""

    def __post_init__(self) -> None:
        low, high = self.flicker_hz
        if not 0.0 < low < high:
            raise ValueError(f"flicker_hz must rise and be > 0, got {self.flicker_hz}")
        if min(self.support_us, self.flicker_repeats) < 0:
            raise ValueError("support_us and flicker_repeats must be >= 0")
        if not 0.0 < self.flash_fraction <= 1.0:
            raise ValueError(f"flash_fraction must lie in (0, 1], got {self.flash_fraction}")

    def init(self, width: int, height: int) -> FilterMemory:
        """Memory before the first event."""
        shape = (height, width)
        never = np.full(shape, _NEVER)
        zero = np.zeros(shape, np.int64)
        return FilterMemory(never, never.copy(), zero, zero.copy(), np.zeros(shape, np.int8))

    def step(
        self, memory: FilterMemory, events: EventReading
    ) -> tuple[FilterMemory, NDArray[np.int8]]:
        """Why each event is kept or dropped, (k,); the memory is moved on in place."""
        low, high = self.flicker_hz
        why = np.empty(len(events.t_us), np.int8)
        limits = (
            self.support_us,
            int(US_PER_S / high),
            int(US_PER_S / low),
            self.flicker_repeats,
            int(self.flash_fraction * memory.last_us.size),
        )
        _filter(events.t_us, events.x, events.y, events.p, memory, limits, why)
        return memory, why


def chosen(events: EventReading, keep: NDArray[np.bool_]) -> EventReading:
    """Some of the events."""
    return EventReading(events.t_us[keep], events.x[keep], events.y[keep], events.p[keep])


@njit
def _filter(
    t_us: IntArray,
    x: NDArray[np.int16],
    y: NDArray[np.int16],
    p: NDArray[np.int8],
    memory: FilterMemory,
    limits: tuple[int, int, int, int, int],
    why: NDArray[np.int8],
) -> None:
    support_us, shortest, longest, repeats, flash = limits
    stamp_end, is_flash = 0, False
    for i in range(t_us.shape[0]):
        if i == stamp_end:
            while stamp_end < t_us.shape[0] and t_us[stamp_end] == t_us[i]:
                stamp_end += 1
            is_flash = stamp_end - i > flash
        if is_flash:
            why[i] = FLASH
            continue
        flickers = _flickers(memory, t_us[i], x[i], y[i], p[i], shortest, longest, repeats)
        supported = support_us == 0 or _is_supported(
            memory.last_us, t_us[i], x[i], y[i], support_us
        )
        memory.last_us[y[i], x[i]] = t_us[i]
        why[i] = FLICKER if flickers else (KEPT if supported else NOISE)


@njit
def _is_supported(last_us: IntArray, t: int, x: int, y: int, support_us: int) -> bool:
    """Whether one of the eight pixels around has fired just before."""
    for v in range(max(y - 1, 0), min(y + 2, last_us.shape[0])):
        for u in range(max(x - 1, 0), min(x + 2, last_us.shape[1])):
            if (u != x or v != y) and t - last_us[v, u] <= support_us:
                return True
    return False


@njit
def _flickers(
    memory: FilterMemory, t: int, x: int, y: int, p: int, shortest: int, longest: int, repeats: int
) -> bool:
    """Whether the pixel has risen at one period for long enough; notes the event."""
    if p > 0 and memory.polarity[y, x] <= 0:
        period, before = t - memory.rise_us[y, x], memory.period_us[y, x]
        same = abs(period - before) <= _PERIOD_TOLERANCE * period
        in_band = shortest <= period and period <= longest
        memory.repeats[y, x] = memory.repeats[y, x] + 1 if same and in_band else 0
        memory.period_us[y, x] = period
        memory.rise_us[y, x] = t
    memory.polarity[y, x] = p
    fresh = t - memory.rise_us[y, x] <= longest
    return repeats > 0 and fresh and memory.repeats[y, x] >= repeats
