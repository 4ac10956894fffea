# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.perception.events.noise_filter import FLASH, FLICKER, KEPT, NOISE, NoiseFilter
from skyhaul.sensors.api import EventReading

from .conftest import part

W, H = 48, 36


def reading(rows):
    """Events from rows (t, x, y, p), put in order of time."""
    t, x, y, p = np.array(sorted(rows), dtype=np.int64).T
    return EventReading(t, x.astype(np.int16), y.astype(np.int16), p.astype(np.int8))


def sorted_out(events, **params):
    noise = NoiseFilter(**params)
    return noise.step(noise.init(W, H), events)[1]


def edge(speed_px_per_ms=0.5, rows=range(5, 15)):
    """An upright edge that sweeps to the right."""
    return [(int(x / speed_px_per_ms * 1000) + y, x, y, 1) for x in range(W) for y in rows]


def light(hz, x=30, y=25, seconds=0.3):
    """A lamp over 2 x 2 pixels that goes on and off."""
    half = 0.5e6 / hz
    beats = range(int(2 * hz * seconds))
    return [(int(i * half) + 10 * d, x + d % 2, y + d // 2, 1 if i % 2 == 0 else -1)
            for i in beats for d in range(4)]  # fmt: skip


def test_an_edge_passes_and_single_pixels_do_not():
    rng = np.random.default_rng(0)
    noise = [(int(t), int(rng.integers(W)), int(rng.integers(20, H)), 1)
             for t in rng.uniform(0, 90_000, 60)]  # fmt: skip
    events = reading(edge() + noise)
    why = sorted_out(events)
    real = events.y < 15
    assert np.mean(why[real] == KEPT) > 0.95
    assert np.mean(why[~real] == NOISE) > 0.8


@pytest.mark.parametrize("hz", [100.0, 120.0, 200.0])
def test_a_lamp_on_mains_is_dropped_after_a_few_periods(hz):
    why = sorted_out(reading(light(hz)))
    few = int(8 * (NoiseFilter().flicker_repeats + 2))
    assert np.all(why[few:] == FLICKER)


def test_a_light_slower_than_the_band_and_a_passing_edge_are_no_flicker():
    for rows in (light(20.0, seconds=1.0), edge()):
        assert not np.any(sorted_out(reading(rows)) == FLICKER)


def test_a_pixel_that_stops_flickering_is_heard_again():
    later = [(t + 900_000, x, y, p) for t, x, y, p in edge(rows=range(20, 30))]
    why = sorted_out(reading(light(100.0) + later))
    assert np.all(why[-300:] != FLICKER)


def test_a_lamp_that_fires_more_than_once_a_beat_is_a_lamp_too():
    rows = light(100.0) + [(t + 300, x, y, p) for t, x, y, p in light(100.0)]
    why = sorted_out(reading(rows))
    assert np.all(why[16 * (NoiseFilter().flicker_repeats + 2) :] == FLICKER)


def test_what_darkens_long_after_a_lamp_went_out_is_no_flicker():
    later = [(900_000 + 10 * d, 30 + d % 2, 25 + d // 2, -1) for d in range(4)]
    why = sorted_out(reading(light(100.0) + later))
    assert why[-5] == FLICKER
    assert np.all(why[-4:] != FLICKER)


def test_an_image_of_start_is_dropped_and_what_follows_is_not():
    start = [(0, x, y, 1) for x in range(W) for y in range(H)]
    why = sorted_out(reading(start + [(t + 9000, x, y, p) for t, x, y, p in edge()]))
    assert np.all(why[: W * H] == FLASH)
    assert np.mean(why[W * H :] == KEPT) > 0.95


def test_all_passes_when_all_is_switched_off():
    rng = np.random.default_rng(1)
    rows = [
        (int(t), int(rng.integers(W)), int(rng.integers(H)), 1) for t in rng.uniform(0, 1e6, 200)
    ]
    why = sorted_out(reading(rows + light(100.0)), support_us=0, flicker_repeats=0)
    assert np.all(why == KEPT)


def test_chunks_change_nothing(stream):
    events, _ = stream
    noise = NoiseFilter()
    _, whole = noise.step(noise.init(W, H), events)
    memory, parts = noise.init(W, H), []
    for a, b in ((0, 1), (1, 400), (400, 400), (400, 1500)):
        memory, why = noise.step(memory, part(events, a, b))
        parts.append(why)
    np.testing.assert_array_equal(np.concatenate(parts), whole)
