# SPDX-License-Identifier: Apache-2.0
"""What the room looks like: a works hall of block walls, steel panels, windows and skylights."""

from itertools import pairwise

import numpy as np

from skyhaul.sensors.imaging.atlas import Grey
from skyhaul.sensors.imaging.canvas import Canvas, clouded

SIZE = 1024
"""Edge of the textures of the room [texels]."""

_SIGNS = (
    *("EXIT", "BAY 4", "A 12", "FIRE DOOR", "HOIST 2t", "GATE 3", "KEEP CLEAR", "LINE 7"),
    *("D 08", "WORKSHOP", "NO ENTRY", "STORE 5", "B 31", "H 2.40 m", "DOCK 9", "CRANE 1"),
)


def wall(rng: np.random.Generator, width: float, height: float, edge: float) -> Grey:
    """A wall: blocks below, steel panels above, windows, pillars, pipes, doors, signs.

    Args:
        rng: Draws it.
        width: Of the wall [m].
        height: Of the wall [m].
        edge: Of the square texture [m], at least both.
    """
    canvas = Canvas.blank(SIZE, edge, 0.5)
    base = float(rng.uniform(1.8, 2.6))
    _panels(rng, canvas, width, base, height)
    _blocks(rng, canvas, width, base)
    canvas.rectangle(0.0, base, width, 0.12, 0.2)
    for row in np.arange(base + 0.9, height - 2.0, 3.1):
        _windows(rng, canvas, width, float(row))
    for x in np.arange(rng.uniform(0.6, 1.6), width, 3.6):
        _pillar(rng, canvas, float(x), height)
    _pipes(rng, canvas, width, height)
    for _ in range(int(1.6 * width)):
        _fitting(rng, canvas, width, height)
    x = float(rng.uniform(0.1, 0.7) * width)
    _door(rng, canvas, x)
    _weather(rng, canvas, 0.26)
    return canvas.texture()


def floor(rng: np.random.Generator, width: float, length: float, edge: float) -> Grey:
    """A floor of concrete slabs with lanes, landing marks, patches, tape and stains."""
    canvas = Canvas.blank(SIZE, edge, 0.5)
    slab = 1.75
    for x in np.arange(0.0, width, slab):
        for y in np.arange(0.0, length, slab):
            canvas.rectangle(float(x), float(y), slab, slab, float(rng.uniform(0.4, 0.58)))
    for _ in range(int(0.35 * width * length)):
        _floor_patch(rng, canvas, width, length)
    for a in np.arange(0.0, max(width, length), slab):
        canvas.line(float(a), 0.0, float(a), length, 0.025, 0.2)
        canvas.line(0.0, float(a), width, float(a), 0.025, 0.2)
    for _ in range(3):
        x, y = float(rng.uniform(0.1, 0.9) * width), float(rng.uniform(0.1, 0.9) * length)
        canvas.line(x, 0.0, x, length, 0.1, 0.82)
        canvas.line(0.0, y, width, y, 0.1, 0.76)
    for _ in range(int(0.06 * width * length)):
        _landing_mark(rng, canvas, width, length)
    for _ in range(int(1.4 * width * length)):
        _tape(rng, canvas, width, length)
    _weather(rng, canvas, 0.3)
    return canvas.texture()


def ceiling(rng: np.random.Generator, width: float, length: float, edge: float) -> Grey:
    """A roof from below: sheets, purlins, trusses, ducts, lamps."""
    canvas = Canvas.blank(SIZE, edge, 0.42)
    for x in np.arange(0.0, width, 0.7):
        for y in np.arange(0.0, length, 2.1):
            canvas.rectangle(float(x), float(y), 0.68, 2.08, float(rng.uniform(0.34, 0.56)))
    for y in np.arange(0.35, length, 1.05):
        canvas.rectangle(0.0, float(y), width, 0.09, float(rng.uniform(0.12, 0.22)))
    for x in np.arange(0.9, width, 2.3):
        _truss(canvas, float(x), length)
    for _ in range(3):
        x, w = float(rng.uniform(0.0, width)), float(rng.uniform(0.3, 0.6))
        canvas.rectangle(x, 0.0, w, length, float(rng.uniform(0.55, 0.7)))
        for y in np.arange(rng.uniform(0.2, 0.8), length, 0.9):
            canvas.rectangle(x - 0.03, float(y), w + 0.06, 0.06, 0.3)
    for _ in range(int(0.3 * width * length)):
        x, y = float(rng.uniform(0.0, width)), float(rng.uniform(0.0, length))
        w, h = (1.2, 0.22) if rng.random() < 0.5 else (0.35, 0.35)
        canvas.rectangle(x - 0.05, y - 0.05, w + 0.1, h + 0.1, 0.15)
        canvas.rectangle(x, y, w, h, float(rng.uniform(0.75, 1.0)))
    _weather(rng, canvas, 0.2)
    return canvas.texture()


