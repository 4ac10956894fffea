# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan, project_points
from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.events.lens import event_lens
from skyhaul.perception.events.recordings import read_calibration, read_rate, read_recording
from skyhaul.perception.events.rotation import TurnMemory, turn_at
from skyhaul.perception.events.timestamp import TimestampParams
from skyhaul.sensors.api import EventReading

from .conftest import part

LENS = event_lens(RadTan.from_fov((160, 120), 70.0))
STEP_US = 10_000


def room(w, seconds=0.06, seed=0):
    """A camera that turns at w before points that stand, and a bar that crosses the image."""
    rng = np.random.default_rng(seed)
    rays = LENS.rays_C[::9, ::9].reshape(-1, 3)
    rows = []
    for t in np.arange(0, seconds * 1e6, 1_000):
        uv, _ = project_points(LENS.model, rays @ so3_exp(1e-6 * t * w))
        fires = rng.random(len(uv)) < 0.4
        at = np.round(uv[fires] + rng.normal(0, 0.3, (fires.sum(), 2)))
        rows += [(t, u, v, 0) for u, v in at]
        bar = 20 + 1.2e-3 * t
        rows += [(t, bar + d, v, 1) for v in range(50, 70) for d in (0, 1) if rng.random() < 0.5]
    t, x, y, moves = np.array(rows).T
    keep = (x >= 0) & (y >= 0) & (x < 160) & (y < 120)
    t, x, y, moves = (a[keep].astype(np.int64) for a in (t, x, y, moves))
    events = EventReading(t, x.astype(np.int16), y.astype(np.int16), np.ones(len(t), np.int8))
    return events, np.outer(1e-6 * t, w), moves.astype(bool)


def scored(lens, events, turn_C):
    """Probabilities of all events, judged in steps of 10 ms."""
    params, out = TimestampParams(), []
    memory = params.init(lens)
    for t in range(int(events.t_us[0]), int(events.t_us[-1]) + 1, STEP_US):
        a, b = np.searchsorted(events.t_us, [t, t + STEP_US])
        memory, scores = params.step(memory, part(events, a, b), turn_C[a:b])
        out.append(scores.p_mover)
    return np.concatenate(out)


@pytest.mark.parametrize("w", [(0.0, 0.0, 0.0), (0.0, 1.5, 0.0), (1.0, -1.0, 2.0)])
def test_a_crossing_bar_is_told_from_a_room_that_turns(w):
    events, turn_C, moves = room(np.array(w))
    late = events.t_us > 25_000
    mover = scored(LENS, events, turn_C) >= 0.5
    assert np.mean(mover[late & moves]) > 0.8
    beside_the_bar = np.abs(events.y - 60) < 14
    assert np.mean(mover[late & ~moves & ~beside_the_bar]) < 0.02
    assert np.mean(mover[late & ~moves]) < 0.08


def test_without_the_gyro_a_turn_is_taken_for_movement():
    events, turn_C, moves = room(np.array([0.0, 3.0, 0.0]))
    with_gyro, without = (scored(LENS, events, k * turn_C)[~moves] >= 0.5 for k in (1, 0))
    assert np.mean(without) > 5 * np.mean(with_gyro)
    assert np.mean(without) > 0.03


def test_nothing_moves_before_the_window_tells():
    events, turn_C, _ = room(np.zeros(3), seconds=0.012)
    assert not np.any(scored(LENS, events, turn_C))


@pytest.mark.parametrize("clip", ["poster_rotation", "shapes_rotation"])
def test_a_real_scene_that_only_turns_has_no_movers(data, clip):
    folder = data / "ijrr" / clip
    events = read_recording(folder / "events.txt").events
    lens = event_lens(read_calibration(folder / "calib.txt", (240, 180)))
    rate = read_rate(folder / "motion.txt")
    _, turn_C = turn_at(TurnMemory(), events.t_us[:1], rate[None], events.t_us)
    assert np.mean(scored(lens, events, turn_C) >= 0.5) <= 0.03
