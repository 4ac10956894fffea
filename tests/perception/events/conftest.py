# SPDX-License-Identifier: Apache-2.0
import os
from pathlib import Path

import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan
from skyhaul.perception.events.lens import event_lens
from skyhaul.sensors.api import EventReading

DATA = Path(os.environ.get("SKYHAUL_DATA", "../shared/data"))


@pytest.fixture(scope="session")
def data():
    """Folder of real recordings, made by others."""
    if not DATA.is_dir():
        pytest.skip(f"no recordings at {DATA}; name their folder in SKYHAUL_DATA")
    return DATA


@pytest.fixture(scope="session")
def lens():
    """A small camera with a distorted lens."""
    return event_lens(RadTan.from_fov((48, 36), 70.0, (-0.2, 0.05, 1e-3, -5e-4)))


def part(events, a, b):
    """Events a to b of a reading."""
    return EventReading(events.t_us[a:b], events.x[a:b], events.y[a:b], events.p[a:b])


@pytest.fixture(scope="session")
def stream():
    """Edges that sweep over a 48 x 36 image, and noise: events, and a camera that turns."""
    rng = np.random.default_rng(3)
    k = 1500
    t = np.sort(rng.integers(0, 60_000, k))
    edge = rng.random(k) < 0.8
    x = np.where(edge, (t / 1500 + rng.integers(0, 3, k) * 7) % 48, rng.integers(0, 48, k))
    y = np.where(edge, 8 + rng.integers(0, 10, k), rng.integers(0, 36, k))
    p = rng.choice([-1, 1], k)
    events = EventReading(t, x.astype(np.int16), y.astype(np.int16), p.astype(np.int8))
    turn_C = np.outer(1e-6 * t, [0.7, -1.1, 2.0])
    return events, turn_C
