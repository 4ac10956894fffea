# SPDX-License-Identifier: Apache-2.0
"""Random numbers by counting: the same for a pixel whatever is drawn before, after or elsewhere.

Number `count` of pixel `pixel` is a hash of (key, pixel, count): there is no state to hand on, so
neither the order of pixels, nor processes, nor the instants of rendering change a draw.

Source: Salmon et al., Parallel random numbers: as easy as 1, 2, 3, SC 2011 (the idea); the mixing
function is the finaliser of SplitMix64, Steele, Lea and Flood, OOPSLA 2014.
"""

import math

import numpy as np

from skyhaul.jit import njit_ieee
from skyhaul.types import Array

_PIXEL = np.uint64(0x9E3779B97F4A7C15)
_COUNT = np.uint64(0xD1B54A32D192ED03)
_MIX_A = np.uint64(0xBF58476D1CE4E5B9)
_MIX_B = np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(11)
_ULP = 2.0**-53


@njit_ieee
def mix(z: np.uint64) -> np.uint64:
    """Spread every bit of z over all bits."""
    z = (z ^ (z >> _S30)) * _MIX_A
    z = (z ^ (z >> _S27)) * _MIX_B
    return z ^ (z >> _S31)


@njit_ieee
def uniform(key: np.uint64, pixel: int, count: int) -> float:
    """A number in (0, 1): draw `count` of a pixel."""
    z = mix(mix(key + np.uint64(pixel) * _PIXEL) + np.uint64(count) * _COUNT)
    return (np.float64(z >> _S11) + 0.5) * _ULP


@njit_ieee
def waiting_time(key: np.uint64, pixel: int, count: int, rate: float) -> float:
    """Time to the next event of a Poisson process, in the unit of 1 / rate; endless at rate 0."""
    return -math.log(uniform(key, pixel, count)) / rate if rate > 0.0 else math.inf


@njit_ieee
def waiting_times(key: np.uint64, rates: Array) -> Array:
    """Draw 0 of every pixel as a waiting time, (k,); rates (k,)."""
    out = np.empty(rates.shape[0])
    for k in range(rates.shape[0]):
        out[k] = waiting_time(key, k, 0, rates[k])
    return out
