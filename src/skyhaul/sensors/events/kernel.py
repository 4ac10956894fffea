# SPDX-License-Identifier: Apache-2.0
"""All pixels of an event camera from one rendering to the next.

Most pixels do nothing between two renderings. What they see stays between its values at both ends
(the low-pass never overshoots), which tells so without a search; the others are walked, `pixel`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit_ieee
from skyhaul.sensors.events.curve import curve_between
from skyhaul.sensors.events.pixel import Interval, PixelLaw, Trait, Watch, begin, next_event
from skyhaul.types import Array, IntArray

_ROOM = 8192  # events
_NOTHING = 1e-6  # in log intensity

Floats = NDArray[np.float32]


class PixelTraits(NamedTuple):
    """What differs from pixel to pixel and never changes; row by row, k = row * width + column."""

    on: Array  # (k,) threshold of ON events, in log intensity
    off: Array  # (k,) threshold of OFF events, > 0
    leak: Array  # (k,) drift of z against the reference [1/us]
    hot: Array  # (k,) rate at which a hot pixel fires by itself [1/us]


class PixelState(NamedTuple):
    """What a pixel remembers; (k,) each."""

    low_pass: Floats  # y at the last rendering
    reference: Array  # z when the last reset ended
    free_us: Array  # when that was
    noise_us: Array  # when noise may fire next
    draws: IntArray  # random numbers used
    cause: NDArray[np.int16]  # surface that came or went last
    owed: Floats  # how much of u - y is still owed to that


class Pixels(NamedTuple):
    """All pixels of a camera."""

    state: PixelState
    traits: PixelTraits
    law: PixelLaw


class View(NamedTuple):
    """One rendering, row by row; (k,) each."""

    light: Floats  # intensity, 0 to 1
    surface: NDArray[np.int16]  # label of what is seen
    depth: Array  # of it [m]


class Change(NamedTuple):
    """What happens between two renderings; (k,) each."""

    u0: Floats  # log intensity at the first
    u1: Floats  # log intensity at the second
    rate: Floats  # time between them in time constants of the low-pass; infinite without one
    decay: Floats  # exp(-rate)


class Fired(NamedTuple):
    """Events, pixel by pixel, in order of time for each."""

    t_us: IntArray
    pixel: NDArray[np.int32]
    polarity: NDArray[np.int8]
    label: NDArray[np.int16]


@njit_ieee
def advance(
    pixels: Pixels, before: View, now: View, change: Change, t0_us: int, t1_us: int
) -> Fired:
    """Events of all pixels between two renderings.

    Args:
        pixels: Their state is that at t0; it is moved on to t1, in place.
        before: The rendering at t0.
        now: The rendering at t1.
        change: Log intensities and low-pass between them.
        t0_us: Time of the rendering before [us].
        t1_us: Time of this rendering [us].

    Returns:
        The events, with stamps in [t0_us, t1_us].
    """
    low_pass, reference, free_us, noise_us, draws, cause, owed = pixels.state
    traits_on, traits_off, traits_leak, traits_hot = pixels.traits
    was, now_surface, light = before.surface, now.surface, now.light
    was_depth, depth = before.depth, now.depth
    all_u0, all_u1, rates, decays = change
    t_us, pixel, polarity, labels = _room(_ROOM)
    n, dt = 0, float(t1_us - t0_us)
    for k in range(reference.shape[0]):
        u0, u1, y0 = np.float64(all_u0[k]), np.float64(all_u1[k]), np.float64(low_pass[k])
        rate, decay, on, off = np.float64(rates[k]), decays[k], traits_on[k], traits_off[k]
        lag = (u1 - u0) / rate
        y1 = u1 - lag + (y0 - u0 + lag) * decay
        low_pass[k] = y1
        label = now_surface[k]
        if was[k] != label:
            label = was[k] if was_depth[k] < depth[k] else label
            cause[k], owed[k] = label, owed[k] * decay + lag * (1.0 - decay)
        elif owed[k] != 0.0:
            label = _cause(owed[k] * (1.0 - decay), y1 - y0, cause[k], label)
            owed[k] = owed[k] * decay if abs(owed[k]) > _NOTHING else 0.0
        leak, free = traits_leak[k], free_us[k] - t0_us
        low = reference[k] + leak * free  # level of z at t0
        free_of_noise = noise_us[k] > t1_us and free < 0.0
        if free_of_noise and _stays(u0, u1, y0, leak * dt, low - off, low + on):
            continue
        trait = Trait(k, on, off, leak, traits_hot[k])
        curve = curve_between(u0, u1, y0, leak, dt, dt / rate)
        seen = Interval(curve, dt, light[k], label)
        watch = begin(seen, Watch(0.0, low, free, noise_us[k] - t0_us, draws[k]))
        while True:
            watch, t, sign, event_label = next_event(trait, pixels.law, seen, watch)
            if sign == 0:
                break
            if n == t_us.shape[0]:
                t_us, pixel, polarity, labels = _doubled(t_us, pixel, polarity, labels)
            t_us[n], pixel[n] = t0_us + math.floor(t + 0.5), k
            polarity[n], labels[n] = sign, event_label
            n += 1
        free_us[k], reference[k] = t0_us + watch.free, watch.level - leak * watch.free
        noise_us[k], draws[k] = t0_us + watch.noise, watch.draws
    return Fired(t_us[:n], pixel[:n], polarity[:n], labels[:n])


@njit_ieee
def _stays(u0: float, u1: float, y0: float, drift: float, low: float, high: float) -> bool:
    """Whether what a pixel sees stays between two levels: it never leaves its values at the ends.

    Args:
        u0: Log intensity at the beginning.
        u1: Log intensity at the end.
        y0: Low-pass at the beginning.
        drift: What the leak adds until the end.
        low: Lower level.
        high: Upper level.
    """
    return max(u0, u1, y0) + drift < high and min(u0, u1, y0) > low


@njit_ieee
def _cause(released: float, change: float, cause: int, surface: int) -> int:
    """Which surface changes the low-passed light of a pixel that sees the same one as before.

    Where one surface covers or uncovers another it is the nearer one, whose edge passed; it stays
    the cause while most of the change is the low-pass still following that edge.
    """
    return cause if abs(released) > 0.5 * abs(change) else surface


@njit_ieee
def _room(
    n: int,
) -> tuple[IntArray, NDArray[np.int32], NDArray[np.int8], NDArray[np.int16]]:
    """Space for n events."""
    return np.empty(n, np.int64), np.empty(n, np.int32), np.empty(n, np.int8), np.empty(n, np.int16)


@njit_ieee
def _doubled(
    t_us: IntArray,
    pixel: NDArray[np.int32],
    polarity: NDArray[np.int8],
    label: NDArray[np.int16],
) -> tuple[IntArray, NDArray[np.int32], NDArray[np.int8], NDArray[np.int16]]:
    """The same events in twice the space."""
    n = t_us.shape[0]
    out = _room(2 * n)
    out[0][:n], out[1][:n], out[2][:n], out[3][:n] = t_us, pixel, polarity, label
    return out
