# SPDX-License-Identifier: Apache-2.0
"""What obstacles, vehicles and the load look like: crates, drums, panels."""

import numpy as np

from skyhaul.sensors.imaging.atlas import Grey
from skyhaul.sensors.imaging.canvas import Canvas, clouded

SIZE = 256
"""Edge of these textures [texels]."""


def ware(rng: np.random.Generator, kind: int) -> Grey:
    """One side of a crate (0), a riveted panel (1), a mosaic (2) or a labelled drum (3)."""
    canvas = Canvas.blank(SIZE, 1.0, float(rng.uniform(0.3, 0.7)))
    (_crate, _rivets, _mosaic, _labels)[kind % 4](rng, canvas)
    noise = clouded(rng, SIZE, ((8, 0.4), (32, 0.3), (128, 0.3)))
    canvas.shade(np.asarray(1.0 + 0.2 * (2.0 * noise - 1.0), dtype=np.float32))
    return canvas.texture()


def _crate(rng: np.random.Generator, canvas: Canvas) -> None:
    for y in np.arange(0.0, 1.0, 0.125):
        canvas.rectangle(0.0, float(y), 1.0, 0.115, float(rng.uniform(0.4, 0.72)))
    dark = float(rng.uniform(0.2, 0.32))
    canvas.line(0.1, 0.1, 0.9, 0.9, 0.11, dark)
    for x, y, w, h in ((0, 0, 1, 0.12), (0, 0.88, 1, 0.12), (0, 0, 0.12, 1), (0.88, 0, 0.12, 1)):
        canvas.rectangle(x, y, w, h, dark + 0.08)
    for x in (0.06, 0.94):
        for y in np.arange(0.06, 1.0, 0.176):
            canvas.disc(x, float(y), 0.02, 0.85)
    canvas.text(0.2, 0.62, 0.14, str(int(rng.integers(100, 999))), 0.08)


def _rivets(rng: np.random.Generator, canvas: Canvas) -> None:
    for x in (0.0, 0.5):
        for y in (0.0, 0.5):
            canvas.rectangle(x + 0.02, y + 0.02, 0.46, 0.46, float(rng.uniform(0.35, 0.85)))
            for a in (0.06, 0.25, 0.44):
                for b in (0.06, 0.44):
                    canvas.disc(x + a, y + b, 0.022, 0.12)
    canvas.stripes(0.1, 0.16, 0.8, 0.12, 0.13)
    canvas.text(0.1, 0.66, 0.2, str(rng.choice(["SK", "UH", "X7", "OK"])), 0.06)


def _mosaic(rng: np.random.Generator, canvas: Canvas) -> None:
    for x in np.arange(0.0, 1.0, 0.125):
        for y in np.arange(0.0, 1.0, 0.125):
            grey = float(rng.choice([0.1, 0.25, 0.5, 0.7, 0.92]))
            canvas.rectangle(float(x), float(y), 0.125, 0.125, grey)
    for _ in range(6):
        x, y = (float(v) for v in rng.random(2))
        canvas.disc(x, y, 0.05, float(rng.choice([0.05, 0.95])))


def _labels(rng: np.random.Generator, canvas: Canvas) -> None:
    for y in (0.05, 0.48, 0.9):
        canvas.rectangle(0.0, y, 1.0, 0.05, 0.15)
    for _ in range(9):
        x, y = float(rng.uniform(0.0, 0.7)), float(rng.uniform(0.0, 0.8))
        w, h = float(rng.uniform(0.15, 0.35)), float(rng.uniform(0.1, 0.2))
        light = float(rng.uniform(0.7, 1.0))
        canvas.rectangle(x, y, w, h, light)
        for k in range(3):
            canvas.rectangle(x + 0.02, y + 0.02 + 0.3 * h * k, 0.6 * w, 0.025, 0.1)
