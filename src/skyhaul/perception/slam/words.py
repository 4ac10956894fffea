# SPDX-License-Identifier: Apache-2.0
"""Binary bag of words: descriptors to words, and the places that share them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from skyhaul.errors import GeometryError
from skyhaul.types import IntArray

Descriptors = NDArray[np.uint8]
"""ORB descriptors, (k, 32): 256 bits each."""


def train_words(descriptors: Descriptors, count: int, seed: int, rounds: int = 8) -> Descriptors:
    """Words by k-majority: nearest word in Hamming distance, each bit by vote of its members.

    Args:
        descriptors: What to learn from, (k, 32).
        count: Words wanted; fewer where there are fewer different descriptors.
        seed: Draws the first words.
        rounds: Times that words are voted anew.

    Returns:
        Words, (w, 32).

    Raises:
        GeometryError: When there is no descriptor.

    Source:    Grana et al., A fast approach for integrating ORB descriptors in the bag of words
               model, 2013.
    """
    if len(descriptors) == 0:
        raise GeometryError("words are learnt from descriptors, got none: give images with corners")
    distinct = np.unique(descriptors, axis=0)
    rng = np.random.default_rng(seed)
    words = distinct[rng.permutation(len(distinct))[:count]]
    bits = np.unpackbits(descriptors, axis=1)
    for _ in range(rounds):
        word = words_of(words, descriptors)
        members = np.bincount(word, minlength=len(words))
        votes = np.zeros((len(words), bits.shape[1]), dtype=np.int64)
        np.add.at(votes, word, bits)
        voted = np.packbits(2 * votes > members[:, None], axis=1)
        words = np.where(members[:, None] > 0, voted, words)
    return words


def words_of(words: Descriptors, descriptors: Descriptors) -> IntArray:
    """The nearest word of each descriptor, (k,)."""
    if len(descriptors) == 0:
        return np.zeros(0, dtype=np.int64)
    matches = cv2.BFMatcher(cv2.NORM_HAMMING).match(descriptors, words)
    return np.array([m.trainIdx for m in matches], dtype=np.int64)


@dataclass(frozen=True)
class Candidate:
    """A place that looks alike."""

    place: int
    score: float  # 0 to 1


@dataclass(frozen=True, eq=False)
class PlaceIndex:
    """Inverted index: for each word the places that hold it and how often."""

    words: Descriptors  # (w, 32)
    postings: Mapping[int, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    counts: tuple[IntArray, ...] = ()  # of each place: words (k, 2) and how often each

    def add(self, descriptors: Descriptors) -> "PlaceIndex":
        """The index with one more place; its number is the count of those before."""
        word, count = np.unique(words_of(self.words, descriptors), return_counts=True)
        postings, place = dict(self.postings), len(self.counts)
        for w, n in zip(word.tolist(), count.tolist(), strict=True):
            postings[w] = (*postings.get(w, ()), (place, n))
        return replace(
            self, postings=postings, counts=(*self.counts, np.column_stack([word, count]))
        )

    def query(self, descriptors: Descriptors, before: int, most: int) -> list[Candidate]:
        """Places that share the rarest words, the best first.

        The score is 1 - |a - b|_1 / 2, with a and b the tf-idf weights of both, each of sum 1.

        Args:
            descriptors: Of the images now, (k, 32).
            before: Only places with a smaller number count: those just left do not.
            most: How many at most.

        Source:    Nister and Stewenius, CVPR 2006.
        """
        word, count = np.unique(words_of(self.words, descriptors), return_counts=True)
        a = self._weights(np.column_stack([word, count]))
        shared: dict[int, set[int]] = {}
        for w in a:
            for place, _ in self.postings.get(w, ()):
                if place < before:
                    shared.setdefault(place, set()).add(w)
        found = []
        for place, both in shared.items():
            b = self._weights(self.counts[place])
            score = sum(min(a[w], b[w]) for w in sorted(both))
            found.append(Candidate(place, score))
        found.sort(key=lambda c: (-c.score, c.place))
        return found[:most]

    def _weights(self, counts: IntArray) -> dict[int, float]:
        """tf-idf of a place's words, of sum 1."""
        n = len(self.counts)
        raw = {
            w: c * math.log((1.0 + n) / (1.0 + len(self.postings.get(w, ()))))
            for w, c in counts.tolist()
        }
        total = sum(raw.values())
        return {w: v / total for w, v in raw.items()} if total > 0.0 else dict.fromkeys(raw, 0.0)
