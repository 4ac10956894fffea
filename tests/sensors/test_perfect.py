# SPDX-License-Identifier: Apache-2.0
"""Perfect sensors against closed forms: reach, hiding, and what was seen to move."""

import numpy as np
import pytest

from skyhaul.geometry.shapes import Box, Capsule, Sphere, shape_size
from skyhaul.sensors.perfect import PerfectObjects, PerfectState


def ids(reading):
    return [o.object_id for o in reading.objects]


def look(truth, shapes, sensor=None):
    sensor = sensor or PerfectObjects()
    return sensor.read(sensor.init(len(shapes)), truth, tuple(shapes))[1]


def signed_distance(shape, p_WO, p):
    """Distance of points (k, 3) to an upright shape without yaw, written out once more."""
    d = p - p_WO
    match shape:
        case Sphere():
            return np.linalg.norm(d, axis=-1) - shape.radius_m
        case Box():
            gap = np.abs(d) - 0.5 * np.array(shape.size_m)
            outside = np.linalg.norm(np.maximum(gap, 0.0), axis=-1)
            return outside + np.minimum(gap.max(axis=-1), 0.0)
        case Capsule():
            d = d.copy()
            d[..., 2] -= np.clip(d[..., 2], -0.5 * shape.length_m, 0.5 * shape.length_m)
            return np.linalg.norm(d, axis=-1) - shape.radius_m


def random_shape(rng):
    size = rng.uniform(0.1, 0.5, 3)
    return [
        Sphere(radius_m=size[0]),
        Box(size_m=tuple(2.0 * size)),
        Capsule(radius_m=size[0], length_m=3.0 * size[1]),
    ][rng.integers(3)]


def sight(p, target, others, shape_of):
    """How free the line from p to the target's centre is, and how near its surface [m]."""
    line = p + np.linspace(0.0, 1.0, 1001)[:, None] * (target[1] - p)
    free = min(signed_distance(shape_of[k], p_WO, line).min() for k, p_WO in others)
    return free, signed_distance(shape_of[target[0]], target[1], p)


@pytest.mark.parametrize("n", [1, 3])
def test_seen_is_what_some_vehicle_has_in_reach_with_a_free_line_to_its_centre(make_truth, n):
    rng, sensor, hidden = np.random.default_rng(n), PerfectObjects(range_m=2.0), 0
    for _ in range(12):
        shapes = [random_shape(rng) for _ in range(20)]
        p_WO, p_WB = rng.uniform(-2.0, 2.0, (20, 3)), rng.uniform(-2.0, 2.0, (n, 3))
        present = rng.random(20) < 0.9
        there, expected = [(j, p_WO[j]) for j in np.flatnonzero(present)], []
        for target in there:
            others = [o for o in there if o is not target]
            views = np.array([sight(p, target, others, shapes) for p in p_WB])
            assert np.abs(views - [0.0, 2.0]).min() > 1e-5  # no close call
            hidden += np.sum((views[:, 0] < 0.0) & (views[:, 1] < 2.0))
            expected += [target[0]] * bool(np.any((views[:, 0] > 0.0) & (views[:, 1] < 2.0)))
        truth = make_truth(p_WB, shapes, p_WO, present=present)
        assert ids(look(truth, shapes, sensor)) == expected
    assert hidden > 5


@pytest.mark.parametrize("shape", [Sphere(radius_m=0.5), Box(size_m=(1.0, 9.0, 9.0))])
def test_reach_ends_at_the_surface_not_at_the_centre(make_truth, shape):
    for gap, seen in ((3.999, [0]), (4.001, [])):
        truth = make_truth([[0.0, 0.0, 0.0]], [shape], [[gap + 0.5, 0.0, 0.0]])
        assert ids(look(truth, [shape])) == seen


