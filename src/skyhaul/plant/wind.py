# SPDX-License-Identifier: Apache-2.0
"""Wind over time: mean, Dryden turbulence, single gusts. The same everywhere in the room."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc

from skyhaul.types import Array
from skyhaul.world.scenario import Wind

SLOWEST_MPS = 1.0
"""Turbulence passes the team at the speed of the mean wind, but at least at this [m/s]."""
WIND_STREAM = 1_000_003
"""Second word of the wind's random seed, beyond every obstacle's index."""


@dataclass(eq=False)
class WindMemory:
    """State of the forming filters and their random source."""

    along: float  # longitudinal filter, unit variance
    across: Array  # (2, 2) rows lateral, vertical: filter states, unit variance
    rng: np.random.Generator


@dataclass(frozen=True, eq=False)
class WindModel:
    """Wind of a scenario, sampled every dt."""

    wind: Wind
    R_WU: Array  # (3, 3) columns: along the mean wind, to its left, up
    decay: float  # longitudinal filter over dt
    transition: Array  # (2, 2) transverse filter over dt
    spread: Array  # (2, 2) Cholesky factor of its noise over dt

    def init(self, seed: int) -> WindMemory:
        """Memory at time 0, drawn from the stationary distribution."""
        rng = np.random.default_rng([seed, WIND_STREAM])
        return WindMemory(float(rng.standard_normal()), rng.standard_normal((2, 2)), rng)

    def step(self, memory: WindMemory) -> None:
        """Advance the turbulence by dt, in place: it is one of the plant's states."""
        noise = memory.rng.standard_normal(5)
        memory.along = self.decay * memory.along + math.sqrt(1.0 - self.decay**2) * noise[0]
        drive = noise[1:].reshape(2, 2)
        memory.across = memory.across @ self.transition.T + drive @ self.spread.T

    def at(self, memory: WindMemory, t_s: float) -> Array:
        """Wind at a time, W axes, (3,) [m/s]."""
        w = np.array(self.wind.mean_mps, dtype=np.float64)
        if self.wind.turbulence_mps > 0.0:
            lateral, vertical = 0.5 * (memory.across[:, 0] + math.sqrt(3.0) * memory.across[:, 1])
            u = np.array([memory.along, lateral, vertical])
            w += self.wind.turbulence_mps * (self.R_WU @ u)
        for gust in self.wind.gusts:
            s = (t_s - gust.start_s) / gust.duration_s
            if 0.0 < s < 1.0:
                w += 0.5 * (1.0 - math.cos(2.0 * math.pi * s)) * np.array(gust.peak_mps)
        return w


def wind_model(wind: Wind, dt: float) -> WindModel:
    """Discretise the Dryden forming filters exactly.

    Along the mean wind sqrt(2 tau) / (1 + tau s), across it and up
    sqrt(tau) (1 + sqrt(3) tau s) / (1 + tau s)^2, tau = L / V, each with unit variance and scaled
    by `turbulence_mps`. In states of unit stationary covariance the noise over a step is
    I - Phi Phi^T.

    Args:
        wind: Parameters.
        dt: Step [s].

    Source: MIL-F-8785C, Dryden form; the gusts are its 1 - cosine gusts.
    """
    mean = np.array(wind.mean_mps, dtype=np.float64)
    h = dt * max(float(np.linalg.norm(mean)), SLOWEST_MPS) / wind.length_scale_m
    transition = math.exp(-h) * np.array([[1.0 + h, h], [-h, 1.0 - h]])
    return WindModel(
        wind=wind,
        R_WU=_axes(mean),
        decay=math.exp(-h),
        transition=transition,
        spread=_spread(h),
    )


def _spread(h: float) -> Array:
    """Cholesky factor of I - Phi Phi^T, (2, 2), without the cancellation for small steps h.

    I - Phi Phi^T = [[P, 2 h^2 e], [2 h^2 e, P + 4 h e]] with e = exp(-2 h), and P, the regularised
    lower incomplete gamma function P(3, 2 h), is 1 - (1 + 2 h + 2 h^2) e.
    """
    e, first = math.exp(-2.0 * h), float(gammainc(3.0, 2.0 * h))
    across = 2.0 * h * h * e / math.sqrt(first)
    rest = math.sqrt(max(first + 4.0 * h * e - across * across, 0.0))
    return np.array([[math.sqrt(first), 0.0], [across, rest]])


def _axes(mean: Array) -> Array:
    """Along the horizontal part of the mean wind (x when there is none), left of it, up."""
    heading = math.atan2(mean[1], mean[0])
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def is_calm(wind: Wind) -> bool:
    """Whether the wind never changes."""
    return wind.turbulence_mps == 0.0 and not wind.gusts
