# SPDX-License-Identifier: Apache-2.0
"""`kind: particles`: obstacles' motion as a particle filter, as the paper allows."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.obstacles.motion import Belief, Moments
from skyhaul.perception.obstacles.polar import Polar, extents, innovation, per_track
from skyhaul.types import Array


class ParticleBelief(NamedTuple):
    """Particles of every track."""

    x: Array  # (n, particles, 7) p_WO, v_WO, ln radius
    weight: Array  # (n, particles), sum 1


@dataclass(frozen=True, kw_only=True)
class ParticleFilter(Params):
    """Bootstrap filter with white acceleration, systematic resampling and a little roughening."""

    kind: Literal["particles"] = "particles"
    particles: int = 2000
    """Particles of each track."""
    speed_sigma_mps: float = 1.5
    """Standard deviation of a new track's velocity, each axis [m/s]."""
    manoeuvre: float = 0.3
    """Density of the white acceleration [m^2/s^3]."""
    extent_sigma: float = 0.2
    """Standard deviation of ln extent, as of `KalmanFilter`."""
    size_walk: float = 0.05
    """Standard deviation by which ln radius changes in a second."""
    roughening: float = 0.5
    """Noise after resampling, as a share of the particles' own spread."""

    def __post_init__(self) -> None:
        if self.particles < 10:
            raise ValueError(f"particles must be >= 10, got {self.particles}")
        for name in ("speed_sigma_mps", "manoeuvre", "extent_sigma", "size_walk"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not 0.0 <= self.roughening < 1.0:
            raise ValueError(f"roughening must lie in [0, 1), got {self.roughening}")

    def start(
        self, pr: Array, covariance: Array, rng: np.random.Generator,
        velocity: tuple[Array, Array] | None = None,
    ) -> ParticleBelief:  # fmt: skip
        """See `MotionFilter.start`."""
        n, k = len(pr), self.particles
        x = np.empty((n, k, 7))
        root = np.linalg.cholesky(covariance)
        drawn = pr[:, None] + rng.normal(size=(n, k, 4)) @ np.swapaxes(root, -1, -2)
        x[..., :3], x[..., 6] = drawn[..., :3], drawn[..., 3]
        spread = rng.normal(size=(n, k, 3))
        if velocity is None:
            x[..., 3:6] = self.speed_sigma_mps * spread
        else:
            root = np.linalg.cholesky(velocity[1])
            x[..., 3:6] = velocity[0][:, None] + spread @ np.swapaxes(root, -1, -2)
        return ParticleBelief(x, np.full((n, k), 1.0 / k))

    def predict(self, belief: Belief, dt_s: float, rng: np.random.Generator) -> ParticleBelief:
        """See `MotionFilter.predict`: noise of the exact covariance of white acceleration."""
        x, weight = belief
        if dt_s == 0.0:
            return ParticleBelief(x, weight)
        x = x.copy()
        a, b = rng.normal(size=(2, *x.shape[:2], 3)) * np.sqrt(self.manoeuvre * dt_s)
        x[..., :3] += dt_s * (x[..., 3:6] + 0.5 * a + b / np.sqrt(12.0))
        x[..., 3:6] += a
        x[..., 6] += self.size_walk * np.sqrt(dt_s) * rng.normal(size=x.shape[:2])
        return ParticleBelief(x, weight)

    def update(self, belief: Belief, z: Polar, rng: np.random.Generator) -> ParticleBelief:
        """See `MotionFilter.update`."""
        x, weight = belief
        then = x[..., :3] - z.age_s[:, None, None] * x[..., 3:6]
        found = innovation(then, per_track(z))
        squared = np.sum(found.residual**2 / z.variance[:, None], axis=-1)
        log_extent, variance = extents(z, self.extent_sigma)
        rho = np.linalg.norm(then - z.p_WC[:, None], axis=-1)
        off = log_extent[:, None] - x[..., 6] + np.log(np.maximum(rho, 0.05))
        squared += np.minimum(off**2 / variance[:, None], 9.0)
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

    def hold_size(
        self, belief: Belief, z: Polar, size: tuple[float, float], rng: np.random.Generator
    ) -> ParticleBelief:
        """See `MotionFilter.hold_size`: every particle's size is drawn anew."""
        x, weight = belief
        mean, sigma = size
        drawn = mean + sigma * rng.normal(size=weight.shape)
        s = np.exp(drawn - x[..., 6])[..., None]
        p_WC = (z.p_WC + z.age_s[:, None] * z.v_WC)[:, None]
        v_WC = z.v_WC[:, None]
        p_WO, v_WO = p_WC + s * (x[..., :3] - p_WC), v_WC + s * (x[..., 3:6] - v_WC)
        return ParticleBelief(np.concatenate([p_WO, v_WO, drawn[..., None]], axis=-1), weight)

    def moments(self, belief: Belief) -> Moments:
        """See `MotionFilter.moments`."""
        x, weight = belief
        mean = np.einsum("nk,nka->na", weight, x)
        off = x - mean[:, None]
        covariance = np.swapaxes(weight[..., None] * off, -1, -2) @ off
        of_pv, of_size = covariance[:, :6, :6], covariance[:, 6, 6]
        return Moments(mean[:, :3], mean[:, 3:6], of_pv, mean[:, 6], of_size)

    def spread(self, belief: Belief, dt_s: float) -> Array:
        """See `MotionFilter.spread`."""
        cov = self.moments(belief).covariance
        cross = cov[:, :3, 3:] + np.swapaxes(cov[:, :3, 3:], -1, -2)
        moved: Array = cov[:, :3, :3] + dt_s * cross + dt_s**2 * cov[:, 3:, 3:]
        return moved + self.manoeuvre * dt_s**3 / 3.0 * np.eye(3)

    def _resampled(self, x: Array, weight: Array, rng: np.random.Generator) -> Array:
        """Particles drawn by weight, (k, 7), shrunk and roughened so that moments stay."""
        k = len(x)
        mean = weight @ x
        off = x - mean
        root = np.linalg.cholesky((weight[:, None] * off).T @ off + 1e-12 * np.eye(7))
        at = np.minimum(
            np.searchsorted(np.cumsum(weight), (np.arange(k) + rng.random()) / k), k - 1
        )
        keep = np.sqrt(1.0 - self.roughening**2)
        rough: Array = self.roughening * rng.normal(size=(k, 7)) @ root.T
        drawn: Array = mean + keep * off[at] + rough
        return drawn
