# SPDX-License-Identifier: Apache-2.0
"""What a pixel sees between two renderings: log intensity on a straight line, after a low-pass.

u(t) = u0 + m t is the logarithm of the light, t from the rendering before [us]. The photoreceptor
follows it with time constant tau, tau y' = u - y. In closed form, with the leak l added,

    z(t) = y(t) + l t = base + slope t + swing exp(-t / tau)
    base = u0 - m tau,  slope = m + l,  swing = y0 - u0 + m tau,

which has one extremum at most. Levels that it crosses are found on its two monotone pieces.
"""

import math
from typing import NamedTuple

from skyhaul.jit import njit_ieee

_STEPS = 60
_CLOSE_US = 1e-4


class Curve(NamedTuple):
    """z(t) = base + slope t + swing exp(-t / tau)."""

    base: float
    slope: float  # [1/us]
    swing: float
    tau: float  # [us]; 0 without a low-pass, and swing is 0 then


@njit_ieee
def curve_between(u0: float, u1: float, y0: float, leak: float, dt: float, tau: float) -> Curve:
    """The curve of a pixel.

    Args:
        u0: Log intensity at the rendering before.
        u1: Log intensity dt later.
        y0: Low-pass of the log intensity at the rendering before.
        leak: Drift against the reference [1/us].
        dt: Time between the renderings [us].
        tau: Time constant of the low-pass [us].
    """
    m = (u1 - u0) / dt
    if tau == 0.0:
        return Curve(u0, m + leak, 0.0, 0.0)
    return Curve(u0 - m * tau, m + leak, y0 - u0 + m * tau, tau)


@njit_ieee
def curve_at(c: Curve, t: float) -> float:
    """z(t)."""
    if c.swing == 0.0:
        return c.base + c.slope * t
    return c.base + c.slope * t + c.swing * math.exp(-t / c.tau)


@njit_ieee
def turning_time(c: Curve) -> float:
    """When z has its extremum; -1 when it has none after t = 0."""
    push = c.slope * c.tau  # z' = 0 where exp(-t / tau) = slope tau / swing
    if c.swing == 0.0 or push / c.swing <= 0.0 or abs(push) >= abs(c.swing):
        return -1.0
    return -c.tau * math.log(push / c.swing)


@njit_ieee
def time_of_level(c: Curve, level: float, low: float, high: float) -> float:
    """When z reaches a level that it crosses once within [low, high].

    Newton's method kept within the bracket, halving it where Newton leaves it.
    """
    if c.swing == 0.0:
        if c.slope == 0.0:  # reached before, up to rounding
            return low
        return min(max((level - c.base) / c.slope, low), high)
    rising = curve_at(c, high) > curve_at(c, low)
    t = 0.5 * (low + high)
    for _ in range(_STEPS):
        e = math.exp(-t / c.tau)
        error = c.base + c.slope * t + c.swing * e - level
        if (error > 0.0) == rising:
            high = t
        else:
            low = t
        rate = c.slope - c.swing / c.tau * e
        step = -error / rate if rate != 0.0 else math.inf
        if not low <= t + step <= high:
            step = 0.5 * (low + high) - t
        t += step
        if abs(step) < _CLOSE_US:
            break
    return t


@njit_ieee
def first_crossing(c: Curve, on: float, off: float, start: float, end: float) -> tuple[float, int]:
    """First time in (start, end] at which z rises to `on` or falls to `off`.

    Args:
        c: The curve; off < z(start) < on.
        on: Upper level.
        off: Lower level.
        start: Begin of the search [us].
        end: End of the search [us].

    Returns:
        Time [us] and polarity, +1 or -1; infinity and 0 when z stays between the levels.
    """
    turn = turning_time(c)
    low = start
    while low < end:
        high = turn if low < turn < end else end
        z = curve_at(c, high)
        if z >= on:
            return time_of_level(c, on, low, high), 1
        if z <= off:
            return time_of_level(c, off, low, high), -1
        low = high
    return math.inf, 0
