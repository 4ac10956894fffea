# SPDX-License-Identifier: Apache-2.0
"""Tracks as arrays at one time, and when a track has left the tube that was predicted for it."""

from functools import cache

import numpy as np

from skyhaul.geometry.shapes import shape_size
from skyhaul.perception.api import Track, TrackArrays
from skyhaul.types import US_PER_S, TimeUs

_solid = cache(shape_size)


def track_arrays(tracks: tuple[Track, ...], stamp_us: TimeUs) -> TrackArrays:
    """Tracks brought to one stamp: moved on at their velocity, tubes grown by as much time."""
    m = len(tracks)
    dt = np.array([(stamp_us - t.stamp_us) / US_PER_S for t in tracks])
    rows = [_solid(t.shape) for t in tracks]
    p_WO = np.array([t.p_WO for t in tracks]).reshape(m, 3)
    v_WO = np.array([t.v_WO for t in tracks]).reshape(m, 3)
    return TrackArrays(
        kind=np.array([kind for kind, _, _ in rows], dtype=np.int64),
        size=np.array([size for _, size, _ in rows], dtype=np.float64).reshape(m, 3),
        p_WO=p_WO + dt[:, None] * v_WO,
        R_WO=np.array([t.R_WO for t in tracks], dtype=np.float64).reshape(m, 3, 3),
        v_WO=v_WO,
        tube_base=np.array([t.tube_m(d) for t, d in zip(tracks, dt, strict=True)]).reshape(m),
        growth=np.array([t.growth_mps for t in tracks]).reshape(m),
    )


def has_strayed(predicted: Track, now: Track) -> bool:
    """Whether an obstacle is outside the tube that an earlier track predicted for this time.

    Its centre may be off the predicted one by the growth of the tube plus its own uncertainty
    of then.
    """
    dt = (now.stamp_us - predicted.stamp_us) / US_PER_S
    off = float(np.linalg.norm(now.p_WO - predicted.p_WO - dt * predicted.v_WO))
    return off > predicted.tube_m(dt)
