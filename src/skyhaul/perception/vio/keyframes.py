# SPDX-License-Identifier: Apache-2.0
"""Which frames become keyframes, also where cameras take turns."""

from collections.abc import Mapping, Sequence

from skyhaul.perception.vio.api import TrackFrame
from skyhaul.types import US_PER_S, TimeUs

MOST_PERIODS = 2
"""A keyframe waits for a camera until so many of their periods have passed since the last one."""


def keyframe_due(
    every_s: float, frames: Sequence[TrackFrame], last_us: TimeUs, kept_us: Mapping[int, TimeUs]
) -> bool:
    """Whether the last frame becomes a keyframe: when a period has passed.

    Where cameras take turns, a frame is passed over while another camera is expected soon whose
    last keyframe is longer ago: otherwise a rhythm of theirs that fits the period would leave some
    of them out for ever.

    Args:
        every_s: The period [s].
        frames: In order of time, the last one is now.
        last_us: Of the last keyframe.
        kept_us: Of the last keyframe with each camera; none yet where it is missing.
    """
    now, period_us = frames[-1], every_s * US_PER_S
    if now.stamp_us < last_us + round(0.99 * period_us):
        return False
    here = set(now.camera.tolist())
    longest_us = min((kept_us.get(c, -1) for c in here), default=now.stamp_us)
    until_us = last_us + MOST_PERIODS * period_us
    return not any(
        kept_us.get(c, -1) < longest_us and now.stamp_us < _next_us(frames, c) <= until_us
        for c in now.silent
    )


def kept(kept_us: Mapping[int, TimeUs], keyframe: TrackFrame, cameras: int) -> dict[int, TimeUs]:
    """The last keyframe with each camera after a new one."""
    delivered = set(range(cameras)).difference(keyframe.silent)
    return {**kept_us, **dict.fromkeys(delivered, keyframe.stamp_us)}


def _next_us(frames: Sequence[TrackFrame], camera: int) -> TimeUs:
    """When a camera delivers again if it goes on as it did last; in the past where it does not."""
    times = [f.stamp_us for f in frames if camera not in f.silent][-2:]
    return 2 * times[-1] - times[0] if len(times) == 2 else -1
