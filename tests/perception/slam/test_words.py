# SPDX-License-Identifier: Apache-2.0
"""Words find the same place among others, seen from elsewhere."""

import cv2
import numpy as np
import pytest

from skyhaul.errors import GeometryError
from skyhaul.perception.slam.words import PlaceIndex, train_words, words_of

ORB = cv2.ORB.create(300, fastThreshold=10)


def wall(seed):
    """A wall with patches of all sizes, 480 x 480 px."""
    rng, image = np.random.default_rng(seed), np.zeros((480, 480), dtype=np.float32)
    for sigma, gain in ((2, 1.0), (6, 2.0), (20, 4.0)):
        layer = cv2.GaussianBlur(rng.normal(size=(480, 480)).astype(np.float32), (0, 0), sigma)
        image += gain * layer / layer.std()
    return cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def descriptors(image, turn_deg=0.0, scale=1.0, noise_seed=0):
    """ORB of a view of a wall, turned and from another distance."""
    M = cv2.getRotationMatrix2D((240, 240), turn_deg, scale)
    M[:, 2] -= (80, 120)
    view = cv2.warpAffine(image, M, (320, 240))
    noise = np.random.default_rng(noise_seed).normal(0, 2, view.shape)
    return ORB.detectAndCompute(np.clip(view + noise, 0, 255).astype(np.uint8), None)[1]


@pytest.fixture(scope="module")
def index():
    places = [descriptors(wall(k)) for k in range(12)]
    out = PlaceIndex(train_words(np.vstack(places), 256, seed=0))
    for place in places:
        out = out.add(place)
    return out


@pytest.mark.parametrize("place", range(12))
def test_a_place_is_found_turned_and_from_another_distance(index, place):
    seen = descriptors(wall(place), turn_deg=8.0, scale=1.1, noise_seed=5)
    first, second = index.query(seen, before=12, most=2)
    assert first.place == place
    assert first.score > second.score


def test_a_place_is_itself_with_score_one(index):
    assert index.query(descriptors(wall(3)), before=12, most=1)[0].score == pytest.approx(1.0)


def test_places_just_left_do_not_count(index):
    found = index.query(descriptors(wall(7)), before=7, most=12)
    assert found
    assert max(c.place for c in found) < 7


def test_each_word_is_its_own_word():
    rng = np.random.default_rng(0)
    words = rng.integers(0, 256, (50, 32), dtype=np.uint8)
    assert words_of(words, words).tolist() == list(range(50))


def test_words_are_the_majority_of_their_members():
    rng = np.random.default_rng(1)
    centres = rng.integers(0, 256, (4, 32), dtype=np.uint8)
    bits = np.unpackbits(np.repeat(centres, 41, axis=0), axis=1)
    flipped = bits ^ (rng.random(bits.shape) < 0.05)
    words = train_words(np.packbits(flipped, axis=1), 40, seed=0)
    near = [min(np.unpackbits(w ^ c).sum() for w in words) for c in centres]
    assert max(near) <= 25


def test_without_descriptors_there_are_no_words():
    with pytest.raises(GeometryError, match="got none"):
        train_words(np.zeros((0, 32), dtype=np.uint8), 10, seed=0)
