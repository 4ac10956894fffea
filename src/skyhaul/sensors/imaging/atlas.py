# SPDX-License-Identifier: Apache-2.0
"""Textures with their mip pyramids in one array, and how a kernel reads them.

The pyramid of a texture begins with one texel and ends with the texture; level j has an edge of
2^j texels. Each level carries one more row and column, which repeat its first: a sample reads two
neighbours in two rows and never wraps. So level j begins after

    sum over i < j of (2^i + 1)^2 = (4^j - 1) / 3 + 2 (2^j - 1) + j  texels.

A sample blends the two levels between which the footprint of the pixel lies. `read_textures` does
it for many pixels at once, in short loops over arrays that the compiler turns into vector code;
`sample` is the same for one pixel.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.jit import njit_ieee
from skyhaul.types import IntArray

# mypy: disable-error-code="no-any-return,return-value,assignment,arg-type"

Grey = NDArray[np.float32]
"""Linear grey values."""
Index = NDArray[np.int32]
"""Places in the atlas."""

_THIRDS = 0x55555555
"""(4^j - 1) / 3 is this masked by 4^j - 1."""
_ONE_BITS, _MANTISSA_BITS = 127 << 23, 23
"""Of float32: 1.0, and the length of what follows the exponent."""


class Atlas(NamedTuple):
    """k square textures and their pyramids."""

    texel: Grey  # all levels of all textures, row-major
    start: IntArray  # (k,) where a pyramid begins in `texel`
    order: IntArray  # (k,) its highest level: the texture has an edge of 2^order texels


class Patches(NamedTuple):
    """Which texture each of k pixels reads."""

    start: Index  # (k,)
    order: Index  # (k,)
    per_m: Grey  # (k,) periods of the texture per metre


class Spots(NamedTuple):
    """Where on its texture each of k pixels lies."""

    across: Grey  # (k,) [m]
    down: Grey  # (k,) [m]
    wide: Grey  # (k,) size of the pixel on the surface [m]


class Reading(NamedTuple):
    """Room to work for `read_textures`."""

    u: Grey  # (k,) across, in periods
    v: Grey  # (k,) down
    texels: Grey  # (k,) footprint
    bits: Index  # (k,) the same memory
    level: Index  # (k,) the finer of two levels
    blend: Grey  # (k,) share of the coarser one
    place: Index  # (k,) upper left of four texels
    right: Grey  # (k,) shares of their neighbours
    below: Grey  # (k,)


def build_atlas(textures: Sequence[Grey]) -> Atlas:
    """Mip pyramids of textures: each level is the mean of 2 x 2 texels of the next finer one.

    Args:
        textures: Square, their edge a power of two, row 0 on top; they repeat without end.
    """
    order = np.array([len(t).bit_length() - 1 for t in textures], dtype=np.int64)
    start, pieces, total = np.zeros(len(textures), dtype=np.int64), [], 0
    for k, texture in enumerate(textures):
        levels = [np.ascontiguousarray(texture, dtype=np.float32)]
        for j in reversed(range(order[k])):
            halves = levels[0].reshape(1 << j, 2, 1 << j, 2)
            levels.insert(0, halves.mean(axis=(1, 3), dtype=np.float32))
        start[k] = total
        for level in levels:
            padded = np.pad(level, (0, 1), mode="wrap")
            pieces.append(padded.ravel())
            total += padded.size
    return Atlas(np.concatenate(pieces), start, order)


def blank_spots(k: int) -> Spots:
    """Buffers for k pixels."""
    return Spots(*(np.zeros(k, dtype=np.float32) for _ in range(3)))


def blank_reading(k: int) -> Reading:
    """Buffers for k pixels."""
    u, v, texels, blend, right, below = (np.zeros(k, dtype=np.float32) for _ in range(6))
    level, place = (np.zeros(k, dtype=np.int32) for _ in range(2))
    return Reading(u, v, texels, texels.view(np.int32), level, blend, place, right, below)


def same_patches(atlas: Atlas, texture: int, per_m: float, k: int) -> Patches:
    """The same texture for k pixels."""
    return Patches(
        np.full(k, atlas.start[texture], dtype=np.int32),
        np.full(k, atlas.order[texture], dtype=np.int32),
        np.full(k, per_m, dtype=np.float32),
    )


@njit_ieee
def read_textures(
    texel: Grey, patches: Patches, spots: Spots, work: Reading, n: int, out: Grey
) -> None:
    """Trilinear samples for the first n pixels.

    Args:
        texel: Of the atlas.
        patches: What they read.
        spots: Where.
        work: Overwritten; `texels` tells the footprints.
        n: How many.
        out: Written, (k,).
    """
    per_m, order = patches.per_m, patches.order
    across, down, wide = spots
    u, v, texels, bits, level, blend = (
        work.u,
        work.v,
        work.texels,
        work.bits,
        work.level,
        work.blend,
    )
    one_bits, one = np.int32(_ONE_BITS), np.int32(1)
    for i in range(n):
        u[i] = across[i] * per_m[i]
    for i in range(n):
        v[i] = down[i] * per_m[i]
    for i in range(n):
        texels[i] = wide[i] * per_m[i] * np.float32(np.int32(one << order[i]))
    for i in range(n):  # whole part of log2(texels), at least 0, from the exponent
        up = np.int32((max(bits[i], one_bits) - one_bits) >> np.int32(_MANTISSA_BITS))
        level[i] = max(np.int32(order[i] - up), np.int32(0))
    scale = np.float32(2.0**-_MANTISSA_BITS)
    for i in range(n):  # f - 1 stands for log2(f), f the mantissa: grey never jumps
        mantissa = max(bits[i], one_bits) & np.int32((1 << _MANTISSA_BITS) - 1)
        blend[i] = np.float32(mantissa) * scale
    _locate(patches.start, work, n)
    place, right, below = work.place, work.right, work.below
    for i in range(n):
        out[i] = _blend_four(texel, place[i], level[i], right[i], below[i])
    for i in range(n):
        level[i] = max(np.int32(level[i] - one), np.int32(0))
    _locate(patches.start, work, n)
    for i in range(n):
        fine, coarse = out[i], _blend_four(texel, place[i], level[i], right[i], below[i])
        out[i] = fine + blend[i] * (coarse - fine)


@njit_ieee
def _locate(start: Index, work: Reading, n: int) -> None:
    """Find the four texels around each pixel, in the level that `work.level` tells."""
    u, v, level, place = work.u, work.v, work.level, work.place
    right, below, half, one = work.right, work.below, np.float32(0.5), np.int32(1)
    for i in range(n):
        j = level[i]
        m = np.int32(one << j)
        x = np.int32(np.floor(u[i] * np.float32(m) - half)) & np.int32(m - one)
        y = np.int32(np.floor(v[i] * np.float32(m) - half)) & np.int32(m - one)
        thirds = np.int32(np.int32(_THIRDS) & np.int32(np.int32(m * m) - one))
        before = np.int32(thirds + np.int32(np.int32(2) * np.int32(m - one)) + j)
        place[i] = np.int32(start[i] + before + np.int32(y * np.int32(m + one)) + x)
    for i in range(n):
        x = u[i] * np.float32(np.int32(one << level[i])) - half
        right[i] = x - np.floor(x)
    for i in range(n):
        y = v[i] * np.float32(np.int32(one << level[i])) - half
        below[i] = y - np.floor(y)


@njit_ieee
def _blend_four(texel: Grey, place: int, level: int, right: float, below: float) -> float:
    """Bilinear sample from its upper left texel."""
    upper = np.uint32(place)
    lower = np.uint32(place + (1 << level) + 1)
    a, b = texel[upper], texel[upper + np.uint32(1)]
    c, d = texel[lower], texel[lower + np.uint32(1)]
    top, low = a + right * (b - a), c + right * (d - c)
    return top + below * (low - top)


@njit_ieee
def sample(texel: Grey, start: int, order: int, u: float, v: float, texels: float) -> float:
    """Trilinear sample of one texture for one pixel.

    Args:
        texel: Of the atlas.
        start: Where its pyramid begins.
        order: Its highest level.
        u: Across, in periods of the texture; any number.
        v: Down, likewise.
        texels: Size of the pixel on the texture, in texels of the full size.
    """
    rest, j = texels, order
    while rest >= 2.0 and j > 0:
        rest *= 0.5
        j -= 1
    fine = _bilinear(texel, start, j, u, v)
    if rest <= 1.0 or j == 0:
        return fine
    coarse = _bilinear(texel, start, j - 1, u, v)
    return fine + np.float32(rest - 1.0) * (coarse - fine)


@njit_ieee
def _bilinear(texel: Grey, start: int, j: int, u: float, v: float) -> float:
    m = 1 << j
    x, y = u * m - 0.5, v * m - 0.5
    x0, y0 = math.floor(x), math.floor(y)
    before = (_THIRDS & (m * m - 1)) + 2 * (m - 1) + j
    place = start + before + (int(y0) & (m - 1)) * (m + 1) + (int(x0) & (m - 1))
    return _blend_four(texel, place, j, np.float32(x - x0), np.float32(y - y0))
