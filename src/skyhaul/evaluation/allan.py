# SPDX-License-Identifier: Apache-2.0
"""Allan deviation, and the noise densities that it tells."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from skyhaul.types import Array, IntArray


class NoiseFit(NamedTuple):
    """Densities of a rate's noise."""

    white: float  # N, unit/sqrt(Hz)
    walk: float  # K, unit/s/sqrt(Hz)


def allan_deviation(samples: Array, period_s: float, counts: Sequence[int] | IntArray) -> Array:
    """Overlapping Allan deviation of a record.

    sigma^2(m T) = mean over k of (x[k + 2m] - 2 x[k + m] + x[k])^2 / (2 (m T)^2), x the integral
    of the record. Samples may be means over T of a faster record: for these times it is the same.

    Args:
        samples: The record, (n,), evenly spaced.
        period_s: Its period T [s].
        counts: Averaging times, in periods, each at most n / 2.

    Returns:
        The deviations, one for each count.

    Source: IEEE Std 952-1997, annex C; Riley, Handbook of Frequency Stability Analysis (2008).
    """
    x = np.concatenate([[0.0], np.cumsum(samples - samples.mean())]) * period_s
    out = np.empty(len(counts))
    for i, m in enumerate(counts):
        second = x[2 * m :] - 2.0 * x[m:-m] + x[: -2 * m]
        out[i] = math.sqrt(float(second @ second) / len(second) / 2.0) / (m * period_s)
    return out


def log_counts(n: int, per_decade: int = 8) -> IntArray:
    """Averaging counts for a record of n samples, evenly spaced in their logarithm, up to n/20."""
    decades = math.log10(n / 20.0)
    return np.unique(np.round(np.logspace(0.0, decades, round(per_decade * decades)))).astype(
        np.int64
    )


def fit_noise(samples: Array, period_s: float) -> NoiseFit:
    """White noise N and random walk K of a record at rest, (n,).

    Least squares of sigma^2(tau) = N^2 / tau + K^2 tau / 3 over averaging times up to a twentieth
    of the record, each weighted by the number of times it fits into the record.
    """
    counts = log_counts(len(samples))
    tau = period_s * counts
    variance = allan_deviation(samples, period_s, counts) ** 2
    weight = np.sqrt(len(samples) / counts) / variance
    rows = np.column_stack([1.0 / tau, tau / 3.0])
    scale = np.linalg.norm(rows * weight[:, None], axis=0)
    fit, *_ = np.linalg.lstsq(rows * weight[:, None] / scale, variance * weight, rcond=None)
    white, walk = np.sqrt(np.maximum(fit / scale, 0.0))
    return NoiseFit(float(white), float(walk))
