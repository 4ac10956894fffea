# SPDX-License-Identifier: Apache-2.0
"""The pixels of an event camera from one rendering to the next.

A pixel compares z, its low-passed log intensity plus leak (`curve`), with a reference. It fires ON
when z >= reference + on and OFF when z <= reference - off; then it is held in reset for the
refractory period, and what it sees when that ends is the new reference. Without a refractory
period the reference therefore steps by the threshold for each event.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit
from skyhaul.sensors.events.curve import Curve, curve_at, curve_between, first_crossing
from skyhaul.sensors.events.noise import uniform, waiting_time
from skyhaul.types import Array, IntArray

NOISE_LABEL = -1
_MOST_OF_A_PIXEL = 4096  # events of one pixel between two renderings
_NOTHING = 1e-6  # in log intensity

Floats = NDArray[np.float32]


class PixelTraits(NamedTuple):
    """What differs from pixel to pixel and never changes; row by row, k = row * width + column."""

    on: Array  # (k,) threshold of ON events, in log intensity
    off: Array  # (k,) threshold of OFF events, > 0
    leak: Array  # (k,) drift of z against the reference [1/us]
    hot: Array  # (k,) rate at which a hot pixel fires by itself [1/us]


class PixelLaw(NamedTuple):
    """What all pixels share."""

    key: np.uint64  # of the random numbers
    refractory_us: float
    shot: float  # rate of shot noise events in the dark [1/us]
    shot_bright: float  # share of it that is left at intensity 1


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
    depth: Floats  # of it [m]


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


class Interval(NamedTuple):
    """What one pixel sees between two renderings."""

    curve: Curve  # of z - leak (t0 - free), t from t0
    t0_us: int
    dt: float  # [us]
    light: float  # intensity at the end
    label: int  # surface that changes it


@njit
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
    state, traits = pixels.state, pixels.traits
    out, n, dt = _room(2 * _MOST_OF_A_PIXEL), 0, float(t1_us - t0_us)
    for k in range(state.reference.shape[0]):
        u0, u1 = np.float64(change.u0[k]), np.float64(change.u1[k])
        y0, rate = np.float64(state.low_pass[k]), np.float64(change.rate[k])
        decay = np.float64(change.decay[k])
        lag = (u1 - u0) / rate
        y1 = u1 - lag + (y0 - u0 + lag) * decay
        state.low_pass[k] = y1
        label = now.surface[k]
        if before.surface[k] != label or state.owed[k] != 0.0:
            label = _cause(state, before, now, k, decay, y1 - y0, lag)
        if (
            max(u0, u1, y0) + traits.leak[k] * max(t1_us - state.free_us[k], 0.0)
            >= state.reference[k] + traits.on[k]
            or min(u0, u1, y0) <= state.reference[k] - traits.off[k]
            or state.noise_us[k] <= t1_us
            or state.free_us[k] >= t0_us
        ):
            if n + _MOST_OF_A_PIXEL > out.t_us.shape[0]:
                out = _doubled(out, n)
            curve = curve_between(u0, u1, y0, traits.leak[k], dt, dt / rate)
            n = _walk(pixels, k, Interval(curve, t0_us, dt, now.light[k], label), out, n)
    return Fired(out.t_us[:n], out.pixel[:n], out.polarity[:n], out.label[:n])


@njit
def _cause(
    state: PixelState, before: View, now: View, k: int, decay: float, change: float, lag: float
) -> int:
    """Which surface changes the pixel's low-passed light between the renderings.

    Where one surface covers or uncovers another it is the nearer one, whose edge passed; it stays
    the cause while most of the change is the low-pass still following that edge.
    """
    was, label, owed = before.surface[k], now.surface[k], state.owed[k]
    left = owed * decay
    if was != label:
        label = was if before.depth[k] < now.depth[k] else label
        state.cause[k], left = label, left + lag * (1.0 - decay)
    elif abs(owed) * (1.0 - decay) > 0.5 * abs(change):
        label = state.cause[k]
    state.owed[k] = left if abs(left) > _NOTHING else 0.0
    return label


@njit
def _walk(pixels: Pixels, k: int, seen: Interval, out: Fired, n: int) -> int:
    """Append the events of pixel k to the n of `out`; returns their number then."""
    state, on, off = pixels.state, pixels.traits.on[k], pixels.traits.off[k]
    c, dt, leak = seen.curve, seen.dt, pixels.traits.leak[k]
    last, free = n + _MOST_OF_A_PIXEL, state.free_us[k] - seen.t0_us
    if free > dt:
        return n
    level, t = state.reference[k] + leak * free, max(free, 0.0)  # of c, as it leaks from t0
    if free >= 0.0:
        level = curve_at(c, t)
    while n < last:
        t_event, sign = first_crossing(c, level + on, level - off, t, dt)
        t_noise, noise_sign = _noise_until(pixels, k, seen, t, min(t_event, dt))
        if noise_sign != 0:
            t_event, sign, label, level = t_noise, noise_sign, NOISE_LABEL, curve_at(c, t_noise)
        elif sign > 0:
            label = NOISE_LABEL if leak * (t_event - free) > 0.5 * on else seen.label
            level += on
        elif sign < 0:
            label = seen.label
            level -= off
        else:
            break
        out.t_us[n] = seen.t0_us + math.floor(t_event + 0.5)
        out.pixel[n], out.polarity[n], out.label[n] = k, sign, label
        n += 1
        t = free = t_event + pixels.law.refractory_us
        if t > dt:
            break
        if free > t_event:
            level = curve_at(c, t)
    state.free_us[k] = seen.t0_us + free
    state.reference[k] = level - leak * free
    return n


@njit
def _noise_until(
    pixels: Pixels, k: int, seen: Interval, begin: float, end: float
) -> tuple[float, int]:
    """First noise event of pixel k in [begin, end], since t0: time [us] and polarity, or 0.

    Times are drawn at the rate in the dark, and thinned to the rate at the pixel's intensity.
    """
    state, law, hot = pixels.state, pixels.law, pixels.traits.hot[k]
    most = law.shot + hot
    rate = law.shot * (1.0 - (1.0 - law.shot_bright) * min(seen.light, 1.0)) + hot
    while state.noise_us[k] - seen.t0_us <= end:
        t = state.noise_us[k] - seen.t0_us
        lot = uniform(law.key, k, state.draws[k]) * most
        state.noise_us[k] += waiting_time(law.key, k, state.draws[k] + 1, most)
        state.draws[k] += 2
        if t >= begin and lot < rate:
            return t, 1 if lot < 0.5 * rate else -1
    return 0.0, 0


@njit
def _room(n: int) -> Fired:
    """Space for n events."""
    return Fired(
        np.empty(n, np.int64), np.empty(n, np.int32), np.empty(n, np.int8), np.empty(n, np.int16)
    )


@njit
def _doubled(f: Fired, n: int) -> Fired:
    """The first n events, in twice the space."""
    out = _room(2 * f.t_us.shape[0])
    out.t_us[:n], out.pixel[:n] = f.t_us[:n], f.pixel[:n]
    out.polarity[:n], out.label[:n] = f.polarity[:n], f.label[:n]
    return out
