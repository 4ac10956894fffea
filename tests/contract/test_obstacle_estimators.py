# SPDX-License-Identifier: Apache-2.0
"""What every obstacle estimator must do. A new one adds one entry to ESTIMATORS."""

import numpy as np
import pytest

from skyhaul.geometry.shapes import Box, Sphere
from skyhaul.perception.obstacles.truth import TruthObstacles
from skyhaul.sensors.api import ObjectReading, ObjectsReading

ESTIMATORS = [TruthObstacles(), TruthObstacles(confirm_readings=4, forget_s=0.3)]
PERIOD_US = 20_000
WALL, BALL = Box(size_m=(0.2, 3.0, 3.0)), Sphere(radius_m=0.2)

every_estimator = pytest.mark.parametrize(
    "estimator", ESTIMATORS, ids=lambda e: f"{e.kind}-{e.confirm_readings}"
)


def place(t_us):
    """Where the ball is: it crosses at 0.5 m/s."""
    return np.array([1.0, 0.5e-6 * t_us, 1.0])


def reading(k, *, hidden=False):
    """Reading k of a wall that stands and a ball that crosses."""
    t_us = PERIOD_US * k
    wall = ObjectReading(0, WALL, np.array([3.0, 0.0, 1.5]), np.eye(3), np.zeros(3), False)
    ball = ObjectReading(1, BALL, place(t_us), np.eye(3), np.array([0.0, 0.5, 0.0]), True)
    return ObjectsReading(t_us, () if hidden else (wall, ball))


def follow(estimator, readings):
    memory, out = estimator.init(), []
    for r in readings:
        memory, estimate = estimator.step(memory, r)
        out.append(estimate)
    return out


@every_estimator
def test_before_anything_is_seen_nothing_is_known(estimator):
    estimate = follow(estimator, [ObjectsReading(5, ())])[0]
    assert (estimate.stamp_us, estimate.statics, estimate.tracks) == (5, (), ())


@every_estimator
def test_what_moves_becomes_a_track_and_what_stands_a_static(estimator):
    last = follow(estimator, [reading(k) for k in range(30)])[-1]
    assert [s.object_id for s in last.statics] == [0]
    assert [t.track_id for t in last.tracks] == [1]
    assert last.statics[0].shape == WALL
    assert last.tracks[0].shape == BALL


@every_estimator
def test_the_tube_holds_the_obstacle_while_it_keeps_its_way(estimator):
    (track,) = follow(estimator, [reading(k) for k in range(30)])[-1].tracks
    for ahead_s in np.linspace(0.0, 4.0, 21):
        predicted = track.p_WO + ahead_s * track.v_WO
        off = np.linalg.norm(place(track.stamp_us + 1e6 * ahead_s) - predicted)
        assert off <= track.tube_m(ahead_s)


@every_estimator
def test_a_tube_never_narrows(estimator):
    (track,) = follow(estimator, [reading(k) for k in range(30)])[-1].tracks
    radii = [track.tube_m(t) for t in np.linspace(0.0, 5.0, 11)]
    assert radii[0] >= 0.0
    assert np.all(np.diff(radii) >= 0.0)


@every_estimator
def test_a_track_that_is_seen_no_more_dies_but_a_wall_stays(estimator):
    readings = [reading(k) for k in range(30)] + [reading(k, hidden=True) for k in range(30, 230)]
    last = follow(estimator, readings)[-1]
    assert last.tracks == ()
    assert [s.object_id for s in last.statics] == [0]


@every_estimator
def test_no_track_is_from_the_future_and_ids_are_unique(estimator):
    for e in follow(estimator, [reading(k) for k in range(30)]):
        assert all(t.stamp_us <= e.stamp_us for t in e.tracks)
        assert len({t.track_id for t in e.tracks}) == len(e.tracks)


@every_estimator
def test_steps_are_pure(estimator):
    memory = estimator.init()
    for k in range(10):
        memory, _ = estimator.step(memory, reading(k))
    a, b = (estimator.step(memory, reading(10))[1] for _ in range(2))
    assert [t.track_id for t in a.tracks] == [t.track_id for t in b.tracks]
    np.testing.assert_array_equal(a.tracks[0].p_WO, b.tracks[0].p_WO)
