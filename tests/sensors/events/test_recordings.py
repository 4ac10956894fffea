# SPDX-License-Identifier: Apache-2.0
"""Event pixels against a recorded DAVIS240, and against another simulator on the same frames."""

import importlib
import math
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from skyhaul.sensors.events.kernel import View
from skyhaul.sensors.events.pixels import EventPixels

DATA = Path(os.environ.get("SKYHAUL_DATA", Path(__file__).parents[4] / "shared" / "data"))
SLIDER = DATA / "slider_depth"
BLACK = 5.0
ROWS, COLUMNS = 180, 240


@pytest.fixture(scope="module")
def slider():
    """Frames (5, 180, 240), their stamps [us], and events as t [us], x, y, p."""
    if not SLIDER.is_dir():
        pytest.skip(f"no recording at {SLIDER}; set SKYHAUL_DATA")
    listed = [line.split() for line in (SLIDER / "images.txt").read_text().splitlines()[:5]]
    frames = [cv2.imread(str(SLIDER / name), cv2.IMREAD_GRAYSCALE) for _, name in listed]
    t_us = np.round(1e6 * np.array([float(t) for t, _ in listed])).astype(int)
    events = np.loadtxt(SLIDER / "events_chunk.txt") * [1e6, 1.0, 1.0, 2.0] - [0.0, 0.0, 0.0, 1.0]
    return np.array(frames, dtype=np.float32), t_us, events.astype(int)


def simulated(slider, on, off):
    """Net count of each pixel in each interval, the events' stamps and number."""
    frames, t_us, _ = slider
    params = EventPixels(
        threshold_on=on, threshold_off=off, threshold_spread=0.0, refractory_us=0.0, leak_hz=0.0,
        shot_hz=0.0, hot_share=0.0, cutoff_hz=math.inf, dark_level=BLACK / 255.0,
    )  # fmt: skip
    size = ROWS * COLUMNS
    views = [
        View(f.ravel() / np.float32(255.0), np.zeros(size, np.int16), np.ones(size)) for f in frames
    ]
    memory = params.init(views[0], COLUMNS, int(t_us[0]), np.random.default_rng(0))
    memory.pixels.state.reference[:] = memory.log_light
    readings = []
    for view, t in zip(views[1:], t_us[1:].tolist(), strict=True):
        memory, reading, _ = params.step(memory, view, t)
        readings.append(reading)
    return readings


def net(x, y, p):
    out = np.zeros((ROWS, COLUMNS))
    np.add.at(out, (y, x), p)
    return out


def correlation(a, b):
    return np.corrcoef(gaussian_filter(a, 1.0).ravel(), gaussian_filter(b, 1.0).ravel())[0, 1]


def test_net_counts_match_a_real_sensor_better_than_differences_of_frames_do(slider):
    frames, t_us, events = slider
    ours, plain = [], []
    for k, r in enumerate(simulated(slider, 0.6, 0.54)):
        inside = (events[:, 0] >= t_us[k]) & (events[:, 0] < t_us[k + 1])
        real = net(*events[inside, 1:].T)
        ours.append(correlation(net(r.x, r.y, r.p), real))
        plain.append(correlation(np.diff(np.log(frames[k : k + 2] + BLACK), axis=0)[0], real))
    assert np.mean(ours) >= 0.85
    assert np.mean(ours) > np.mean(plain) + 0.01


def test_evlib_counts_the_same_but_stamps_every_event_with_the_frame(slider):
    try:
        simulation = importlib.import_module("evlib.simulation")
        simulator_class = simulation.ESIMSimulator
    except ImportError as missing:
        pytest.skip(f"evlib's simulator needs evlib and torch: {missing}")
    config = simulation.ESIMConfig(
        positive_threshold=0.4, negative_threshold=0.4, refractory_period_ms=0.0, device="cpu"
    )
    frames, t_us, _ = slider
    other = simulator_class(config)
    theirs = [
        other.process_frame(f + np.float32(BLACK), 1e-6 * t)
        for f, t in zip(frames, t_us, strict=True)
    ][1:]
    for r, (x, y, t, p) in zip(simulated(slider, 0.4, 0.4), theirs, strict=True):
        assert len(r.t_us) == pytest.approx(len(x), rel=0.02)
        a, b = net(r.x, r.y, r.p), net(x, y, p)
        assert np.corrcoef(a.ravel(), b.ravel())[0, 1] >= 0.99
        assert len(np.unique(r.t_us)) > 2_000  # equal pairs of 8-bit levels cross at equal times
        assert len(np.unique(t)) == 1
