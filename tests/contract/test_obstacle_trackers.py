# SPDX-License-Identifier: Apache-2.0
"""What every tracker of moving obstacles must do. A new one adds one entry to TRACKERS."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.perception.obstacles.api import Bearings
from skyhaul.perception.obstacles.motion import KalmanFilter
from skyhaul.perception.obstacles.particles import ParticleFilter
from skyhaul.perception.obstacles.tracker import BearingTracker

TRACKERS = {
    "kalman-both": BearingTracker(),
    "kalman-velocity": BearingTracker(filter=KalmanFilter(models="velocity", manoeuvre=0.3)),
    "kalman-acceleration": BearingTracker(filter=KalmanFilter(models="acceleration")),
    "particles": BearingTracker(filter=ParticleFilter()),
}
PERIOD_US = 10_000
CAMERAS = np.array([[0.7, 0.7, 2.0], [-0.7, 0.7, 2.0], [0.0, -0.9, 2.0]])

every_tracker = pytest.mark.parametrize("tracker", TRACKERS.values(), ids=TRACKERS.keys())


def place(k):
    """Where a ball of 0.25 m is at step k: it passes at 0.9 m/s."""
    return np.array([2.5, -0.5 + 0.009 * k, 2.2])


def seen(k, rng, *, hidden=False):
    """What three cameras see of it, to 0.4 deg."""
    out = []
    for camera, c in enumerate(CAMERAS):
        rel = place(k) - c
        distance = np.linalg.norm(rel)
        d = rel / distance + 0.007 * rng.normal(size=3)
        rows = 0 if hidden else 1
        none = np.full(rows, np.nan)
        out.append(Bearings(
            PERIOD_US * k, camera, c, np.zeros(3), (d / np.linalg.norm(d))[None][:rows],
            np.full(rows, 0.007), np.full(rows, np.arcsin(0.25 / distance)), none, none.copy(),
            np.zeros(rows), np.ones(rows),
        ))  # fmt: skip
    return tuple(out)


def follow(tracker, steps, hidden_from=10**9, move=(0.0, 0.0, 0.0)):
    rng, memory, out = np.random.default_rng(0), tracker.init(), []
    for k in range(steps):
        rows = tuple(replace(s, p_WC=s.p_WC + move) for s in seen(k, rng, hidden=k >= hidden_from))
        memory, tracks = tracker.step(memory, PERIOD_US * k, rows)
        out.append(tracks)
    return memory, out


@every_tracker
def test_before_anything_is_seen_there_is_no_track(tracker):
    memory, tracks = tracker.step(tracker.init(), 0, ())
    assert tracks == ()
    assert tracker.step(memory, PERIOD_US, seen(0, np.random.default_rng(0), hidden=True))[1] == ()


@every_tracker
def test_a_mover_becomes_one_track_that_is_where_it_is(tracker):
    _, out = follow(tracker, 70)
    assert {t.track_id for tracks in out for t in tracks} == {out[-1][0].track_id}
    (track,) = out[-1]
    assert np.linalg.norm(track.p_WO - place(69)) < 0.12
    assert np.linalg.norm(track.v_WO - [0.0, 0.9, 0.0]) < 0.4
    assert track.shape.radius_m == pytest.approx(0.25, rel=0.1)
    assert track.stamp_us == 69 * PERIOD_US


@every_tracker
def test_the_tube_holds_the_mover_for_two_seconds_and_never_narrows(tracker):
    (track,) = follow(tracker, 70)[1][-1]
    ahead = np.linspace(0.0, 2.0, 9)
    off = [np.linalg.norm(place(69 + 100 * a) - track.p_WO - a * track.v_WO) for a in ahead]
    tube = np.array([track.tube_m(a) for a in ahead])
    assert np.all(off <= tube)
    assert np.all(np.diff(tube) > 0.0)
    assert tube[0] < 0.3


@every_tracker
def test_covariances_are_symmetric_and_positive(tracker):
    for tracks in follow(tracker, 40)[1]:
        for track in tracks:
            np.testing.assert_allclose(track.covariance, track.covariance.T, atol=1e-9)
            assert np.linalg.eigvalsh(track.covariance).min() > 0.0


@every_tracker
def test_a_track_that_is_seen_no_more_coasts_and_dies(tracker):
    _, out = follow(tracker, 120, hidden_from=40)
    assert len(out[45]) == 1
    assert out[-1] == ()
    before, after = out[39][0], out[60][0]
    assert np.trace(after.covariance[:3, :3]) > np.trace(before.covariance[:3, :3])


@every_tracker
def test_moving_the_world_moves_the_tracks(tracker):
    move = np.array([5.0, -3.0, 1.0])
    (here,), (there,) = follow(tracker, 40)[1][-1], follow(tracker, 40, move=move)[1][-1]
    np.testing.assert_allclose(there.p_WO - here.p_WO, move, atol=1e-6)
    np.testing.assert_allclose(there.v_WO, here.v_WO, atol=1e-6)


@every_tracker
def test_steps_are_pure(tracker):
    memory, _ = follow(tracker, 30)
    rows = seen(30, np.random.default_rng(1))
    (a,), (b,) = (tracker.step(memory, 30 * PERIOD_US, rows)[1] for _ in range(2))
    assert a.p_WO.tobytes() == b.p_WO.tobytes()
    assert a.covariance.tobytes() == b.covariance.tobytes()
