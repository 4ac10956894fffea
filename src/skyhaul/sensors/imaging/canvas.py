# SPDX-License-Identifier: Apache-2.0
"""Paint in metres on a square that becomes a texture."""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from skyhaul.sensors.imaging.atlas import Grey

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Canvas:
    """A square picture, painted in place; x to the right, y up, origin in its lower left corner.

    Greys are shares of white, 0..1. What reaches over an edge is cut off.
    """

    image: Bytes  # (n, n)
    per_m: float  # pixels per metre

    @staticmethod
    def blank(size: int, edge_m: float, grey: float) -> "Canvas":
        """An even canvas of size x size pixels."""
        return Canvas(np.full((size, size), _byte(grey), dtype=np.uint8), size / edge_m)

    def texture(self) -> Grey:
        """The picture as grey values."""
        return np.asarray(self.image, dtype=np.float32) / np.float32(255.0)

    def rectangle(self, x: float, y: float, w: float, h: float, grey: float) -> None:
        """A filled rectangle from its lower left corner."""
        n = len(self.image)
        left, right = (int(np.clip(round(v * self.per_m), 0, n)) for v in (x, x + w))
        low, high = (int(np.clip(round(v * self.per_m), 0, n)) for v in (y, y + h))
        self.image[n - high : n - low, left:right] = _byte(grey)

    def frame(self, x: float, y: float, w: float, h: float, width: float, grey: float) -> None:
        """The rim of a rectangle."""
        corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)]
        for (ax, ay), (bx, by) in pairwise(corners):
            self.line(ax, ay, bx, by, width, grey)

    def line(self, x: float, y: float, x1: float, y1: float, width: float, grey: float) -> None:
        """A straight line."""
        thick = max(1, round(width * self.per_m))
        cv2.line(self.image, self._at(x, y), self._at(x1, y1), _byte(grey), thick, cv2.LINE_AA)

    def disc(self, x: float, y: float, radius: float, grey: float) -> None:
        """A filled circle."""
        r = max(1, round(radius * self.per_m))
        cv2.circle(self.image, self._at(x, y), r, _byte(grey), -1, cv2.LINE_AA)

    def ring(self, x: float, y: float, radius: float, width: float, grey: float) -> None:
        """A circle."""
        r, thick = max(1, round(radius * self.per_m)), max(1, round(width * self.per_m))
        cv2.circle(self.image, self._at(x, y), r, _byte(grey), thick, cv2.LINE_AA)

    def text(self, x: float, y: float, height: float, words: str, grey: float) -> None:
        """Words whose first letter stands at (x, y)."""
        scale = height * self.per_m / 21.0  # capital letters of the font are 21 pixels high
        thick = max(1, round(3.0 * scale))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(self.image, words, self._at(x, y), font, scale, _byte(grey), thick, cv2.LINE_AA)

    def stripes(self, x: float, y: float, w: float, h: float, pitch: float) -> None:
        """Slanting hazard stripes in a rectangle."""
        n = len(self.image)
        left, right = (int(np.clip(round(v * self.per_m), 0, n)) for v in (x, x + w))
        low, high = (int(np.clip(round(v * self.per_m), 0, n)) for v in (y, y + h))
        rows, columns = np.mgrid[n - high : n - low, left:right]
        dark = ((rows + columns) / (pitch * self.per_m)) % 1.0 < 0.5
        self.image[n - high : n - low, left:right] = np.where(dark, _byte(0.12), _byte(0.78))

    def shade(self, factor: Grey) -> None:
        """Multiply by a factor, (n, n)."""
        self.image[:] = np.clip(self.image * factor, 0.0, 255.0).astype(np.uint8)

    def _at(self, x: float, y: float) -> tuple[int, int]:
        return round(x * self.per_m), round(len(self.image) - y * self.per_m)


def clouded(rng: np.random.Generator, size: int, octaves: tuple[tuple[int, float], ...]) -> Grey:
    """Smooth noise of mean 0.5 in 0..1 that repeats without a seam, (size, size).

    Args:
        rng: Draws it.
        size: Edge [pixels].
        octaves: Cells along an edge, and weight, of each octave.
    """
    total = np.zeros((size, size), dtype=np.float32)
    for cells, weight in octaves:
        grid = rng.random((cells, cells), dtype=np.float32) - np.float32(0.5)
        margin = 2
        wrapped = np.pad(grid, margin, mode="wrap")
        scale = size // cells
        big = cv2.resize(wrapped, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        total += weight * big[margin * scale :, margin * scale :][:size, :size]
    total /= 2.0 * float(np.abs(total).max())
    return np.asarray(total + np.float32(0.5), dtype=np.float32)


def _byte(grey: float) -> int:
    return round(255.0 * min(max(grey, 0.0), 1.0))
