# SPDX-License-Identifier: Apache-2.0
"""A small software rasteriser: shaded triangles and thick lines with a depth buffer.

It draws figures and videos the same on every machine, without a display or a graphics driver.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit
from skyhaul.types import Array

Pixels = NDArray[np.uint8]
Samples = NDArray[np.float32]

NEAR_M = 0.05
"""What is nearer to the camera is not drawn [m]."""

_SUN = np.array([0.35, -0.5, 0.85]) / math.sqrt(0.35**2 + 0.5**2 + 0.85**2)


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera in world W that looks at a point, up is z."""

    p_WC: Array  # (3,) [m]
    p_WT: Array  # (3,) where it looks [m]
    fov_rad: float = 0.78
    """Vertical field of view [rad]."""

    def axes(self) -> Array:
        """Right, up and back as rows, (3, 3)."""
        back = self.p_WC - self.p_WT
        back = back / np.linalg.norm(back)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(back, right), back])


@dataclass(frozen=True, eq=False)
class Image:
    """Colour and depth, drawn at `samples` times the size of the picture."""

    rgb: Samples  # (h, w, 3), 0..1
    inverse_depth: Samples  # (h, w) [1/m]
    samples: int = 2

    @staticmethod
    def blank(width: int, height: int, top: Array, bottom: Array, samples: int = 2) -> "Image":
        """An empty picture with a vertical gradient."""
        h, w = samples * height, samples * width
        rgb = np.empty((h, w, 3), dtype=np.float32)
        rgb[:] = top + np.linspace(0.0, 1.0, h)[:, None, None] * (bottom - top)
        return Image(rgb, np.zeros((h, w), dtype=np.float32), samples)

    def pixels(self) -> Pixels:
        """The picture, (height, width, 3) bytes, samples averaged."""
        h, w = self.inverse_depth.shape
        out = np.empty((h // self.samples, w // self.samples, 3), dtype=np.uint8)
        _average(self.rgb, self.samples, out)
        return out


def shade(normals: Array, rgb: Array, p_W: Array, p_WC: Array) -> Array:
    """Colours of lit surfaces, (t, 3, 3): a sun, the sky, both sides alike.

    Args:
        normals: Unit normals at the corners, (t, 3, 3).
        rgb: Colour of each triangle, (t, 3).
        p_W: Corners, (t, 3, 3) [m].
        p_WC: Camera, (3,) [m].
    """
    towards = np.sum(normals * (p_WC - p_W), axis=2, keepdims=True)
    n = np.where(towards < 0.0, -normals, normals)
    sun = np.maximum(n @ _SUN, 0.0)[..., None]
    sky = (0.5 + 0.5 * n[..., 2])[..., None]
    lit: Array = rgb[:, None, :] * (0.34 + 0.24 * sky + 0.52 * sun)
    return lit


def draw_triangles(image: Image, camera: Camera, p_W: Array, rgb: Array, alpha: Array) -> None:
    """Draw triangles; those that reach behind the camera are left out.

    Args:
        image: What is drawn into.
        camera: Where from.
        p_W: Corners, (t, 3, 3) [m].
        rgb: Colours at the corners, (t, 3, 3).
        alpha: Opacity, (t,); what is not opaque hides nothing that is drawn later.
    """
    if not len(p_W):
        return
    screen = _project(image, camera, p_W.reshape(-1, 3)).reshape(-1, 3, 3)
    ok = np.all(screen[:, :, 2] > 0.0, axis=1)
    _fill(image.rgb, image.inverse_depth, screen[ok], np.ascontiguousarray(rgb[ok]), alpha[ok])


def draw_lines(
    image: Image, camera: Camera, a_W: Array, b_W: Array, rgb: Array, width_px: float
) -> None:
    """Draw segments from (k, 3) to (k, 3) [m] in colours (k, 3), as wide as told [px]."""
    a, b = _clipped(camera, a_W, b_W)
    if not len(a):
        return
    ends = np.stack([_project(image, camera, a), _project(image, camera, b)], axis=1)
    along = ends[:, 1, :2] - ends[:, 0, :2]
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    half = 0.5 * width_px * image.samples
    side = half * np.column_stack([-along[:, 1], along[:, 0]]) / length
    corners = np.repeat(ends, 2, axis=1)  # a, a, b, b
    corners[:, [0, 2], :2] += side[:, None, :]
    corners[:, [1, 3], :2] -= side[:, None, :]
    corners[:, :, 2] *= 1.002  # a line on a surface lies before it
    triangles = corners[:, [[0, 1, 3], [0, 3, 2]]].reshape(-1, 3, 3)
    colors = np.repeat(np.repeat(rgb, 2, axis=0)[:, None, :], 3, axis=1)
    _fill(image.rgb, image.inverse_depth, triangles, colors, np.ones(len(triangles)))


def _project(image: Image, camera: Camera, p_W: Array) -> Array:
    """Column, row and inverse depth, (k, 3); inverse depth 0 for what is too near."""
    h, w = image.inverse_depth.shape
    x, y, z = ((p_W - camera.p_WC) @ camera.axes().T).T
    depth = -z
    inverse = np.where(depth > NEAR_M, 1.0 / np.maximum(depth, NEAR_M), 0.0)
    f = 0.5 * h / math.tan(0.5 * camera.fov_rad)
    return np.column_stack([0.5 * w + f * x * inverse, 0.5 * h - f * y * inverse, inverse])


def _clipped(camera: Camera, a_W: Array, b_W: Array) -> tuple[Array, Array]:
    """The parts of segments that lie before the camera."""
    back = camera.axes()[2]
    da, db = (camera.p_WC - a_W) @ back, (camera.p_WC - b_W) @ back
    near = 1.01 * NEAR_M
    keep = (da > near) | (db > near)
    a, b, da, db = a_W[keep], b_W[keep], da[keep], db[keep]
    s = ((near - da) / np.where(da == db, 1.0, db - da))[:, None]
    cut = a + s * (b - a)
    return np.where(da[:, None] < near, cut, a), np.where(db[:, None] < near, cut, b)


@njit
def _fill(rgb: Samples, inverse_depth: Samples, screen: Array, colors: Array, alpha: Array) -> None:
    """Fill triangles with colours and inverse depths that are linear on the screen."""
    h, w = inverse_depth.shape
    for t in range(len(screen)):
        x0, y0, z0 = screen[t, 0, 0], screen[t, 0, 1], screen[t, 0, 2]
        x1, y1, z1 = screen[t, 1, 0], screen[t, 1, 1], screen[t, 1, 2]
        x2, y2, z2 = screen[t, 2, 0], screen[t, 2, 1], screen[t, 2, 2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-9:
            continue
        top = max(0, math.ceil(min(y0, y1, y2) - 0.5))
        bottom = min(h - 1, math.floor(max(y0, y1, y2) - 0.5))
        a, opaque = alpha[t], alpha[t] > 0.99
        b1_x, b2_x = (y2 - y0) / area, (y0 - y1) / area
        for row in range(top, bottom + 1):
            y = row + 0.5
            low, high = _span(x0, y0, x1, y1, x2, y2, y)
            for col in range(max(0, math.ceil(low - 0.5)), min(w, math.ceil(high - 0.5))):
                x = col + 0.5
                b1 = (x - x0) * b1_x - (x2 - x0) * (y - y0) / area
                b2 = (x - x0) * b2_x + (x1 - x0) * (y - y0) / area
                b0 = 1.0 - b1 - b2
                z = b0 * z0 + b1 * z1 + b2 * z2
                if z <= inverse_depth[row, col]:
                    continue
                if opaque:
                    inverse_depth[row, col] = z
                for c in range(3):
                    value = b0 * colors[t, 0, c] + b1 * colors[t, 1, c] + b2 * colors[t, 2, c]
                    rgb[row, col, c] += a * (value - rgb[row, col, c])


@njit
def _span(
    x0: float, y0: float, x1: float, y1: float, x2: float, y2: float, y: float
) -> tuple[float, float]:
    """Where a row cuts a triangle: least and largest x; empty (low > high) where it does not."""
    low, high = 1e30, -1e30
    for xa, ya, xb, yb in ((x0, y0, x1, y1), (x1, y1, x2, y2), (x2, y2, x0, y0)):
        if (ya <= y) != (yb <= y):
            x = xa + (xb - xa) * (y - ya) / (yb - ya)
            low, high = min(low, x), max(high, x)
    return low, high


@njit
def _average(rgb: Samples, k: int, out: Pixels) -> None:
    """Bytes of a picture: means over k x k samples, clipped to 0..1."""
    height, width, _ = out.shape
    for row in range(height):
        for col in range(width):
            for c in range(3):
                total = 0.0
                for i in range(k):
                    for j in range(k):
                        total += rgb[k * row + i, k * col + j, c]
                out[row, col, c] = int(255.0 * min(1.0, max(0.0, total / (k * k))) + 0.5)
