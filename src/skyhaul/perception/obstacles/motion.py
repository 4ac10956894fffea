# SPDX-License-Identifier: Apache-2.0
"""`kind: kalman`: how obstacles move, as Kalman filters, one or two models, all tracks at once.

State (p, v, a). Model `velocity` holds v, with white acceleration; model `acceleration` holds a,
which fades with a time constant (Singer), with white jerk. With both, the filters interact: each
starts a step from the mixture of both (IMM).

Source: Blom and Bar-Shalom, "The interacting multiple model algorithm" (TAC 1988); Singer (1970).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple, Protocol

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.obstacles.kernels import update_all
from skyhaul.perception.obstacles.polar import Polar, measured
from skyhaul.types import Array

Belief = tuple[Array, ...]
"""What a filter believes of all tracks: arrays whose first axis is the track."""

P, V, A = slice(0, 3), slice(3, 6), slice(6, 9)
PV = slice(0, 6)


class Moments(NamedTuple):
    """Mean and covariance of every track."""

    p_WO: Array  # (n, 3) [m]
    v_WO: Array  # (n, 3) [m/s]
    covariance: Array  # (n, 6, 6) of p_WO, v_WO


class MotionFilter(Protocol):
    """How the motion of all tracks is believed in."""

    def start(self, p_WO: Array, covariance: Array, rng: np.random.Generator) -> Belief:
        """Beliefs about new tracks, seen once: positions (n, 3), covariances (n, 3, 3)."""
        ...

    def predict(self, belief: Belief, dt_s: float, rng: np.random.Generator) -> Belief:
        """Beliefs a while later."""
        ...

    def update(self, belief: Belief, z: Polar, rng: np.random.Generator) -> Belief:
        """Beliefs given a measurement each."""
        ...

    def moments(self, belief: Belief) -> Moments:
        """Mean and covariance."""
        ...

    def spread(self, belief: Belief, dt_s: float) -> Array:
        """Second moment of the way off p + v dt after dt, (n, 3, 3) [m^2]."""
        ...


class KalmanBelief(NamedTuple):
    """One Gaussian per model, and how likely each model is."""

    x: Array  # (n, m, 9)
    covariance: Array  # (n, m, 9, 9)
    weight: Array  # (n, m)


@dataclass(frozen=True, kw_only=True)
class KalmanFilter(Params):
    """Kalman filters over the motion models."""

    kind: Literal["kalman"] = "kalman"
    models: Literal["velocity", "acceleration", "both"] = "both"
    """Which motion models there are."""
    speed_sigma_mps: float = 1.5
    """Standard deviation of a new track's velocity, each axis [m/s]."""
    manoeuvre: float = 0.05
    """Model velocity: density of the white acceleration [m^2/s^3]."""
    accel_sigma_mps2: float = 1.5
    """Model acceleration: standard deviation of the acceleration, each axis [m/s^2]."""
    accel_time_s: float = 1.0
    """Model acceleration: time in which an acceleration fades to 37 % [s]."""
    stay_s: float = 1.0
    """How long a model lasts on average before the other takes over [s]."""

    def __post_init__(self) -> None:
        for name in (
            "speed_sigma_mps", "manoeuvre", "accel_sigma_mps2", "accel_time_s", "stay_s",
        ):  # fmt: skip
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")

    @property
    def _used(self) -> slice:
        return {"velocity": slice(0, 1), "acceleration": slice(1, 2), "both": slice(0, 2)}[
            self.models
        ]

    def start(self, p_WO: Array, covariance: Array, rng: np.random.Generator) -> KalmanBelief:
        """See `MotionFilter.start`."""
        n, m = len(p_WO), self._used.stop - self._used.start
        x = np.zeros((n, m, 9))
        x[..., P] = p_WO[:, None]
        cov = np.zeros((n, m, 9, 9))
        cov[..., P, P] = covariance[:, None]
        cov[..., V, V] = self.speed_sigma_mps**2 * np.eye(3)
        cov[..., A, A] = self.accel_sigma_mps2**2 * np.eye(3)
        return KalmanBelief(x, cov, np.full((n, m), 1.0 / m))

    def predict(
        self, belief: Belief, dt_s: float, rng: np.random.Generator | None = None
    ) -> KalmanBelief:
        """See `MotionFilter.predict`: mix the models, then move each on."""
        if dt_s == 0.0:
            return KalmanBelief(*belief)
        x, cov, weight = self._mixed(KalmanBelief(*belief), dt_s)
        F, Q = (a[self._used] for a in _transition(self, dt_s))
        moved = (F @ x[..., None])[..., 0]
        return KalmanBelief(moved, F @ cov @ np.swapaxes(F, -1, -2) + Q, weight)

    def update(
        self, belief: Belief, z: Polar, rng: np.random.Generator | None = None
    ) -> KalmanBelief:
        """See `MotionFilter.update`: extended Kalman update in Joseph form, model by model."""
        x, cov, weight = (a.copy() for a in belief)
        log_likelihood = np.empty_like(weight)
        update_all(x, cov, log_likelihood, *measured(z))
        log_weight = np.log(weight) + log_likelihood
        likely = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
        weight = np.maximum(likely / likely.sum(axis=1, keepdims=True), 1e-9)
        return KalmanBelief(x, cov, weight / weight.sum(axis=1, keepdims=True))

    def moments(self, belief: Belief) -> Moments:
        """See `MotionFilter.moments`."""
        x, cov, weight = belief
        if x.shape[1] == 1:
            return Moments(x[:, 0, P], x[:, 0, V], cov[:, 0, PV, PV])
        x, w = x[..., PV], weight[..., None]
        mean = np.sum(w * x, axis=1)
        off = x - mean[:, None]
        second = cov[..., PV, PV] + off[..., :, None] * off[..., None, :]
        return Moments(mean[:, P], mean[:, V], np.sum(w[..., None] * second, axis=1))

    def spread(self, belief: Belief, dt_s: float) -> Array:
        """See `MotionFilter.spread`."""
        now, then = self.moments(belief), self.predict(belief, dt_s)
        off = then.x[..., P] - (now.p_WO + dt_s * now.v_WO)[:, None]
        second = then.covariance[..., P, P] + off[..., :, None] * off[..., None, :]
        total: Array = np.sum(then.weight[..., None, None] * second, axis=1)
        return total

    def transition(self, dt_s: float) -> tuple[Array, Array]:
        """F and Q of both models, (2, 9, 9)."""
        t, alpha = dt_s, 1.0 / self.accel_time_s
        fade = np.exp(-alpha * t)
        F, Q = np.zeros((2, 3, 3)), np.zeros((2, 3, 3))
        F[0] = [[1.0, t, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
        from_v = (1.0 - fade) / alpha
        F[1] = [[1.0, t, (t - from_v) / alpha], [0.0, 1.0, from_v], [0.0, 0.0, fade]]
        Q[0, :2, :2] = self.manoeuvre * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        # its acceleration is unknown to model `velocity`, not known to be zero
        Q[0, 2, 2] = self.accel_sigma_mps2**2
        # stationary in a: what fades comes back as noise
        Q[1] = _singer_noise(t, alpha, self.accel_sigma_mps2)
        eye = np.eye(3)[None]
        both = np.kron(F, eye), np.kron(Q, eye)
        return np.asarray(both[0], np.float64), np.asarray(both[1], np.float64)

    def _mixed(self, belief: KalmanBelief, dt_s: float) -> KalmanBelief:
        """Where each model starts a step from, and the models' weights after it."""
        m = belief.x.shape[1]
        if m == 1:
            return belief
        switch = 0.5 * (1.0 - np.exp(-2.0 * dt_s / self.stay_s))
        step = np.array([[1.0 - switch, switch], [switch, 1.0 - switch]])
        joint = belief.weight[:, :, None] * step  # (n, from, to)
        weight = joint.sum(axis=1)
        share = joint / weight[:, None]
        x = np.einsum("nij,nia->nja", share, belief.x)
        off = belief.x[:, :, None] - x[:, None]  # (n, from, to, 9)
        cov = np.einsum("nij,niab->njab", share, belief.covariance)
        cov += np.einsum("nij,nija,nijb->njab", share, off, off)
        return KalmanBelief(x, cov, weight)


@lru_cache(maxsize=64)
def _transition(params: KalmanFilter, dt_s: float) -> tuple[Array, Array]:
    """`KalmanFilter.transition`, kept: steps are mostly of one length."""
    return params.transition(dt_s)


def _singer_noise(t: float, alpha: float, sigma: float) -> Array:
    """Covariance that a fading random acceleration adds to (p, v, a) of one axis in t.

    The integral of F(s) g g^T F(s)^T over 0..t with density 2 alpha sigma^2, by Gauss-Legendre.
    """
    nodes, weights = _NODES, _WEIGHTS
    s = 0.5 * t * (nodes + 1.0)
    fade = np.exp(-alpha * s)
    from_v = (1.0 - fade) / alpha
    g = np.stack([(s - from_v) / alpha, from_v, fade])
    total: Array = (g * (alpha * sigma**2 * t * weights)) @ g.T
    return total


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
