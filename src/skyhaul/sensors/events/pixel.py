# SPDX-License-Identifier: Apache-2.0
"""One pixel of an event camera between two renderings, event by event.

It compares z, its low-passed log intensity plus leak (`curve`), with a reference. It fires ON when
z >= reference + on and OFF when z <= reference - off; then it is held in reset for the refractory
period, and what it sees when that ends is the new reference. Without a refractory period the
reference therefore steps by the threshold for each event.

Times count from the first rendering [us]; levels are those of `Interval.curve`, which leaks from
there. Only scalars go in and out, so the loop over the pixels keeps them in registers.
"""

from typing import NamedTuple

import numpy as np

from skyhaul.jit import njit_ieee
from skyhaul.sensors.events.curve import Curve, curve_at, first_crossing
from skyhaul.sensors.events.noise import uniform, waiting_time
from skyhaul.sensors.truth_api import NOISE_LABEL


class PixelLaw(NamedTuple):
    """What all pixels share."""

    key: np.uint64  # of the random numbers
    refractory_us: float
    shot: float  # rate of shot noise events in the dark [1/us]
    shot_bright: float  # share of it that is left at intensity 1


class Trait(NamedTuple):
    """What is peculiar to this pixel."""

    pixel: int
    on: float  # threshold of ON events
    off: float  # threshold of OFF events, > 0
    leak: float  # [1/us]
    hot: float  # rate at which it fires by itself [1/us]


class Interval(NamedTuple):
    """What it sees."""

    curve: Curve
    dt: float  # [us]
    light: float  # intensity at the end
    label: int  # surface that changes it


class Watch(NamedTuple):
    """Where it is: compares from `t` on with `level`."""

    t: float
    level: float
    free: float  # when the last reset ended
    noise: float  # when noise may fire next
    draws: int  # random numbers used


@njit_ieee
def begin(seen: Interval, watch: Watch) -> Watch:
    """Take up the comparison at time 0, or at the end of a reset that goes on."""
    if watch.free < 0.0:
        return watch
    t = min(watch.free, seen.dt)
    return Watch(t, curve_at(seen.curve, t), watch.free, watch.noise, watch.draws)


@njit_ieee
def next_event(
    trait: Trait, law: PixelLaw, seen: Interval, watch: Watch
) -> tuple[Watch, float, int, int]:
    """The next event of the pixel.

    Returns:
        The pixel after it; time [us]; polarity, 0: there is none any more; label.
    """
    if watch.free > seen.dt:
        return watch, 0.0, 0, 0
    c, level, label = seen.curve, watch.level, seen.label
    t, sign = first_crossing(c, level + trait.on, level - trait.off, watch.t, seen.dt)
    noise, draws, noise_sign = watch.noise, watch.draws, 0
    if noise <= min(t, seen.dt):
        noise, draws, t_noise, noise_sign = _noise_until(trait, law, seen, watch, min(t, seen.dt))
    if noise_sign != 0:
        t, sign, label, level = t_noise, noise_sign, NOISE_LABEL, curve_at(c, t_noise)
    elif sign > 0:
        level += trait.on
        if trait.leak * (t - watch.free) > 0.5 * trait.on:
            label = NOISE_LABEL
    elif sign < 0:
        level -= trait.off
    else:
        return Watch(watch.t, level, watch.free, noise, draws), 0.0, 0, 0
    free = t + law.refractory_us
    if t < free <= seen.dt:
        level = curve_at(c, free)
    return Watch(free, level, free, noise, draws), t, sign, label


@njit_ieee
def _noise_until(
    trait: Trait, law: PixelLaw, seen: Interval, watch: Watch, end: float
) -> tuple[float, int, float, int]:
    """First noise event up to `end`.

    Times are drawn at the rate in the dark, and thinned to the rate at the pixel's intensity.

    Returns:
        When noise may fire after it, random numbers used, its time [us], polarity or 0.
    """
    most = law.shot + trait.hot
    rate = law.shot * (1.0 - (1.0 - law.shot_bright) * min(seen.light, 1.0)) + trait.hot
    noise, draws = watch.noise, watch.draws
    while noise <= end:
        t = noise
        lot = uniform(law.key, trait.pixel, draws) * most
        noise += waiting_time(law.key, trait.pixel, draws + 1, most)
        draws += 2
        if t >= watch.t and lot < rate:
            return noise, draws, t, 1 if lot < 0.5 * rate else -1
    return noise, draws, 0.0, 0
