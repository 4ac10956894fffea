# SPDX-License-Identifier: Apache-2.0
"""What every event classifier must do. A new one adds one entry to CLASSIFIERS."""

import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan
from skyhaul.perception.events.classifier import EventNetwork
from skyhaul.perception.events.graph import GraphParams
from skyhaul.perception.events.lens import event_lens
from skyhaul.perception.events.timestamp import TimestampParams
from skyhaul.perception.events.weights import random_weights, shipped_weights
from skyhaul.sensors.api import EventReading

CLASSIFIERS = {
    "timestamp": TimestampParams(),
    "network-shared": EventNetwork(random_weights(GraphParams(), has_table=False)),
    "network-shipped": EventNetwork(shipped_weights()),
    "network-table": EventNetwork(random_weights(GraphParams(), has_table=True)),
}
LENS = event_lens(RadTan.from_fov((50, 40), 60.0))
STEP_US = 10_000

every_classifier = pytest.mark.parametrize(
    "classifier", CLASSIFIERS.values(), ids=CLASSIFIERS.keys()
)


def events(seed=0, steps=5, rate=200):
    """Readings of a moving patch and noise, with the camera's turn."""
    rng, out = np.random.default_rng(seed), []
    for k in range(steps):
        t = np.sort(rng.integers(STEP_US * k, STEP_US * (k + 1), rate))
        patch = rng.random(rate) < 0.7
        x = np.where(patch, 5 + t / 2000 + rng.integers(0, 4, rate), rng.integers(0, 50, rate))
        y = np.where(patch, rng.integers(15, 22, rate), rng.integers(0, 40, rate))
        p = rng.choice([-1, 1], rate)
        reading = EventReading(t, x.astype(np.int16), y.astype(np.int16), p.astype(np.int8))
        out.append((reading, np.outer(1e-6 * t, [0.2, 0.5, -0.3])))
    return out


def run(classifier, readings):
    memory, out = classifier.init(LENS), []
    for reading, turn_C in readings:
        memory, scores = classifier.step(memory, reading, turn_C)
        out.append(scores)
    return memory, out


@every_classifier
def test_every_event_and_every_cell_gets_a_probability(classifier):
    readings = events()
    for (reading, _), scores in zip(readings, run(classifier, readings)[1], strict=True):
        assert scores.p_mover.shape == reading.t_us.shape
        cells = -(-40 // scores.cell_px), -(-50 // scores.cell_px)
        assert scores.objectness.shape == cells
        for values in (scores.p_mover, scores.objectness):
            assert np.all((values >= 0.0) & (values <= 1.0))
        assert scores.stamp_us == reading.t_us[-1]
        assert not scores.p_mover.flags.writeable


@every_classifier
def test_it_tells_something_apart(classifier):
    last = run(classifier, events())[1][-1]
    assert np.ptp(last.p_mover) > 0.1
    assert np.ptp(last.objectness) > 0.0


@every_classifier
def test_same_events_same_scores(classifier):
    a, b = (run(classifier, events())[1] for _ in range(2))
    for one, other in zip(a, b, strict=True):
        assert one.p_mover.tobytes() == other.p_mover.tobytes()
        assert one.objectness.tobytes() == other.objectness.tobytes()


@every_classifier
def test_the_past_is_not_changed_by_what_comes(classifier):
    short, long = events(steps=3), events(steps=5)
    for a, b in zip(run(classifier, short)[1], run(classifier, long)[1], strict=False):
        np.testing.assert_array_equal(a.p_mover, b.p_mover)


@every_classifier
def test_an_empty_reading_is_no_event(classifier):
    none = np.zeros(0, np.int64)
    empty = EventReading(none, none.astype(np.int16), none.astype(np.int16), none.astype(np.int8))
    memory, (scores,) = run(classifier, [(empty, np.zeros((0, 3)))])
    assert scores.p_mover.shape == (0,)
    assert classifier.work(memory).events == 0
    memory, _ = run(classifier, [*events(), (empty, np.zeros((0, 3))), *events(steps=0)])
    assert classifier.work(memory).events == 1000


@every_classifier
def test_a_camera_that_only_turns_has_no_velocity(classifier):
    for reading, turn_C in events(steps=2):
        still = np.zeros((len(reading.t_us), 3))
        _, told = classifier.step(classifier.init(LENS), reading, turn_C, still)
        _, untold = classifier.step(classifier.init(LENS), reading, turn_C)
        np.testing.assert_array_equal(told.p_mover, untold.p_mover)


@every_classifier
def test_work_is_counted(classifier):
    memory, _ = run(classifier, events())
    work = classifier.work(memory)
    assert work.events == 1000
    assert 0 < work.evaluated <= work.events
    assert 0.0 <= work.skipped_fraction < 1.0
