# SPDX-License-Identifier: Apache-2.0
"""Textures with their mip pyramids in one array, and how a kernel reads them."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit_ieee
from skyhaul.types import IntArray

# mypy: disable-error-code="no-any-return"

Grey = NDArray[np.float32]
"""Linear grey values."""


class Atlas(NamedTuple):
    """k square textures; level 0 is the full size, each further level half of it."""

    texel: Grey  # all levels of all textures, row-major
    start: IntArray  # (k, levels) where a level begins in `texel`
    size: IntArray  # (k,) edge of level 0 [texels], a power of two
    levels: IntArray  # (k,) number of levels


def build_atlas(textures: Sequence[Grey]) -> Atlas:
    """Mip pyramids of textures: each level is the mean of 2 x 2 texels of the one before.

    Args:
        textures: Square, their edge a power of two, row 0 on top; they repeat without end.
    """
    size = np.array([len(t) for t in textures], dtype=np.int64)
    levels = np.array([n.bit_length() for n in size.tolist()], dtype=np.int64)
    start = np.zeros((len(textures), int(levels.max())), dtype=np.int64)
    pieces: list[Grey] = []
    total = 0
    for k, texture in enumerate(textures):
        level = np.ascontiguousarray(texture, dtype=np.float32)
        for step in range(levels[k]):
            start[k, step] = total
            pieces.append(level.ravel())
            total += level.size
            n = len(level) // 2
            if n:
                level = level.reshape(n, 2, n, 2).mean(axis=(1, 3), dtype=np.float32)
    return Atlas(np.concatenate(pieces), start, size, levels)


@njit_ieee
def sample(atlas: Atlas, k: int, u: float, v: float, footprint: float) -> float:
    """Trilinear sample of texture k.

    Args:
        atlas: The textures.
        k: Which.
        u: Across, in periods of the texture; any number.
        v: Down, likewise.
        footprint: Size of the pixel on the texture, in texels of level 0.
    """
    level, rest = 0, footprint
    while rest >= 2.0:
        rest *= 0.5
        level += 1
    last = atlas.levels[k] - 1
    if level >= last:
        return atlas.texel[atlas.start[k, last]]
    fine = _bilinear(atlas, k, level, u, v)
    if rest <= 1.0:
        return fine
    # rest - 1 stands for log2(rest): the same at both ends, and never jumps
    return fine + (rest - 1.0) * (_bilinear(atlas, k, level + 1, u, v) - fine)


@njit_ieee
def _bilinear(atlas: Atlas, k: int, level: int, u: float, v: float) -> float:
    n = atlas.size[k] >> level
    base, mask = atlas.start[k, level], n - 1
    x, y = u * n - 0.5, v * n - 0.5
    x0, y0 = math.floor(x), math.floor(y)
    fx, fy = np.float32(x - x0), np.float32(y - y0)
    i, j = int(x0) & mask, int(y0) & mask
    i1, row, row1 = (i + 1) & mask, base + j * n, base + ((j + 1) & mask) * n
    t = atlas.texel
    top = t[row + i] + fx * (t[row + i1] - t[row + i])
    low = t[row1 + i] + fx * (t[row1 + i1] - t[row1 + i])
    return top + fy * (low - top)
