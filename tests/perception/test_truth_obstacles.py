# SPDX-License-Identifier: Apache-2.0
"""Obstacles from perfect readings: statics are kept, movers tracked, confirmed and forgotten."""

import numpy as np
import pytest

from skyhaul.geometry.shapes import Sphere
from skyhaul.perception.obstacles.truth import TruthObstacles
from skyhaul.sensors.api import ObjectReading, ObjectsReading

BALL = Sphere(radius_m=0.2)
PERIOD_US = 20_000


def thing(object_id, p_WO=(0.0, 0.0, 0.0), v_WO=(0.0, 0.0, 0.0), *, moves=False):
    return ObjectReading(object_id, BALL, np.array(p_WO), np.eye(3), np.array(v_WO), moves)


def seen(t_us, *objects):
    return ObjectsReading(t_us, tuple(objects))


def follow(readings, estimator=None):
    """Estimates after each of some readings."""
    estimator = estimator or TruthObstacles()
    memory, out = estimator.init(), []
    for reading in readings:
        memory, estimate = estimator.step(memory, reading)
        out.append(estimate)
    return out


def track_ids(estimate):
    return [t.track_id for t in estimate.tracks]


def static_ids(estimate):
    return [s.object_id for s in estimate.statics]


def test_what_stands_is_kept_for_good_once_seen():
    last = follow([seen(0, thing(3)), seen(PERIOD_US), seen(60_000_000)])[-1]
    assert static_ids(last) == [3]
    assert last.tracks == ()


def test_a_static_object_stays_the_same_object_so_that_the_map_sees_no_change():
    first, second = follow([seen(0, thing(3)), seen(PERIOD_US, thing(3))])
    assert first.statics[0] is second.statics[0]


@pytest.mark.parametrize("needed", [1, 2, 4])
def test_a_track_is_confirmed_by_the_last_of_the_readings_it_needs(needed):
    mover = thing(1, moves=True)
    readings = [seen(k * PERIOD_US, mover) for k in range(6)]
    estimates = follow(readings, TruthObstacles(confirm_readings=needed))
    assert [track_ids(e) for e in estimates] == [[]] * (needed - 1) + [[1]] * (7 - needed)


def test_a_track_carries_the_newest_state_and_the_parameters_of_its_tube():
    estimator = TruthObstacles(confirm_readings=1, tube_base_m=0.03, growth_mps=0.2)
    readings = [seen(k * PERIOD_US, thing(1, (k, 0, 0), (0, k, 0), moves=True)) for k in (1, 2)]
    (track,) = follow(readings, estimator)[-1].tracks
    assert track.stamp_us == 2 * PERIOD_US
    np.testing.assert_array_equal(track.p_WO, [2.0, 0.0, 0.0])
    np.testing.assert_array_equal(track.v_WO, [0.0, 2.0, 0.0])
    assert track.tube_m(0.0) == 0.03
    assert track.tube_m(1.5) == pytest.approx(0.03 + 0.3)
    assert track.tube_m(-1.5) == track.tube_m(1.5)


def test_a_track_out_of_sight_lives_on_until_it_is_forgotten():
    mover = thing(1, (1, 2, 3), (0.5, 0, 0), moves=True)
    times = [0, PERIOD_US, 500_000, 1_020_000, 1_040_000]
    readings = [seen(t, *([mover] if t <= PERIOD_US else [])) for t in times]
    estimates = follow(readings, TruthObstacles(forget_s=1.0))
    assert [track_ids(e) for e in estimates] == [[], [1], [1], [1], []]
    assert estimates[2].tracks[0].stamp_us == PERIOD_US  # its tube grows meanwhile


def test_a_forgotten_track_must_be_confirmed_anew():
    mover = thing(1, moves=True)
    times = [0, PERIOD_US, 3_000_000, 3_020_000]
    estimates = follow([seen(t, mover) for t in times], TruthObstacles(forget_s=1.0))
    assert [track_ids(e) for e in estimates] == [[], [1], [], [1]]


def test_what_stood_and_begins_to_move_leaves_the_statics_at_once():
    readings = [seen(0, thing(1)), seen(PERIOD_US, thing(1, moves=True))]
    readings += [seen(2 * PERIOD_US, thing(1, moves=True))]
    estimates = follow(readings)
    assert [static_ids(e) for e in estimates] == [[1], [], []]
    assert [track_ids(e) for e in estimates] == [[], [], [1]]


def test_what_stands_at_another_place_than_before_is_moved_there():
    first, second = follow([seen(0, thing(1)), seen(PERIOD_US, thing(1, (5, 0, 0)))])
    np.testing.assert_array_equal(first.statics[0].p_WO, [0.0, 0.0, 0.0])
    np.testing.assert_array_equal(second.statics[0].p_WO, [5.0, 0.0, 0.0])


def test_a_step_leaves_the_memory_before_as_it_was():
    estimator = TruthObstacles(confirm_readings=1)
    memory, _ = estimator.step(estimator.init(), seen(0, thing(1), thing(2, moves=True)))
    estimator.step(memory, seen(9_000_000, thing(1, moves=True)))
    assert list(memory.statics) == [1]
    assert list(memory.tracks) == [2]


@pytest.mark.parametrize("name", ["forget_s", "tube_base_m", "growth_mps"])
def test_negative_parameters_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be >= 0"):
        TruthObstacles(**{name: -0.1})


def test_a_track_needs_a_reading():
    with pytest.raises(ValueError, match="confirm_readings must be >= 1, got 0"):
        TruthObstacles(confirm_readings=0)
