# SPDX-License-Identifier: Apache-2.0
"""`kind: kalman`: how obstacles move, as Kalman filters, one or two models, all tracks at once.

State (p, v, a, ln r), r the radius of the ball that looks as large. Model `velocity` holds v,
with white acceleration; model `acceleration` holds a, which fades with a time constant (Singer),
with white jerk. With both, the filters interact: each starts a step from the mixture of both (IMM).

Source: Blom and Bar-Shalom, "The interacting multiple model algorithm" (TAC 1988); Singer (1970).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple, Protocol

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.obstacles.kernels import SIZE, update_all
from skyhaul.perception.obstacles.polar import Polar, extents, measured
from skyhaul.types import Array

Belief = tuple[Array, ...]
"""What a filter believes of all tracks: arrays whose first axis is the track."""

P, V, A = slice(0, 3), slice(3, 6), slice(6, 9)
PV = slice(0, 6)
PR = [0, 1, 2, SIZE]


class Moments(NamedTuple):
    """Mean and covariance of every track."""

    p_WO: Array  # (n, 3) [m]
    v_WO: Array  # (n, 3) [m/s]
    covariance: Array  # (n, 6, 6) of p_WO, v_WO
    log_radius: Array  # (n,)
    radius_variance: Array  # (n,) of log_radius


class MotionFilter(Protocol):
    """How the motion of all tracks is believed in."""

    def start(
        self, pr: Array, covariance: Array, rng: np.random.Generator,
        velocity: tuple[Array, Array] | None = None,
    ) -> Belief:  # fmt: skip
        """Beliefs about new tracks, seen once.

        Args:
            pr: Positions [m] and ln radii, (n, 4).
            covariance: Theirs, (n, 4, 4).
            rng: Random numbers.
            velocity: Velocities, (n, 3) [m/s], and their covariances, (n, 3, 3), where known.
        """
        ...

    def predict(self, belief: Belief, dt_s: float, rng: np.random.Generator) -> Belief:
        """Beliefs a while later."""
        ...

    def update(self, belief: Belief, z: Polar, rng: np.random.Generator) -> Belief:
        """Beliefs given a measurement each."""
        ...

    def hold_size(
        self, belief: Belief, z: Polar, size: tuple[float, float], rng: np.random.Generator
    ) -> Belief:
        """Beliefs whose radius is again what was believed before anything was seen.

        What one camera sees stays the same when distance, relative velocity and size grow
        together. Direction, extent and how they change are kept; how far that is, is not taken
        from them.

        Args:
            belief: Of tracks that one camera only has ever seen.
            z: What it saw of each.
            size: Mean and standard deviation of ln radius.
            rng: Random numbers.
        """
        ...

    def moments(self, belief: Belief) -> Moments:
        """Mean and covariance."""
        ...

    def spread(self, belief: Belief, dt_s: float) -> Array:
        """Second moment of the way off p + v dt after dt, (n, 3, 3) [m^2]."""
        ...


class KalmanBelief(NamedTuple):
    """One Gaussian per model, and how likely each model is."""

    x: Array  # (n, m, 10)
    covariance: Array  # (n, m, 10, 10)
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
    extent_sigma: float = 0.2
    """Standard deviation of ln extent: what is no ball looks larger or smaller from elsewhere."""
    size_walk: float = 0.05
    """Standard deviation by which ln radius changes in a second, as what is no ball turns."""

    def __post_init__(self) -> None:
        for name in (
            "speed_sigma_mps", "manoeuvre", "accel_sigma_mps2", "accel_time_s", "stay_s",
            "extent_sigma", "size_walk",
        ):  # fmt: skip
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")

    @property
    def _used(self) -> slice:
        return {"velocity": slice(0, 1), "acceleration": slice(1, 2), "both": slice(0, 2)}[
            self.models
        ]

    def start(
        self, pr: Array, covariance: Array, rng: np.random.Generator,
        velocity: tuple[Array, Array] | None = None,
    ) -> KalmanBelief:  # fmt: skip
        """See `MotionFilter.start`."""
        n, m = len(pr), self._used.stop - self._used.start
        x = np.zeros((n, m, 10))
        x[..., PR] = pr[:, None]
        cov = np.zeros((n, m, 10, 10))
        for i in range(4):
            cov[..., PR[i], PR] = covariance[:, None, i]
        cov[..., V, V] = self.speed_sigma_mps**2 * np.eye(3)
        if velocity is not None:
            x[..., V], cov[..., V, V] = velocity[0][:, None], velocity[1][:, None]
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
        """See `MotionFilter.update`: extended Kalman update, model by model."""
        x, cov, weight = (a.copy() for a in belief)
        log_likelihood = np.empty_like(weight)
        update_all(x, cov, log_likelihood, *measured(z), *extents(z, self.extent_sigma))
        log_weight = np.log(weight) + log_likelihood
        likely = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
        weight = np.maximum(likely / likely.sum(axis=1, keepdims=True), 1e-9)
        return KalmanBelief(x, cov, weight / weight.sum(axis=1, keepdims=True))

    def hold_size(
        self, belief: Belief, z: Polar, size: tuple[float, float],
        rng: np.random.Generator | None = None,
    ) -> KalmanBelief:  # fmt: skip
        """See `MotionFilter.hold_size`.

        With s = exp(mean - x_9): p' = p_C + s (p - p_C), v' = v_C + s (v - v_C), a' = s a; the
        covariance is moved by the Jacobian, and the size's variance added along (p' - p_C,
        v' - v_C, a', 1).

        Source: An extended Kalman filter on bearings alone believes to learn the distance long
            before it does (Aidala, "Kalman filter behavior in bearings-only tracking
            applications", 1979).
        """
        x, cov, weight = belief
        mean, sigma = size
        origin = np.zeros((len(x), 1, 10))
        origin[:, 0, P] = z.p_WC + z.age_s[:, None] * z.v_WC
        origin[:, 0, V] = z.v_WC
        s = np.exp(mean - x[..., SIZE])[..., None]
        along = s * (x - origin)
        moved = origin + along
        moved[..., SIZE], along[..., SIZE] = mean, 1.0
        J = s[..., None] * np.eye(10)
        J[..., :9, SIZE] = -along[..., :9]
        J[..., SIZE, :] = 0.0
        held = J @ cov @ np.swapaxes(J, -1, -2)
        held += sigma**2 * along[..., :, None] * along[..., None, :]
        return KalmanBelief(moved, held, weight)

    def moments(self, belief: Belief) -> Moments:
        """See `MotionFilter.moments`."""
        x, cov, weight = belief
        w = weight[..., None]
        mean = np.sum(w * x, axis=1)
        off = x - mean[:, None]
        second = np.sum(w[..., None] * (cov[..., PV, PV] + off[..., PV, None] * off[..., None, PV]),
                        axis=1)  # fmt: skip
        of_size = np.sum(weight * (cov[..., SIZE, SIZE] + off[..., SIZE] ** 2), axis=1)
        return Moments(mean[:, P], mean[:, V], second, mean[:, SIZE], of_size)

    def spread(self, belief: Belief, dt_s: float) -> Array:
        """See `MotionFilter.spread`."""
        now, then = self.moments(belief), self.predict(belief, dt_s)
        off = then.x[..., P] - (now.p_WO + dt_s * now.v_WO)[:, None]
        second = then.covariance[..., P, P] + off[..., :, None] * off[..., None, :]
        total: Array = np.sum(then.weight[..., None, None] * second, axis=1)
        return total

    def transition(self, dt_s: float) -> tuple[Array, Array]:
        """F and Q of both models, (2, 10, 10)."""
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
        moved, noise = np.zeros((2, 10, 10)), np.zeros((2, 10, 10))
        moved[:, :9, :9], noise[:, :9, :9] = np.kron(F, eye), np.kron(Q, eye)
        moved[:, SIZE, SIZE], noise[:, SIZE, SIZE] = 1.0, self.size_walk**2 * t
        return moved, noise

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
        off = belief.x[:, :, None] - x[:, None]  # (n, from, to, 10)
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