def test_one_vehicle_that_sees_past_the_screen_is_enough(make_truth):
    shapes = [Sphere(radius_m=0.2), Box(size_m=(0.2, 1.0, 1.0))]
    p_WO = [[2.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    behind, beside = [0.0, 0.0, 0.0], [2.0, 2.0, 0.0]
    assert ids(look(make_truth([behind], shapes, p_WO), shapes)) == [1]
    assert ids(look(make_truth([behind, beside], shapes, p_WO), shapes)) == [0, 1]


def test_what_is_not_there_yet_is_not_seen_and_hides_nothing(make_truth):
    shapes = [Sphere(radius_m=0.2), Box(size_m=(0.2, 1.0, 1.0))]
    p_WO = [[2.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    truth = make_truth([[0.0, 0.0, 0.0]], shapes, p_WO, present=[True, False])
    assert ids(look(truth, shapes)) == [0]


def test_a_reading_tells_place_attitude_velocity_and_shape_exactly(make_truth):
    box = Box(size_m=(0.4, 0.6, 0.8), yaw_deg=30.0)
    truth = make_truth([[0.0, 0.0, 0.0]], [box], [[1.0, 2.0, 0.5]], [[0.1, -0.2, 0.3]], t_us=7)
    reading = look(truth, [box])
    (o,) = reading.objects
    assert reading.stamp_us == 7
    assert o.shape is box
    np.testing.assert_array_equal(o.p_WO, [1.0, 2.0, 0.5])
    np.testing.assert_array_equal(o.v_WO, [0.1, -0.2, 0.3])
    np.testing.assert_allclose(o.R_WO, shape_size(box)[2])
    truth.obstacles.p_WO[:] = 9.0  # the plant may write into its arrays
    np.testing.assert_array_equal(o.p_WO, [1.0, 2.0, 0.5])


def test_what_was_seen_moving_counts_as_a_mover_for_good(make_truth):
    ball, sensor = [Sphere(radius_m=0.2)], PerfectObjects()
    memory, told = sensor.init(1), []
    for x, v in ((1.0, 0.0), (1.0, 0.5), (1.0, 0.0), (9.0, 0.0), (1.0, 0.0)):
        truth = make_truth([[0.0, 0.0, 0.0]], ball, [[x, 0.0, 0.0]], [[v, 0.0, 0.0]])
        memory, reading = sensor.read(memory, truth, tuple(ball))
        told.append([o.moves for o in reading.objects])
    assert told == [[False], [True], [True], [], [True]]


def test_motion_out_of_sight_is_not_known(make_truth):
    ball, sensor = [Sphere(radius_m=0.2)], PerfectObjects()
    memory = sensor.init(1)
    for x, v in ((9.0, 0.5), (1.0, 0.0)):
        truth = make_truth([[0.0, 0.0, 0.0]], ball, [[x, 0.0, 0.0]], [[v, 0.0, 0.0]])
        memory, reading = sensor.read(memory, truth, tuple(ball))
    assert [o.moves for o in reading.objects] == [False]


def test_reading_leaves_the_memory_before_as_it_was(make_truth):
    ball, sensor = [Sphere(radius_m=0.2)], PerfectObjects()
    before = sensor.init(1)
    truth = make_truth([[0.0, 0.0, 0.0]], ball, [[1.0, 0.0, 0.0]], [[0.5, 0.0, 0.0]])
    after, _ = sensor.read(before, truth, tuple(ball))
    assert not before.seen.any()
    assert not before.moved.any()
    assert after.seen.all()


def test_an_empty_world_is_an_empty_reading(make_truth):
    truth = make_truth([[0.0, 0.0, 0.0]], [], np.zeros((0, 3)))
    assert look(truth, []).objects == ()


def test_the_state_is_handed_on_with_the_total_thrust_of_each_vehicle(make_truth):
    thrust = np.random.default_rng(0).random((3, 4))
    truth = make_truth(np.eye(3), [], np.zeros((0, 3)), t_us=5, rotor_thrust=thrust)
    reading = PerfectState().read(truth)
    assert reading.team is truth.team
    assert reading.cables is truth.cables
    assert reading.stamp_us == 5
    np.testing.assert_allclose(reading.thrust, thrust @ np.ones(4))


def test_a_reach_of_nothing_is_refused():
    with pytest.raises(ValueError, match="range_m must be > 0, got 0"):
        PerfectObjects(range_m=0.0)
