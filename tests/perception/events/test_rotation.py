# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.geometry.camera import project_points
from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.events.lens import event_lens
from skyhaul.perception.events.recordings import read_calibration, read_rate, read_recording
from skyhaul.perception.events.rotation import TurnMemory, derotated, turn_at, warped_contrast
from skyhaul.sensors.api import EventReading


def test_turn_is_the_integral_of_the_rate():
    """A rate that rises linearly, sampled: its integral is exact, whatever the chunks."""
    stamp = np.arange(0, 100_001, 5_000)
    rate = np.outer(1e-6 * stamp, [3.0, -2.0, 1.0])
    t = np.sort(np.random.default_rng(0).integers(0, 100_001, 400))
    wanted = np.outer(0.5 * (1e-6 * t) ** 2, [3.0, -2.0, 1.0])
    _, whole = turn_at(TurnMemory(), stamp, rate, t)
    np.testing.assert_allclose(whole, wanted, atol=1e-12)
    memory, parts = TurnMemory(), []
    for a, b in ((0, 7), (7, 8), (8, 21)):
        end = stamp[b] if b < 21 else 10**9
        mine = t[(t >= stamp[a]) & (t < end)]
        _, parts_of = turn_at(memory, stamp[a : b + 1], rate[a : b + 1], mine)
        memory, _ = turn_at(memory, stamp[a:b], rate[a:b], mine[:0])
        parts.append(parts_of)
    np.testing.assert_allclose(np.concatenate(parts), wanted, atol=1e-12)


def test_rate_is_held_before_the_first_and_after_the_last_sample():
    _, turn = turn_at(
        TurnMemory(), np.array([1_000]), np.ones((1, 3)), np.array([0, 1_000, 11_000])
    )
    np.testing.assert_allclose(turn, np.outer([-1e-3, 0.0, 1e-2], np.ones(3)))


def test_without_a_gyro_the_camera_stands():
    memory, turn = turn_at(TurnMemory(), np.zeros(0, np.int64), np.zeros((0, 3)), np.arange(5))
    assert memory.turn_C is None
    assert not turn.any()


def test_turn_flow_is_where_a_standing_point_goes(lens):
    turn = np.array([2e-3, -3e-3, 4e-3])
    before = lens.rays_C.reshape(-1, 3)
    after, seen = project_points(lens.model, before @ so3_exp(turn))
    u, v = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
    shift = after - np.column_stack([u.ravel(), v.ravel()])
    np.testing.assert_allclose((lens.turn_flow @ turn).reshape(-1, 2), shift, atol=5e-3)
    assert seen.all()


def test_events_of_a_standing_point_fall_together_after_derotation(lens):
    ray, w = lens.rays_C[18, 20], np.array([0.5, 1.0, -2.0])
    t = np.arange(0, 100_000, 5_000)
    turn = np.outer(1e-6 * t, w)
    at = np.array([project_points(lens.model, (so3_exp(a).T @ ray)[None])[0][0] for a in turn])
    x, y = np.round(at).astype(np.int16).T
    events = EventReading(t, x, y, np.ones(len(t), np.int8))
    uv = derotated(lens, events, turn, turn[-1])
    assert np.ptp(at, axis=0).max() > 3.0
    assert np.abs(uv - at[-1]).max() < 1.0


@pytest.mark.parametrize("clip", ["poster_rotation", "shapes_rotation"])
def test_contrast_of_a_real_turn_rises_with_its_rate_and_falls_against_it(data, clip):
    folder = data / "ijrr" / clip
    events = read_recording(folder / "events.txt").events
    lens = event_lens(read_calibration(folder / "calib.txt", (240, 180)))
    rate = read_rate(folder / "motion.txt")
    _, turn = turn_at(TurnMemory(), events.t_us[:1], rate[None], events.t_us)
    contrast = {
        s: warped_contrast(lens, derotated(lens, events, s * turn, s * turn[0])) for s in (-1, 0, 1)
    }
    assert contrast[1] > 1.1 * contrast[0]
    assert contrast[-1] < 0.9 * contrast[0]