def openings(rng: np.random.Generator, width: float, length: float, edge: float) -> Grey:
    """Skylights in the roof: 1 where the sky shows."""
    canvas = Canvas.blank(SIZE // 2, edge, 0.0)
    for x in np.arange(1.5, width - 1.6, 4.6):
        for y in np.arange(1.2, length - 2.2, 3.4):
            if rng.random() < 0.8:
                canvas.rectangle(float(x), float(y), 1.3, 2.0, 1.0)
                canvas.rectangle(float(x), float(y) + 0.96, 1.3, 0.08, 0.0)
                canvas.rectangle(float(x) + 0.61, float(y), 0.08, 2.0, 0.0)
    return canvas.texture()


def grain(rng: np.random.Generator) -> Grey:
    """What shows near by on every surface of the room: pores, scratches, specks; mean 0.5."""
    size = 256
    noise = clouded(rng, size, ((16, 0.2), (32, 0.3), (64, 0.35), (128, 0.3)))
    canvas = Canvas(np.clip(255.0 * noise, 0, 255).astype(np.uint8), size)
    for _ in range(170):
        x, y = (float(v) for v in rng.random(2))
        canvas.disc(x, y, float(rng.uniform(0.004, 0.013)), float(rng.choice([0.05, 0.2, 0.95])))
    for _ in range(24):
        x, y = (float(v) for v in rng.random(2))
        a, b = (float(v) for v in rng.uniform(-0.12, 0.12, 2))
        canvas.line(x, y, x + a, y + b, 0.006, float(rng.choice([0.1, 0.9])))
    texture = canvas.texture()
    return np.asarray(texture + np.float32(0.5 - texture.mean()), dtype=np.float32)


def clouds(rng: np.random.Generator) -> Grey:
    """A sky of clouds."""
    noise = clouded(rng, 512, ((4, 0.5), (8, 0.35), (16, 0.22), (32, 0.15), (64, 0.1)))
    return np.asarray(np.clip(2.2 * noise - 0.6, 0.0, 1.0), dtype=np.float32)


def _panels(
    rng: np.random.Generator, canvas: Canvas, width: float, base: float, height: float
) -> None:
    for x in np.arange(0.0, width, 1.15):
        for y in np.arange(base, height, 1.9):
            canvas.rectangle(float(x), float(y), 1.15, 1.9, float(rng.uniform(0.44, 0.68)))
            canvas.frame(float(x), float(y), 1.15, 1.9, 0.02, 0.25)
            for px, py in ((0.08, 0.1), (1.07, 0.1), (0.08, 1.8), (1.07, 1.8)):
                canvas.disc(float(x) + px, float(y) + py, 0.022, 0.15)


def _blocks(rng: np.random.Generator, canvas: Canvas, width: float, base: float) -> None:
    canvas.rectangle(0.0, 0.0, width, base, 0.3)
    for row, y in enumerate(np.arange(0.0, base, 0.2)):
        for x in np.arange(-0.2 * (row % 2), width, 0.4):
            grey = float(rng.uniform(0.42, 0.66) if rng.random() < 0.85 else rng.uniform(0.25, 0.8))
            canvas.rectangle(float(x) + 0.015, float(y) + 0.015, 0.37, 0.17, grey)


def _windows(rng: np.random.Generator, canvas: Canvas, width: float, y: float) -> None:
    x = float(rng.uniform(0.5, 1.5))
    while x < width - 2.0:
        w = float(rng.choice([1.2, 1.8, 2.4]))
        if rng.random() < 0.6:
            canvas.rectangle(x - 0.07, y - 0.07, w + 0.14, 1.34, 0.18)
            for px in np.arange(x, x + w - 0.1, 0.6):
                for py in (y, y + 0.62):
                    canvas.rectangle(float(px), py, 0.56, 0.58, float(rng.uniform(0.72, 1.0)))
        x += w + float(rng.uniform(0.5, 1.6))


def _pillar(rng: np.random.Generator, canvas: Canvas, x: float, height: float) -> None:
    canvas.rectangle(x, 0.0, 0.28, height, 0.3)
    canvas.rectangle(x + 0.09, 0.0, 0.1, height, 0.42)
    canvas.stripes(x, 0.0, 0.28, 1.4, 0.26)
    for y in np.arange(2.0, height, 1.3):
        canvas.rectangle(x - 0.06, float(y), 0.4, 0.07, 0.16)
    canvas.text(x + 0.02, 1.55, 0.2, str(int(rng.integers(1, 99))), 0.95)


def _pipes(rng: np.random.Generator, canvas: Canvas, width: float, height: float) -> None:
    """Three pipes along the wall above the doors; none where it is too low for them."""
    if height < 3.1:
        return
    for y in rng.uniform(2.5, height - 0.6, 3):
        grey, thick = float(rng.uniform(0.65, 0.85)), float(rng.uniform(0.05, 0.12))
        canvas.rectangle(0.0, float(y), width, thick, grey)
        canvas.rectangle(0.0, float(y), width, 0.25 * thick, 0.3)
        for x in np.arange(rng.uniform(0.2, 0.9), width, 1.25):
            canvas.rectangle(float(x), float(y) - 0.04, 0.07, thick + 0.08, 0.14)


def _fitting(rng: np.random.Generator, canvas: Canvas, width: float, height: float) -> None:
    """A board, a vent, a box or a sign somewhere on the wall; none where it does not fit."""
    if width < 1.4 or height < 1.2:
        return
    x = float(rng.uniform(0.2, width - 1.2))
    y = float(rng.uniform(0.4, min(height - 0.8, 11.0)))
    kind = int(rng.integers(4))
    if kind == 0:  # a sign
        words = str(rng.choice(_SIGNS))
        high = float(rng.uniform(0.18, 0.34))
        dark = bool(rng.random() < 0.5)
        wide = 0.95 * high * len(words) + 0.2
        canvas.rectangle(x, y, wide, 1.9 * high, 0.12 if dark else 0.92)
        canvas.frame(x, y, wide, 1.9 * high, 0.03, 0.5)
        canvas.text(x + 0.1, y + 0.45 * high, high, words, 0.95 if dark else 0.08)
    elif kind == 1:  # a vent
        canvas.rectangle(x, y, 0.8, 0.6, 0.6)
        for step in range(5):
            canvas.rectangle(x + 0.06, y + 0.06 + 0.11 * step, 0.68, 0.05, 0.12)
    elif kind == 2:  # a switch box with its conduit
        canvas.rectangle(x + 0.2, 0.0, 0.04, y, 0.75)
        canvas.rectangle(x, y, 0.45, 0.6, float(rng.uniform(0.7, 0.9)))
        canvas.rectangle(x + 0.08, y + 0.32, 0.29, 0.16, 0.15)
        canvas.disc(x + 0.13, y + 0.14, 0.04, 0.1)
        canvas.disc(x + 0.3, y + 0.14, 0.04, 0.35)
    else:  # a board with notes
        canvas.rectangle(x, y, 1.0, 0.7, 0.25)
        for _ in range(9):
            px, py = float(rng.uniform(0.03, 0.78)), float(rng.uniform(0.03, 0.5))
            canvas.rectangle(x + px, y + py, 0.17, 0.15, float(rng.uniform(0.45, 1.0)))


def _door(rng: np.random.Generator, canvas: Canvas, x: float) -> None:
    canvas.rectangle(x - 0.08, 0.0, 2.56, 2.5, 0.15)
    for k in range(8):
        canvas.rectangle(x, 0.02 + 0.3 * k, 2.4, 0.27, float(rng.uniform(0.62, 0.74)))
    canvas.text(x + 0.55, 1.05, 0.6, str(rng.choice(["G1", "G2", "G3", "G4"])), 0.12)
    canvas.stripes(x, 0.0, 2.4, 0.25, 0.3)


def _floor_patch(rng: np.random.Generator, canvas: Canvas, width: float, length: float) -> None:
    """A repair, a mat, a grate or an oil stain."""
    x, y = float(rng.uniform(0.0, width)), float(rng.uniform(0.0, length))
    w, h = (float(v) for v in rng.uniform(0.2, 0.9, 2))
    kind = int(rng.integers(4))
    if kind == 0:
        canvas.rectangle(x, y, w, h, float(rng.uniform(0.28, 0.75)))
    elif kind == 1:
        canvas.rectangle(x, y, 0.6, 0.6, 0.15)
        for k in range(4):
            for j in range(4):
                canvas.rectangle(x + 0.05 + 0.14 * k, y + 0.05 + 0.14 * j, 0.08, 0.08, 0.5)
    elif kind == 2:
        canvas.disc(x, y, 0.35 * w, float(rng.uniform(0.2, 0.34)))
        canvas.disc(x + 0.3 * w, y - 0.2 * h, 0.2 * w, 0.28)
    else:
        points = np.cumsum(rng.uniform(-0.35, 0.35, (6, 2)), axis=0)
        points += np.array([x, y])
        for (ax, ay), (bx, by) in pairwise(points):
            canvas.line(float(ax), float(ay), float(bx), float(by), 0.02, 0.16)


def _landing_mark(rng: np.random.Generator, canvas: Canvas, width: float, length: float) -> None:
    """A disc with a letter; none where the floor is too narrow for it."""
    if min(width, length) < 1.2:
        return
    x, y = float(rng.uniform(0.6, width - 0.6)), float(rng.uniform(0.6, length - 0.6))
    radius = float(rng.uniform(0.3, 0.55))
    canvas.disc(x, y, radius, 0.22)
    canvas.ring(x, y, 0.85 * radius, 0.06, 0.9)
    high = 0.8 * radius
    canvas.text(x - 0.4 * high, y - 0.5 * high, high, str(rng.choice(list("HPTX58"))), 0.92)


def _tape(rng: np.random.Generator, canvas: Canvas, width: float, length: float) -> None:
    """A strip, a cross, a number or a dot."""
    x, y = float(rng.uniform(0.0, width)), float(rng.uniform(0.0, length))
    grey = float(rng.choice([0.08, 0.15, 0.85, 0.95]))
    a, kind = float(rng.uniform(0.05, 0.16)), int(rng.integers(4))
    if kind == 0:
        turn = float(rng.uniform(0.0, np.pi))
        dx, dy = 2.0 * a * np.cos(turn), 2.0 * a * np.sin(turn)
        canvas.line(x, y, x + float(dx), y + float(dy), 0.05, grey)
    elif kind == 1:
        canvas.line(x - a, y, x + a, y, 0.04, grey)
        canvas.line(x, y - a, x, y + a, 0.04, grey)
    elif kind == 2:
        canvas.text(x, y, 0.18, str(int(rng.integers(10, 99))), grey)
    else:
        canvas.rectangle(x, y, a, 0.8 * a, grey)


def _truss(canvas: Canvas, x: float, length: float) -> None:
    canvas.rectangle(x, 0.0, 0.07, length, 0.1)
    canvas.rectangle(x + 0.45, 0.0, 0.07, length, 0.1)
    for k, y in enumerate(np.arange(0.0, length, 0.5)):
        a, b = (0.03, 0.48) if k % 2 else (0.48, 0.03)
        canvas.line(x + a, float(y), x + b, float(y) + 0.5, 0.04, 0.14)


def _weather(rng: np.random.Generator, canvas: Canvas, depth: float) -> None:
    """Uneven light, dirt and wear over everything."""
    octaves = ((4, 0.4), (16, 0.3), (64, 0.25), (256, 0.3))
    noise = clouded(rng, len(canvas.image), octaves)
    canvas.shade(np.asarray(1.0 + depth * (2.0 * noise - 1.0), dtype=np.float32))
