# SPDX-License-Identifier: Apache-2.0
"""Tests of `sensors.events`: one pixel against closed forms, many against their parameters."""

import math
from dataclasses import replace

import numpy as np
import pytest

from skyhaul.errors import GeometryError
from skyhaul.sensors.events.kernel import View
from skyhaul.sensors.events.pixels import EventPixels

IDEAL = EventPixels(
    threshold_on=0.2,
    threshold_off=0.2,
    threshold_spread=0.0,
    refractory_us=0.0,
    leak_hz=0.0,
    shot_hz=0.0,
    hot_share=0.0,
    cutoff_hz=math.inf,
    dark_level=1e-4,
)
"""No noise, no low-pass, no reset: every threshold of change is an event."""
WIDTH = 8


def view_of(log_light, surface=0, depth=1.0):
    u = np.atleast_1d(np.asarray(log_light, dtype=np.float64))
    light = (np.exp(u) - IDEAL.dark_level).astype(np.float32)
    return View(light, np.full(u.size, surface, np.int16), np.full(u.size, float(depth)))


def start(params, view, t_us=0, *, seed=0, aligned=True, width=None):
    """Pixels at a view; `aligned`: their references are what they see, as after an event."""
    size = view.light.shape[0]
    memory = params.init(view, width or size, t_us, np.random.default_rng(seed))
    if aligned:
        memory.pixels.state.reference[:] = memory.log_light
    return memory


def run(params, views, times, memory=None):
    """Everything that fires, as one array (k, 5): t, x, y, p, label."""
    memory = start(params, views[0], times[0]) if memory is None else memory
    out = []
    for view, t_us in zip(views[1:], times[1:], strict=True):
        memory, r, labels = params.step(memory, view, t_us)
        out.append(np.column_stack([r.t_us, r.x, r.y, r.p, labels.object_id]))
    return np.concatenate(out)


@pytest.mark.parametrize("slope", [5.0, -5.0])
@pytest.mark.parametrize("instants", [2, 5, 41])
def test_a_ramp_fires_at_the_closed_form_times(slope, instants):
    times = np.linspace(0, 190_000, instants).round().astype(int).tolist()
    events = run(IDEAL, [view_of(-1.0 + 1e-6 * slope * t) for t in times], times)
    expected = np.arange(1, 5) * 0.2 / abs(slope) * 1e6
    assert events[:, 0] == pytest.approx(expected, abs=1.5)
    assert set(events[:, 3]) == {np.sign(slope)}


def test_a_refractory_period_delays_each_event_after_the_first():
    params = replace(IDEAL, refractory_us=7_000.0)
    times = list(range(0, 300_001, 10_000))
    events = run(params, [view_of(-1.5 + 5e-6 * t) for t in times], times)
    assert events[:, 0] == pytest.approx(40_000 + 47_000 * np.arange(len(events)), abs=1.5)
    assert len(events) == 6


def test_different_thresholds_act_on_their_own_sign():
    params = replace(IDEAL, threshold_on=0.3, threshold_off=0.15)
    up = run(params, [view_of(-2.0), view_of(-1.07)], [0, 1000])
    down = run(params, [view_of(-2.0), view_of(-2.93)], [0, 1000])
    assert len(up) == 3
    assert len(down) == 6


def test_the_reference_remembers_what_did_not_reach_the_threshold():
    steps = [-1.0, -0.85, -1.0, -0.85, -0.78]
    events = run(IDEAL, [view_of(u) for u in steps], [0, 100, 200, 300, 400])
    assert len(events) == 1
    assert events[0, 0] == pytest.approx(300 + 100 * 0.05 / 0.07, abs=1)


