# SPDX-License-Identifier: Apache-2.0
"""Textures with their mip pyramids in one array, and how a kernel reads them."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit_ieee
from skyhaul.types import IntArray

# mypy: disable-error-code="no-any-return,return-value"

Grey = NDArray[np.float32]
"""Linear grey values."""


class Atlas(NamedTuple):
    """k square textures; each is followed by its pyramid: half the edge, down to one texel."""

    texel: Grey  # all levels of all textures, row-major
    start: IntArray  # (k,) where a texture begins in `texel`
    size: IntArray  # (k,) its edge [texels], a power of two


def build_atlas(textures: Sequence[Grey]) -> Atlas:
    """Mip pyramids of textures: each level is the mean of 2 x 2 texels of the one before.

    Args:
        textures: Square, their edge a power of two, row 0 on top; they repeat without end.
    """
    size = np.array([len(t) for t in textures], dtype=np.int64)
    start = np.zeros(len(textures), dtype=np.int64)
    pieces: list[Grey] = []
    total = 0
    for k, texture in enumerate(textures):
        level, start[k] = np.ascontiguousarray(texture, dtype=np.float32), total
        while True:
            pieces.append(level.ravel())
            total += level.size
            n = len(level) // 2
            if n == 0:
                break
            level = level.reshape(n, 2, n, 2).mean(axis=(1, 3), dtype=np.float32)
    return Atlas(np.concatenate(pieces), start, size)


@njit_ieee
def sample(texel: Grey, start: int, n: int, u: float, v: float, footprint: float) -> float:
    """Trilinear sample of one texture.

    Args:
        texel: Of the atlas.
        start: Where the texture begins.
        n: Its edge [texels].
        u: Across, in periods of the texture; any number.
        v: Down, likewise.
        footprint: Size of the pixel on the texture, in texels of the full size.
    """
    rest = footprint
    while rest >= 2.0 and n > 1:
        rest *= 0.5
        start += n * n
        n >>= 1
    fine = _bilinear(texel, start, n, u, v)
    if rest <= 1.0 or n == 1:
        return fine
    # rest - 1 stands for log2(rest): the same at both ends, so that grey never jumps
    coarse = _bilinear(texel, start + n * n, n >> 1, u, v)
    return fine + np.float32(rest - 1.0) * (coarse - fine)


@njit_ieee
def _bilinear(texel: Grey, start: int, n: int, u: float, v: float) -> float:
    x, y, mask = u * n - 0.5, v * n - 0.5, n - 1
    x0, y0 = math.floor(x), math.floor(y)
    fx, fy = np.float32(x - x0), np.float32(y - y0)
    left, right = int(x0) & mask, (int(x0) + 1) & mask
    upper, lower = start + (int(y0) & mask) * n, start + ((int(y0) + 1) & mask) * n
    a, b = texel[upper + left], texel[upper + right]
    c, d = texel[lower + left], texel[lower + right]
    top, low = a + fx * (b - a), c + fx * (d - c)
    return top + fy * (low - top)
