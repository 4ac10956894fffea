# SPDX-License-Identifier: Apache-2.0
"""What is kept of every track besides its motion, and small helpers of the tracker."""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from skyhaul.perception.obstacles.births import Newborn
from skyhaul.perception.obstacles.motion import Belief, Moments, MotionFilter
from skyhaul.types import Array, IntArray, Mask


class Book(NamedTuple):
    """What is kept of every track besides its motion; the first axis is the track."""

    name: IntArray  # (n,) identity
    confirmed: Mask  # (n,)
    hits: Mask  # (n, N) whether it was seen, newest last
    steps: IntArray  # (n,) how long it has lived
    seen_us: IntArray  # (n,) when it was seen last
    cameras: IntArray  # (n,) which cameras ever saw it, as bits


def random_of_step(seed: int, step_index: int) -> np.random.Generator:
    """Random numbers of one step: of their own stretch of the seed's stream."""
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, step_index, 0, 0]))


def chi2_limit(probability: float, freedoms: IntArray) -> Array:
    """Squared Mahalanobis distance that holds this share of a Gaussian."""
    return np.array(_quantiles(probability))[freedoms]


@cache
def _quantiles(probability: float) -> tuple[float, ...]:
    """Of the chi-square with 0 to 3 degrees of freedom."""
    return 0.0, *(float(chi2.ppf(probability, k)) for k in (1, 2, 3))


def bits_of(born: Newborn) -> int:
    """Cameras that saw a newborn, as bits."""
    return sum(1 << (c % 62) for c in born.cameras)


def moments_of(motion: MotionFilter, belief: Belief, which: IntArray | Mask) -> Moments:
    """Mean and covariance of some tracks."""
    return motion.moments(take(belief, which))


def take(belief: Belief, which: IntArray | Mask) -> Belief:
    """The beliefs of some tracks."""
    return tuple(a[which] for a in belief)
