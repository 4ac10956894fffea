# SPDX-License-Identifier: Apache-2.0
"""When the filter says that it is lost: one track now and then is not enough."""

from functools import cache

import numpy as np
import pytest
from simulated_tracks import Flight, simulate

from skyhaul.perception.vio.api import StartPose, TrackFrame, VioStatus
from skyhaul.perception.vio.ekf import EkfVio

MOVES = Flight(duration_s=9.0, still_s=1.5, pace=1.3)
STANDS = Flight(duration_s=9.0, still_s=99.0)
FROM_US = 5_000_000
LOST_S = EkfVio().lost_s


def black(frame, _):
    return TrackFrame(frame.stamp_us, frame.track_id[:0], frame.camera[:0], frame.xy[:0])


def hangs(frame, _):
    """The same bytes again and again."""
    return TrackFrame(frame.stamp_us, frame.track_id[:0], frame.camera[:0], frame.xy[:0], (0,))


def frozen(frame, last):
    """The same view again and again, with the noise of a camera."""
    noise = np.random.default_rng(frame.stamp_us).normal(0.0, 2e-4, last.xy.shape)
    return TrackFrame(frame.stamp_us, last.track_id, last.camera, last.xy + noise)


def all_but_one(frame, _):
    """Of all that it sees one track is left."""
    one = frame.track_id == frame.track_id.min()
    return TrackFrame(frame.stamp_us, frame.track_id[one], frame.camera[one], frame.xy[one])


@cache
def statuses(flight, spoil):
    """Time and status of each frame, from the first on that something is wrong."""
    recording, out, last = simulate(flight).recording, [], None
    estimator = EkfVio().build(recording.rig, recording.sigma)
    memory = estimator.init(StartPose())
    for imu, frame in recording.readings():
        if frame.stamp_us >= FROM_US:
            frame = spoil(frame, last)
        else:
            last = frame
        memory, estimate = estimator.step(memory, imu, frame)
        if frame.stamp_us >= FROM_US:
            out.append(((frame.stamp_us - FROM_US) / 1e6, estimate.status))
    return out


@pytest.mark.parametrize("spoil", [black, hangs, frozen, all_but_one])
def test_who_flies_and_sees_nothing_new_is_lost_in_time(spoil):
    seen = statuses(MOVES, spoil)
    assert seen[0][1] is VioStatus.TRACKING
    lost = [t for t, status in seen if status is VioStatus.LOST]
    assert min(lost) <= LOST_S + 0.15
    assert all(status is VioStatus.LOST for t, status in seen if t > LOST_S + 0.15)


@pytest.mark.parametrize("spoil", [black, hangs, frozen])
def test_who_stands_is_not_lost(spoil):
    assert all(status is VioStatus.TRACKING for _, status in statuses(STANDS, spoil))


def test_who_sees_well_is_not_lost():
    assert all(s is VioStatus.TRACKING for _, s in statuses(MOVES, lambda frame, _: frame))