def texture(seed=3, size=160, width=60):
    """A smooth random texture that a camera can look at shifted, (rows, columns) -> light."""
    rng = np.random.default_rng(seed)
    x, y = np.arange(width), np.arange(size // width + 1)[:, None]
    waves = [(rng.uniform(0.2, 0.9), rng.uniform(-0.8, 0.8), rng.uniform(0, 7)) for _ in range(5)]

    def at(shift):
        u = -2.0 + sum(0.25 * np.sin(a * (x + shift) + b * y + c) for a, b, c in waves)
        return view_of(u.ravel())

    return at


def test_three_times_slower_is_three_times_later():
    at, times = texture(), list(range(0, 60_001, 4_000))
    views = [at(1e-4 * t) for t in times]
    fast = run(IDEAL, views, times)
    slow = run(IDEAL, views, [3 * t for t in times])
    order_fast, order_slow = (np.lexsort((e[:, 0], e[:, 1], e[:, 2])) for e in (fast, slow))
    assert len(fast) > 500
    assert np.array_equal(fast[order_fast, 1:], slow[order_slow, 1:])
    assert np.abs(slow[order_slow, 0] - 3 * fast[order_fast, 0]).max() <= 2


def test_on_and_off_are_symmetric_when_the_thresholds_are():
    at, times = texture(), list(range(0, 40_001, 4_000))
    u = [np.log(at(1e-4 * t).light + IDEAL.dark_level) for t in times]
    events = run(IDEAL, [view_of(v) for v in u], times)
    mirrored = run(IDEAL, [view_of(-4.0 - v) for v in u], times)
    assert len(events) > 300
    assert np.array_equal(events[:, 1:3], mirrored[:, 1:3])
    assert np.array_equal(events[:, 3], -mirrored[:, 3])


def test_stamps_are_sorted_whole_microseconds_inside_the_interval():
    at = texture()
    memory = start(EventPixels(), at(0.0), 1_000, width=60, aligned=False)
    for k in range(1, 8):
        memory, r, labels = EventPixels().step(memory, at(0.7 * k), 1_000 + 7_000 * k)
        assert r.t_us.dtype == np.int64
        assert r.x.dtype == r.y.dtype == labels.object_id.dtype == np.int16
        assert r.p.dtype == np.int8
        assert len(r.t_us) > 15
        assert np.all(np.diff(r.t_us) >= 0)
        assert r.t_us[0] >= 1_000 + 7_000 * (k - 1)
        assert r.t_us[-1] <= 1_000 + 7_000 * k
        assert set(r.p) == {-1, 1}
        assert len(np.unique(r.t_us)) > 0.9 * len(r.t_us)
        assert r.x.max() < 60
        assert r.y.max() < at(0.0).light.size // 60


def test_the_low_pass_attenuates_a_flicker_as_first_order_does():
    """A sine of log intensity with cutoff f_c comes out smaller by sqrt(1 + (f / f_c)^2)."""
    cutoff, least, gains = 50.0, 0.01, []
    params = replace(
        IDEAL, threshold_on=least, threshold_off=least, cutoff_hz=2.0 * cutoff, cutoff_floor=0.5
    )  # so dim a light has the cutoff of the floor
    for f in (5.0, 50.0, 200.0):
        period = 1e6 / f
        times = np.round(np.arange(0, 12.0, 0.01) * period).astype(int).tolist()
        views = [view_of(-2.7 + 0.5 * math.sin(2e-6 * math.pi * f * t)) for t in times]
        events = run(params, views, times)
        net = least * np.cumsum(events[events[:, 0] > 6 * period, 3])
        gains.append(net.max() - net.min())
    expected = [1.0 / math.hypot(1.0, f / cutoff) for f in (5.0, 50.0, 200.0)]
    assert gains == pytest.approx(expected, abs=0.025)


def test_the_cutoff_is_proportional_to_the_light():
    """After a step the low-pass of a pixel four times as bright is four times as fast."""
    params = replace(IDEAL, cutoff_hz=100.0, cutoff_floor=0.01)
    when = []
    for light in (0.8, 0.2):
        high = math.log(light)
        views = [view_of(high - 0.5), view_of(high), view_of(high)]
        events = run(params, views, [0, 1, 400_001])
        assert len(events) == 2
        when.append(events[:, 0] - 1)
    tau_us = 1e6 / (2.0 * math.pi * 100.0 * 0.8)
    assert when[0] == pytest.approx(-tau_us * np.log([0.3 / 0.5, 0.1 / 0.5]), abs=3)
    assert when[1] == pytest.approx(4.0 * when[0], rel=2e-3)


def test_a_swing_of_the_low_pass_inside_an_interval_fires_both_ways():
    """The low-pass still falls, then turns and rises, between two renderings."""
    params = replace(
        IDEAL, cutoff_hz=100.0, cutoff_floor=1.0, threshold_on=0.05, threshold_off=0.05
    )
    views = [view_of(-1.0), view_of(-2.0), view_of(-0.5)]
    events = run(params, views, [0, 10, 20_010])
    dense_t = [0, 10, *range(110, 20_011, 100)]
    dense = [view_of(-1.0), *(view_of(-2.0 + 1.5 * (t - 10) / 20_000) for t in dense_t[1:])]
    reference = run(params, dense, dense_t)
    assert set(events[:, 3]) == {-1, 1}
    assert events[:, 3].tolist() == reference[:, 3].tolist()
    assert np.abs(events[:, 0] - reference[:, 0]).max() <= 20


def static(params, seconds, light=0.5, size=4_000, seed=5, every_us=50_000):
    """Events of pixels in constant light."""
    view = View(np.full(size, light, np.float32), np.zeros(size, np.int16), np.ones(size))
    times = list(range(0, round(1e6 * seconds) + 1, every_us))
    memory = start(params, view, 0, seed=seed, aligned=False, width=50)
    return run(params, [view] * len(times), times, memory)


def test_leak_fires_on_at_its_rate_and_is_labelled_noise():
    events = static(replace(IDEAL, leak_hz=2.0, threshold_spread=0.02), 10.0)
    settled = events[events[:, 0] > 1_000_000]
    assert len(settled) == pytest.approx(4_000 * 18, rel=0.01)
    assert np.all(events[:, 3] == 1)
    assert np.all(settled[:, 4] == -1)
    per_tenth, _ = np.histogram(settled[:, 0], 90, (1e6, 1e7))
    assert per_tenth == pytest.approx(np.full(90, 800.0), rel=0.25)  # pixels are out of step


@pytest.mark.parametrize(("light", "rate"), [(0.0, 3.0), (0.5, 1.875), (1.0, 0.75)])
def test_shot_noise_is_a_poisson_process_whose_rate_falls_with_light(light, rate):
    events = static(replace(IDEAL, shot_hz=3.0), 5.0, light)
    counts = np.bincount(events[:, 1] + 50 * events[:, 2], minlength=4_000)
    mean = 5.0 * rate
    assert counts.mean() == pytest.approx(mean, abs=4.0 * math.sqrt(mean / 4_000))
    assert counts.var() == pytest.approx(mean, rel=0.1)
    assert np.mean(events[:, 3]) == pytest.approx(0.0, abs=4.0 / math.sqrt(len(events)))
    assert np.all(events[:, 4] == -1)


def test_hot_pixels_are_few_and_fire_at_their_rate():
    events = static(replace(IDEAL, hot_share=0.01, hot_hz=20.0), 10.0)
    pixels, counts = np.unique(events[:, 1] + 50 * events[:, 2], return_counts=True)
    assert 20 <= len(pixels) <= 60
    assert counts.mean() == pytest.approx(200.0, rel=0.05)


def test_thresholds_spread_as_asked():
    params = replace(IDEAL, threshold_on=0.25, threshold_spread=0.03)
    memory = start(params, view_of(np.full(20_000, -1.0)))
    on, off = memory.pixels.traits.on, memory.pixels.traits.off
    assert on.mean() == pytest.approx(0.25, abs=1e-3)
    assert off.mean() == pytest.approx(0.20, abs=1e-3)
    assert on.std() == pytest.approx(0.03, rel=0.03)
    assert np.corrcoef(on, off)[0, 1] == pytest.approx(0.0, abs=0.03)


def test_noise_does_not_depend_on_the_instants_of_rendering():
    params = replace(IDEAL, shot_hz=3.0, hot_share=0.01)
    coarse, fine = (static(params, 2.0, every_us=e) for e in (100_000, 4_000))
    assert len(coarse) > 10_000
    assert np.array_equal(coarse, fine)


def edge(position, size=40):
    """A dark mover, 7, at 1 m covers a bright wall, 2, at 5 m up to a position."""
    x = np.arange(size)
    mover = x < position
    light = np.where(mover, 0.1, 0.8).astype(np.float32)
    return View(light, np.where(mover, 7, 2).astype(np.int16), np.where(mover, 1.0, 5.0))


@pytest.mark.parametrize("direction", [1, -1])
def test_both_sides_of_an_occlusion_are_labelled_with_the_nearer_object(direction):
    times = list(range(0, 80_001, 2_000))
    views = [edge(20 + direction * 2e-4 * t) for t in times]
    params = replace(IDEAL, cutoff_hz=300.0)
    events = run(params, views, times, start(params, views[0], width=40))
    assert len(events) > 100
    assert np.mean(events[:, 4] == 7) > 0.97
    assert np.all(events[:, 3] == -direction)


def test_a_slow_pixel_still_blames_the_edge_that_has_passed():
    params = replace(IDEAL, cutoff_hz=10.0, cutoff_floor=1.0)
    wall, mover = view_of(-0.5, 2, 5.0), view_of(-2.5, 7, 1.0)
    events = run(params, [wall, mover, wall, wall, wall], [0, 30_000, 32_000, 40_000, 200_000])
    late = events[events[:, 0] > 40_000]
    assert len(late) >= 2
    assert np.all(events[:, 4] == 7)


def test_moving_texture_is_labelled_with_its_own_surface():
    at, times = texture(), list(range(0, 40_001, 4_000))
    views = [at(1e-4 * t) for t in times]
    half = (np.arange(views[0].light.size) % 2).astype(np.int16)
    views = [v._replace(surface=half + 3) for v in views]
    memory = start(EventPixels(shot_hz=0.0, leak_hz=0.0), views[0], width=60)
    events = run(EventPixels(shot_hz=0.0, leak_hz=0.0, hot_share=0.0), views, times, memory)
    assert np.array_equal(events[:, 4], 3 + (events[:, 1] + 60 * events[:, 2]) % 2)


def test_a_view_of_another_size_or_an_earlier_time_is_refused():
    memory = start(IDEAL, view_of([-1.0, -1.0]), 100)
    with pytest.raises(GeometryError, match="order of time"):
        IDEAL.step(memory, view_of([-1.0, -1.0]), 100)
    with pytest.raises(GeometryError, match="one size"):
        IDEAL.step(memory, view_of([-1.0]), 200)


@pytest.mark.parametrize(
    "wrong",
    [
        {"threshold_on": 0.0}, {"threshold_off": math.nan}, {"threshold_spread": -1.0},
        {"refractory_us": math.inf}, {"leak_hz": -1.0}, {"shot_hz": 1e9}, {"hot_share": 1.1},
        {"cutoff_hz": 0.0}, {"cutoff_floor": 0.0}, {"dark_level": 0.0},
    ],
)  # fmt: skip
def test_parameters_out_of_range_are_refused_by_name(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        EventPixels(**wrong)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_pixel_that_is_shown_no_number_holds_and_then_recovers(bad):
    params, times = replace(IDEAL, cutoff_hz=300.0), list(range(0, 100_001, 5_000))
    views = [view_of([-1.0 + 3e-6 * t, -1.0]) for t in times]
    for k in (0, 4):
        light = views[k].light.copy()
        light[1] = bad
        views[k] = views[k]._replace(light=light)
    memory = start(params, views[0])
    for view, t_us in zip(views[1:], times[1:], strict=True):
        memory, *_ = params.step(memory, view, t_us)
        assert np.all(np.isfinite(memory.pixels.state.low_pass))
    assert memory.pixels.state.low_pass[1] == pytest.approx(-1.0, abs=1e-3)
