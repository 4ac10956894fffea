# SPDX-License-Identifier: Apache-2.0
"""Which frames become keyframes."""

import numpy as np

from skyhaul.perception.vio.api import TrackFrame
from skyhaul.perception.vio.keyframes import kept, keyframe_due

EVERY_S = 0.1


def frame(stamp_us, cameras, count):
    here = np.array(cameras, dtype=np.int64)
    silent = tuple(c for c in range(count) if c not in cameras)
    return TrackFrame(stamp_us, 10 * here, here, np.zeros((len(here), 2)), silent)


def keyframes(frames, count):
    """Those of a rig."""
    last_us, kept_us, out = -1_000_000, {}, []
    for k, f in enumerate(frames):
        if keyframe_due(EVERY_S, frames[: k + 1], last_us, kept_us):
            last_us, kept_us = f.stamp_us, kept(kept_us, f, count)
            out.append(f)
    return out


def test_together_they_are_due_by_time():
    frames = [frame(t, (0, 1), 2) for t in range(0, 2_000_000, 33_333)]
    stamps = [f.stamp_us for f in keyframes(frames, 2)]
    assert stamps == [f.stamp_us for f in frames[::3]]


def test_no_camera_that_takes_its_turn_is_left_out():
    """Four of them at 10 Hz each: the fourth frame after a keyframe is of the same camera."""
    frames = [frame(25_000 * k, (k % 4,), 4) for k in range(200)]
    chosen = keyframes(frames, 4)
    of = [int(f.camera[0]) for f in chosen]
    np.testing.assert_array_less(np.diff([f.stamp_us for f in chosen]), 200_001)
    assert min(of.count(c) for c in range(4)) >= 0.2 * len(of)
    for c in range(4):
        apart = np.diff([f.stamp_us for f in chosen if f.camera[0] == c])
        assert apart.max() < 600_000


def test_a_slow_camera_has_its_keyframes():
    frames = [frame(25_000 * k, (0,) if k % 20 else (0, 1), 2) for k in range(200)]
    frames = [f if k % 20 != 1 else frame(f.stamp_us, (1,), 2) for k, f in enumerate(frames)]
    assert sum(1 in f.camera for f in keyframes(frames, 2)) >= 8


def test_nobody_waits_for_a_camera_that_fell_silent():
    frames = [frame(50_000 * k, (0, 1) if k < 20 else (0,), 2) for k in range(60)]
    stamps = [f.stamp_us for f in keyframes(frames, 2)]
    assert set(np.diff(stamps)) == {100_000}
