# SPDX-License-Identifier: Apache-2.0
"""`kind: particles`: obstacles' motion as a particle filter, as the paper allows."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.obstacles.motion import Belief, Moments
from skyhaul.perception.obstacles.polar import Polar, innovation, per_track
from skyhaul.types import Array


class ParticleBelief(NamedTuple):
    """Particles of every track."""

    x: Array  # (n, particles, 6) p_WO, v_WO
    weight: Array  # (n, particles), sum 1


@dataclass(frozen=True, kw_only=True)
class ParticleFilter(Params):
    """Bootstrap filter with white acceleration, systematic resampling and a little roughening."""

    kind: Literal["particles"] = "particles"
    particles: int = 800
    """Particles of each track."""
    speed_sigma_mps: float = 1.5
    """Standard deviation of a new track's velocity, each axis [m/s]."""
    manoeuvre: float = 0.3
    """Density of the white acceleration [m^2/s^3]."""
    roughening: float = 0.5
    """Noise after resampling, as a share of the particles' own spread."""

    def __post_init__(self) -> None:
        if self.particles < 10:
            raise ValueError(f"particles must be >= 10, got {self.particles}")
        for name in ("speed_sigma_mps", "manoeuvre"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not 0.0 <= self.roughening < 1.0:
            raise ValueError(f"roughening must lie in [0, 1), got {self.roughening}")

    def start(self, p_WO: Array, covariance: Array, rng: np.random.Generator) -> ParticleBelief:
        """See `MotionFilter.start`."""
        n, k = len(p_WO), self.particles
        x = np.empty((n, k, 6))
        root = np.linalg.cholesky(covariance)
        x[..., :3] = p_WO[:, None] + rng.normal(size=(n, k, 3)) @ np.swapaxes(root, -1, -2)
        x[..., 3:] = self.speed_sigma_mps * rng.normal(size=(n, k, 3))
        return ParticleBelief(x, np.full((n, k), 1.0 / k))

    def predict(self, belief: Belief, dt_s: float, rng: np.random.Generator) -> ParticleBelief:
        """See `MotionFilter.predict`: noise of the exact covariance of white acceleration."""
        x, weight = belief
        if dt_s == 0.0:
            return ParticleBelief(x, weight)
        x = x.copy()
        a, b = rng.normal(size=(2, *x.shape[:2], 3)) * np.sqrt(self.manoeuvre * dt_s)
        x[..., :3] += dt_s * (x[..., 3:] + 0.5 * a + b / np.sqrt(12.0))
        x[..., 3:] += a
        return ParticleBelief(x, weight)

    def update(self, belief: Belief, z: Polar, rng: np.random.Generator) -> ParticleBelief:
        """See `MotionFilter.update`."""
        x, weight = belief
        found = innovation(x[..., :3], per_track(z))
        squared = np.sum(found.residual**2 / z.variance[:, None], axis=-1)
        log_weight = np.log(np.maximum(weight, 1e-300)) - 0.5 * squared
        log_weight[found.ahead <= 0.0] -= 1e3
        weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        few = 1.0 / np.sum(weight**2, axis=1) < 0.5 * self.particles
        x = x.copy()
        for i in np.flatnonzero(few):
            x[i] = self._resampled(x[i], weight[i], rng)
            weight[i] = 1.0 / self.particles
        return ParticleBelief(x, weight)

    def moments(self, belief: Belief) -> Moments:
        """See `MotionFilter.moments`."""
        x, weight = belief
        mean = np.einsum("nk,nka->na", weight, x)
        off = x - mean[:, None]
        covariance = np.swapaxes(weight[..., None] * off, -1, -2) @ off
        return Moments(mean[:, :3], mean[:, 3:], covariance)

    def spread(self, belief: Belief, dt_s: float) -> Array:
        """See `MotionFilter.spread`."""
        cov = self.moments(belief).covariance
        cross = cov[:, :3, 3:] + np.swapaxes(cov[:, :3, 3:], -1, -2)
        moved: Array = cov[:, :3, :3] + dt_s * cross + dt_s**2 * cov[:, 3:, 3:]
        return moved + self.manoeuvre * dt_s**3 / 3.0 * np.eye(3)

    def _resampled(self, x: Array, weight: Array, rng: np.random.Generator) -> Array:
        """Particles drawn by weight, (k, 6), shrunk and roughened so that moments stay."""
        k = len(x)
        mean = weight @ x
        off = x - mean
        root = np.linalg.cholesky((weight[:, None] * off).T @ off + 1e-12 * np.eye(6))
        at = np.minimum(
            np.searchsorted(np.cumsum(weight), (np.arange(k) + rng.random()) / k), k - 1
        )
        keep = np.sqrt(1.0 - self.roughening**2)
        rough: Array = self.roughening * rng.normal(size=(k, 6)) @ root.T
        drawn: Array = mean + keep * off[at] + rough
        return drawn
