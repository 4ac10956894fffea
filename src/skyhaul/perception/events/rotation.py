# SPDX-License-Identifier: Apache-2.0
"""The camera's rotation at each event, and events moved to where a turned camera sees them."""

from dataclasses import dataclass

import numpy as np

from skyhaul.geometry.camera import project_points
from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.events.lens import EventLens
from skyhaul.sensors.api import EventReading
from skyhaul.types import US_PER_S, Array, IntArray, TimeUs


@dataclass(frozen=True, eq=False)
class TurnMemory:
    """The integral of the gyro up to its newest sample."""

    stamp_us: TimeUs = 0
    w_WC_C: Array | None = None  # (3,) newest sample [rad/s]; None before the first
    turn_C: Array | None = None  # (3,) integral up to it [rad]


def turn_at(
    memory: TurnMemory, stamp_us: IntArray, w_WC_C: Array, t_us: IntArray
) -> tuple[TurnMemory, Array]:
    """Integral of the camera's angular rate at the times of events, (k, 3) [rad].

    Between samples the rate is interpolated, after the last and before the first it is held.
    Only differences over some tens of milliseconds are used, as rotation vectors.

    Args:
        memory: From the call before.
        stamp_us: Times of the new samples, increasing, after those of the memory, (m,).
        w_WC_C: Their rates, (m, 3) [rad/s].
        t_us: Times of events, not before the memory's newest sample but one, (k,).
    """
    times, rates, turn = stamp_us, w_WC_C, np.zeros(3)
    if memory.w_WC_C is not None and memory.turn_C is not None:
        times = np.concatenate([[memory.stamp_us], stamp_us])
        rates = np.concatenate([memory.w_WC_C[None], w_WC_C])
        turn = memory.turn_C
    if len(times) == 0:
        return memory, np.zeros((len(t_us), 3))
    gaps = np.diff(times)[:, None] / US_PER_S
    knots = np.concatenate([turn[None], turn + np.cumsum(0.5 * gaps * (rates[1:] + rates[:-1]), 0)])
    i = np.clip(np.searchsorted(times, t_us, side="right") - 1, 0, len(times) - 1)
    j = np.minimum(i + 1, len(times) - 1)
    since = (t_us - times[i])[:, None] / US_PER_S
    gap = np.maximum(times[j] - times[i], 1)[:, None] / US_PER_S
    slope = np.where(since < 0.0, 0.0, (rates[j] - rates[i]) / gap)
    turns: Array = knots[i] + since * (rates[i] + 0.5 * since * slope)
    return TurnMemory(int(times[-1]), rates[-1], knots[-1]), turns


def derotated(lens: EventLens, events: EventReading, turn_C: Array, turn_now_C: Array) -> Array:
    """Where a camera turned to `turn_now_C` sees the events' directions, (k, 2) [px].

    f' = Exp(turn_now - turn)^T f, then projected. The image of what stands, far or near, stays in
    place while the camera only turns.
    """
    rays = lens.rays_C[events.y, events.x]
    turned = np.einsum("kji,kj->ki", so3_exp(turn_now_C - turn_C), rays)
    uv, seen = project_points(lens.model, turned)
    uv[~seen] = np.nan
    return uv


def warped_contrast(lens: EventLens, uv: Array) -> float:
    """Variance over the image of the number of events at each pixel, events shared bilinearly.

    Source: Gallego and Scaramuzza, "Accurate angular velocity estimation with an event camera"
        (RA-L 2017): the right motion makes it largest.
    """
    h, w = lens.height, lens.width
    kept = uv[np.all((uv >= 0.0) & (uv < [w - 1, h - 1]), axis=1)]
    corner = np.floor(kept).astype(np.int64)
    part = kept - corner
    image = np.zeros(h * w)
    for dx in (0, 1):
        for dy in (0, 1):
            share = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
            at = (corner[:, 1] + dy) * w + corner[:, 0] + dx
            image += np.bincount(at, share, minlength=h * w)
    return float(np.var(image))
