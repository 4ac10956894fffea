# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan
from skyhaul.sensors.api import EventReading
from skyhaul.training.scenes import MOVES, STANDS, TEAM, LabelledStream, load_stream, save_stream
from skyhaul.training.score import Count, Score, score

MODEL = RadTan.from_fov((80, 60), 60.0)


def patch(rng, count, x0, y0):
    return np.column_stack([x0 + rng.integers(0, 4, count), y0 + rng.integers(0, 4, count)])


@pytest.fixture
def stream():
    """200 events of a mover, 100 of what stands, 30 of a vehicle, within 40 ms."""
    rng = np.random.default_rng(0)
    xy = np.concatenate([patch(rng, 200, 10, 10), patch(rng, 100, 60, 40), patch(rng, 30, 30, 50)])
    label = np.repeat([MOVES, STANDS, TEAM], [200, 100, 30])
    owner = np.repeat([7, 1, 9], [200, 100, 30])
    order = rng.permutation(330)
    t = np.sort(rng.integers(0, 40_000, 330))
    x, y = xy[order].T.astype(np.int16)
    events = EventReading(t, x, y, np.ones(330, np.int8))
    zeros = np.zeros((330, 3))
    return LabelledStream(MODEL, events, zeros, zeros, label[order], owner[order])


def test_the_right_answer_scores_one(stream):
    found = score(stream, (stream.label == MOVES).astype(np.float32))
    assert found.events == Count(200, 200, 200)
    assert found.events.f1 == found.object_f1 == 1.0
    assert found.false_share == 0.0


def test_the_team_counts_neither_way(stream):
    called = (stream.label != STANDS).astype(np.float32)
    assert score(stream, called).events == Count(200, 200, 200)


def test_what_stands_and_is_called_costs_precision(stream):
    found = score(stream, np.ones(330, np.float32))
    assert found.events.precision == pytest.approx(2 / 3)
    assert found.false_share == 1.0
    assert found.clusters.precision == 0.5
    assert found.objects.recall == 1.0


def test_a_mover_is_found_when_half_of_its_events_are_called(stream):
    moves = np.flatnonzero(stream.label == MOVES)
    for share, recall in ((0.4, 0.0), (0.6, 1.0)):
        called = np.zeros(330, np.float32)
        called[moves[: int(share * 200)]] = 1.0
        assert score(stream, called).objects.recall == recall


def test_scores_add_up(stream):
    a = score(stream, (stream.label == MOVES).astype(np.float32))
    both = a + score(stream, np.zeros(330, np.float32))
    assert both.events == Count(200, 200, 400)
    assert both.standing == 200
    assert (Score() + a) == a


def test_a_stream_comes_back_from_its_file(stream, tmp_path):
    save_stream(stream, tmp_path / "a.npz")
    back = load_stream(tmp_path / "a.npz")
    assert back.model == stream.model
    for name in ("t_us", "x", "y", "p"):
        np.testing.assert_array_equal(getattr(back.events, name), getattr(stream.events, name))
    for name in ("turn_C", "v_WC_C", "label", "object_id"):
        np.testing.assert_array_equal(getattr(back, name), getattr(stream, name))
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]
