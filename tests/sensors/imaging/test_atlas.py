# SPDX-License-Identifier: Apache-2.0
"""Textures: what sampling must keep, at every scale."""

import numpy as np
import pytest

from skyhaul.jit import njit
from skyhaul.sensors.imaging.atlas import (
    Patches,
    Spots,
    blank_reading,
    build_atlas,
    read_textures,
    sample,
)

RNG = np.random.default_rng(5)
NOISE = RNG.random((64, 64)).astype(np.float32)
SMALL = RNG.random((16, 16)).astype(np.float32)
ATLAS = build_atlas([SMALL, np.full((32, 32), 0.25, np.float32), NOISE])


@njit
def sample_many(texel, start, order, u, v, footprint):
    out = np.empty(len(u))
    for i in range(len(u)):
        out[i] = sample(texel, start, order, u[i], v[i], footprint[i])
    return out


def at(k, u, v, footprint):
    u, v, footprint = np.broadcast_arrays(*(np.asarray(a, float) for a in (u, v, footprint)))
    flat = (np.ascontiguousarray(a.ravel()) for a in (u, v, footprint))
    return sample_many(ATLAS.texel, ATLAS.start[k], ATLAS.order[k], *flat).reshape(u.shape)


@pytest.mark.parametrize(("k", "texture"), [(0, SMALL), (2, NOISE)])
def test_texel_centres_give_the_texels(k, texture):
    n = len(texture)
    u, v = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n)
    np.testing.assert_allclose(at(k, u, v, 1.0), texture, atol=1e-6)


def test_a_plain_texture_is_plain_at_every_place_and_scale():
    u, v, wide = RNG.uniform(-9, 9, (3, 500))
    np.testing.assert_allclose(at(1, u, v, np.exp2(wide)), 0.25, atol=1e-7)


def test_textures_repeat():
    u, v, wide = RNG.uniform(0, 1, 300), RNG.uniform(0, 1, 300), np.exp2(RNG.uniform(-2, 5, 300))
    np.testing.assert_allclose(at(2, u + 7, v - 5, wide), at(2, u, v, wide), atol=1e-5)


@pytest.mark.parametrize("footprint", [1.0, 2.0, 3.0, 8.0, 40.0, 1e6])
def test_the_mean_is_the_same_at_every_scale(footprint):
    u, v = np.meshgrid((np.arange(128) + 0.5) / 128, (np.arange(128) + 0.5) / 128)
    assert at(2, u, v, footprint).mean() == pytest.approx(NOISE.mean(), abs=1e-4)


def test_a_pixel_of_two_texels_sees_their_mean():
    blocks = NOISE.reshape(32, 2, 32, 2).mean(axis=(1, 3))
    u, v = np.meshgrid((np.arange(32) + 0.5) / 32, (np.arange(32) + 0.5) / 32)
    np.testing.assert_allclose(at(2, u, v, 2.0), blocks, atol=1e-6)


def test_grey_never_jumps_when_the_scale_changes():
    wide = np.exp2(np.linspace(-1.0, 8.0, 20_001))
    for u, v in RNG.uniform(0, 1, (20, 2)):
        assert np.abs(np.diff(at(2, np.full_like(wide, u), v, wide))).max() < 2e-3


def test_detail_fades_with_the_scale():
    u, v = RNG.uniform(0, 1, (2, 4000))
    spread = [at(2, u, v, w).std() for w in (1.0, 2.0, 4.0, 8.0, 16.0, 64.0)]
    assert np.all(np.diff(spread) < 0.0)
    assert spread[-1] < 1e-6


def test_many_pixels_at_once_read_what_each_reads_alone():
    k = 400
    which = RNG.integers(0, 3, k)
    per_m, (across, down) = RNG.uniform(0.2, 2.0, k), RNG.uniform(-20, 20, (2, k))
    wide = np.exp2(RNG.uniform(-9, 9, k))
    patches = Patches(
        ATLAS.start[which].astype(np.int32), ATLAS.order[which].astype(np.int32),
        per_m.astype(np.float32),
    )  # fmt: skip
    spots = Spots(*(a.astype(np.float32) for a in (across, down, wide)))
    out = np.full(k, np.nan, dtype=np.float32)
    read_textures(ATLAS.texel, patches, spots, blank_reading(k), k - 1, out)
    alone = [
        at(w, a * s, b * s, f * s * 2.0 ** ATLAS.order[w])
        for w, a, b, f, s in zip(which, across, down, wide, per_m, strict=True)
    ]
    assert np.isnan(out[-1])
    assert np.ptp(out[:-1]) > 0.5
    np.testing.assert_allclose(out[:-1], np.ravel(alone)[:-1], atol=2e-3)
    assert np.median(np.abs(out - np.ravel(alone))[:-1]) < 2e-5
