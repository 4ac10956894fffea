# SPDX-License-Identifier: Apache-2.0
"""What every obstacle estimator must do. A new one adds one entry to ESTIMATORS."""

from functools import cache

import numpy as np
import pytest

from skyhaul.geometry.shapes import Box, Sphere
from skyhaul.perception.obstacles.truth import TruthObstacles
from skyhaul.sensors.api import ObjectReading, ObjectsReading

from ..perception.obstacles.conftest import Swing  # noqa: TID252
from ..perception.obstacles.sights import sight, watch  # noqa: TID252
from ..perception.scene.conftest import Ball, scene, views  # noqa: TID252

PERIOD_US = 20_000
WALL, BALL = Box(size_m=(0.2, 3.0, 3.0)), Sphere(radius_m=0.2)


def place(t_us):
    """Where the ball is: it crosses at 0.5 m/s."""
    return np.array([1.0, 0.5e-6 * t_us, 1.0])


def reading(k, *, hidden=False):
    """Reading k of a wall that stands and a ball that crosses."""
    t_us = PERIOD_US * k
    wall = ObjectReading(0, WALL, np.array([3.0, 0.0, 1.5]), np.eye(3), np.zeros(3), False)
    ball = ObjectReading(1, BALL, place(t_us), np.eye(3), np.array([0.0, 0.5, 0.0]), True)
    return ObjectsReading(t_us, () if hidden else (wall, ball))


@cache
def event_sight(k, *, hidden=False):
    """Step k of the same ball, a metre farther off and higher, for event cameras."""
    rng = np.random.default_rng(k)
    ball = Swing((2.5, -0.3, 2.2), (0.0, 0.5, 0.0), radius_m=0.2)
    return sight([] if hidden else [ball], k + 1, rng)


@cache
def camera_views(k, *, hidden=False):
    """Frame k of a ball nearer to the vehicle that looks to (1, 1)."""
    balls = [] if hidden else [Ball((2.0, 1.4, 2.5), (0.0, 0.5, 0.0))]
    return views(scene(), balls, k, rng=np.random.default_rng(k))


TRUTH = [TruthObstacles(), TruthObstacles(confirm_readings=4, forget_s=0.3)]
ESTIMATORS = {
    "truth-2": (TRUTH[0], reading, place),
    "truth-4": (TRUTH[1], reading, place),
    "cameras": (scene(), camera_views, lambda t_us: np.array([2.0, 1.4 + 0.5e-6 * t_us, 2.5])),
    "events": (watch(), event_sight, lambda t_us: np.array([2.5, -0.3 + 0.5e-6 * t_us, 2.2])),
}
every_estimator = pytest.mark.parametrize(
    ("estimator", "reading_of", "true_place"), ESTIMATORS.values(), ids=ESTIMATORS.keys()
)
every_that_knows_what_stands = pytest.mark.parametrize("estimator", TRUTH, ids=["2", "4"])


def follow(estimator, readings):
    memory, out = estimator.init(), []
    for r in readings:
        memory, estimate = estimator.step(memory, r)
        out.append(estimate)
    return out


@every_estimator
def test_before_anything_is_seen_nothing_is_known(estimator, reading_of, true_place):
    empty = reading_of(0, hidden=True)
    estimate = follow(estimator, [empty])[0]
    assert (estimate.stamp_us, estimate.statics, estimate.tracks) == (empty.stamp_us, (), ())


@every_that_knows_what_stands
def test_what_moves_becomes_a_track_and_what_stands_a_static(estimator):
    last = follow(estimator, [reading(k) for k in range(30)])[-1]
    assert [s.object_id for s in last.statics] == [0]
    assert [t.track_id for t in last.tracks] == [1]
    assert last.statics[0].shape == WALL
    assert last.tracks[0].shape == BALL


@every_estimator
def test_what_moves_becomes_one_track_that_is_where_it_is(estimator, reading_of, true_place):
    out = follow(estimator, [reading_of(k) for k in range(30)])
    (track,) = out[-1].tracks
    assert {t.track_id for e in out for t in e.tracks} == {track.track_id}
    assert np.linalg.norm(track.p_WO - true_place(track.stamp_us)) < 0.2
    assert np.linalg.norm(track.v_WO - [0.0, 0.5, 0.0]) < 0.3
    assert track.shape.radius_m == pytest.approx(0.2, rel=0.3)


@every_estimator
def test_the_tube_holds_the_obstacle_while_it_keeps_its_way(estimator, reading_of, true_place):
    (track,) = follow(estimator, [reading_of(k) for k in range(30)])[-1].tracks
    for ahead_s in np.linspace(0.0, 2.0, 11):
        predicted = track.p_WO + ahead_s * track.v_WO
        off = np.linalg.norm(true_place(track.stamp_us + 1e6 * ahead_s) - predicted)
        assert off <= track.tube_m(ahead_s)


@every_estimator
def test_a_tube_never_narrows(estimator, reading_of, true_place):
    (track,) = follow(estimator, [reading_of(k) for k in range(30)])[-1].tracks
    radii = [track.tube_m(t) for t in np.linspace(0.0, 5.0, 11)]
    assert radii[0] >= 0.0
    assert np.all(np.diff(radii) >= 0.0)


@every_estimator
def test_a_track_that_is_seen_no_more_dies(estimator, reading_of, true_place):
    readings = [reading_of(k) for k in range(30)]
    readings += [reading_of(k, hidden=True) for k in range(30, 130)]
    assert follow(estimator, readings)[-1].tracks == ()


@every_that_knows_what_stands
def test_a_wall_stays_when_it_is_seen_no_more(estimator):
    readings = [reading(k) for k in range(30)] + [reading(k, hidden=True) for k in range(30, 230)]
    assert [s.object_id for s in follow(estimator, readings)[-1].statics] == [0]


@every_estimator
def test_no_track_is_from_the_future_and_ids_are_unique(estimator, reading_of, true_place):
    for e in follow(estimator, [reading_of(k) for k in range(30)]):
        assert all(t.stamp_us <= e.stamp_us for t in e.tracks)
        assert len({t.track_id for t in e.tracks}) == len(e.tracks)


@every_estimator
def test_the_same_readings_give_the_same_bytes(estimator, reading_of, true_place):
    readings = [reading_of(k) for k in range(20)]
    (a,), (b,) = (follow(estimator, readings)[-1].tracks for _ in range(2))
    assert a.track_id == b.track_id
    assert a.p_WO.tobytes() == b.p_WO.tobytes()
    assert a.covariance.tobytes() == b.covariance.tobytes()
