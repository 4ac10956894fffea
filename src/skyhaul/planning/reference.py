# SPDX-License-Identifier: Apache-2.0
"""The default reference: a septic spline in position and yaw, and blends of tilt."""

from dataclasses import dataclass, field, replace
from math import comb
from typing import NamedTuple, TypeVar

import numpy as np

from skyhaul.errors import GeometryError
from skyhaul.geometry.so3 import so3_exp, so3_log
from skyhaul.jit import njit
from skyhaul.planning.api import Reference, RefSample, Times
from skyhaul.planning.bspline import (
    BASIS,
    LEAD,
    ORDER,
    control_from_derivatives,
    evaluate,
    largest_derivatives,
)
from skyhaul.types import US_PER_S, Array, TimeUs, frozen
from skyhaul.world.scenario import Limits

_BINOMIAL = np.array([[comb(n, k) for k in range(7)] for n in range(7)], dtype=np.float64)
SMOOTH_RISE = np.array([(-1) ** k * comb(6, k) * 12012 / (7 + k) for k in range(7)])
"""x^7 sum_k c_k x^k rises from 0 to 1 with six zero derivatives at both ends."""


@dataclass(frozen=True, eq=False)
class TiltBlend:
    """A turn by exp(hat(phi) s(t)), s rising smoothly from 0 to 1 (degree 13, C6)."""

    start_us: TimeUs
    duration_us: TimeUs
    phi: Array  # (3,) [rad]

    def __post_init__(self) -> None:
        frozen(self.phi)
        if not self.duration_us > 0:
            raise ValueError(f"duration_us must be > 0, got {self.duration_us}")


@dataclass(frozen=True, eq=False)
class Tilted:
    """A reference that can turn the load on its way: R_WD = Rz(yaw) exp(phi_1 s_1) .."""

    tilts: tuple[TiltBlend, ...] = field(default=(), kw_only=True)


@dataclass(frozen=True, eq=False)
class SplineReference(Tilted):
    """R_WD = Rz(yaw) exp(phi_1 s_1) exp(phi_2 s_2) ..; position and yaw are one septic spline.

    Every derivative 0..6 is continuous for all times; at rest before the start and after the end.
    """

    start_us: TimeUs
    dt_us: TimeUs  # knot spacing
    control: Array  # (m, 4) control points x, y, z [m], yaw [rad]; the last 8 are equal

    def __post_init__(self) -> None:
        frozen(self.control)
        if self.control.ndim != 2 or self.control.shape[1] != 4 or len(self.control) < ORDER:
            raise GeometryError(
                f"control points must be (m >= {ORDER}, 4), got {self.control.shape}"
            )

    @property
    def end_us(self) -> TimeUs:
        """When it ends, at rest."""
        return self.start_us + (len(self.control) - ORDER + 1) * self.dt_us

    @property
    def dt_s(self) -> float:
        """Knot spacing [s]."""
        return self.dt_us / US_PER_S

    def sample(self, t_us: Times) -> RefSample:
        """See `Reference.sample`."""
        t = np.atleast_1d(np.asarray(t_us, dtype=np.float64))
        time = (t - self.start_us) / US_PER_S
        p, R = _sample(self.control, self.dt_s, time, BASIS, _BINOMIAL)
        tilt(self, self.start_us, time, R)
        return RefSample(p_WD=p, R_WD=R)

    def derivatives(self, t_us: TimeUs) -> Array:
        """Derivatives 0..6 of x, y, z and yaw at one time, (7, 4)."""
        out = np.empty((7, 4))
        evaluate(self.control, self.dt_s, (t_us - self.start_us) / US_PER_S, out, BASIS)
        return out

    def max_speed_mps(self) -> float:
        """Largest speed [m/s]."""
        return self._largest(1)

    def max_acceleration_mps2(self) -> float:
        """Largest acceleration [m/s^2]."""
        return self._largest(2)

    def max_jerk_mps3(self) -> float:
        """Largest jerk [m/s^3]."""
        return self._largest(3)

    def max_snap_mps4(self) -> float:
        """Largest snap [m/s^4]; vehicles above the load feel l/g times as much acceleration."""
        return self._largest(4)

    def _largest(self, k: int) -> float:
        return float(largest_derivatives(self.control, self.dt_s, BASIS, 12)[k])


def resting_reference(
    p_WD: Array, yaw_rad: float, start_us: TimeUs, dt_us: TimeUs = 300_000
) -> SplineReference:
    """Hold still at a place."""
    return SplineReference(start_us, dt_us, np.tile(np.append(p_WD, yaw_rad), (ORDER, 1)))


T = TypeVar("T", bound=Tilted)


class Continuation(NamedTuple):
    """The beginning of a spline that goes on from another reference."""

    start_us: TimeUs  # its first knot, not after the time asked for
    first: Array  # (7 or 8, 4) its first control points; the rest is free

    def free_after_s(self, t_us: TimeUs, dt_s: float) -> float:
        """How long after a time the last fixed control point acts [s]."""
        return (self.start_us - t_us) / US_PER_S + (len(self.first) - 1 - LEAD) * dt_s


def continuation(current: Reference, t_us: TimeUs, dt_us: TimeUs) -> Continuation:
    """Go on from a reference at a time, keeping derivatives 0..6 of position and yaw.

    A spline with the same knot spacing lends its own control points, eight unless t is a knot:
    so nothing grows however often one replans. Otherwise seven come from the derivatives at t:
    with knots at most 2/3 as far apart as before they stick out of the old ones by a tenth at
    most; with knots farther apart the motion must be nearly even.
    """
    own = current if isinstance(current, SplineReference) else None
    if own is not None and own.dt_us == dt_us and own.start_us <= t_us < own.end_us:
        piece, into = divmod(t_us - own.start_us, dt_us)
        count = ORDER - 1 if into == 0 else ORDER
        return Continuation(t_us - into, own.control[piece : piece + count])
    return Continuation(
        t_us, control_from_derivatives(_derivatives(current, t_us), dt_us / US_PER_S)
    )


def _derivatives(current: Reference, t_us: TimeUs) -> Array:
    """Derivatives 0..6 of x, y, z, yaw, (7, 4); of yaw only 0 and 1 for other kinds."""
    if isinstance(current, SplineReference):
        return current.derivatives(t_us)
    s = untilted(current).sample(np.array([t_us], dtype=np.int64))
    d = np.zeros((7, 4))
    d[:, :3] = s.p_WD[0]
    R, dR = s.R_WD[0, 0], s.R_WD[0, 1]
    d[0, 3] = np.arctan2(R[1, 0], R[0, 0])
    d[1, 3] = (R[0, 0] * dR[1, 0] - R[1, 0] * dR[0, 0]) / (R[0, 0] ** 2 + R[1, 0] ** 2)
    return d


def tilts_of(current: Reference) -> tuple[TiltBlend, ...]:
    """The blends of tilt that a continuation must carry on."""
    return current.tilts if isinstance(current, Tilted) else ()


def untilted(current: Reference) -> Reference:
    """The same motion without its blends of tilt: its attitude is the yaw alone."""
    return replace(current, tilts=()) if isinstance(current, Tilted) else current


def with_tilt(current: T, t_us: TimeUs, R_tilt: Array, duration_us: TimeUs) -> T:
    """The same motion, its attitude turned smoothly to Rz(yaw) R_tilt, from t on.

    Args:
        current: Its earlier blends go on; they may still be in progress.
        t_us: When the turn begins [us].
        R_tilt: Attitude aimed at, apart from yaw, (3, 3).
        duration_us: How long the turn takes [us].
    """
    R = np.eye(3)
    for b in current.tilts:
        R = R @ so3_exp(b.phi)
    blend = TiltBlend(t_us, duration_us, so3_log(R.T @ R_tilt))
    return replace(current, tilts=(*current.tilts, blend))


def stop_reference(
    current: Reference, t_us: TimeUs, limits: Limits, dt_us: TimeUs = 150_000
) -> SplineReference:
    """Come to rest from a reference at t, straight on, as fast as `a_brake_mps2` allows.

    Derivatives 0..6 are kept at t. The knot spacing bounds jerk and snap: braking sets in about
    three knots after t.
    """
    dt = dt_us / US_PER_S
    start_us, first = continuation(current, t_us, dt_us)
    step = first[-1] - first[-2]
    speed = float(np.linalg.norm(step[:3])) / dt
    stop_s = speed / limits.a_brake_mps2
    rows = [first]
    if speed > 1e-9:
        k = np.arange(1, int(np.ceil(stop_s / dt)) + 1)
        t = np.minimum(k * dt, stop_s)
        way = (t - 0.5 * t * t / stop_s) / dt  # in steps of the last knot
        rows.append(first[-1] + way[:, None] * step)
    control = np.concatenate(rows)
    control = np.concatenate([control, np.repeat(control[-1:], ORDER - 1, 0)])
    return SplineReference(start_us, dt_us, control, tilts=tilts_of(current))


def restart_reference(
    p_WL: Array, v_WL: Array, yaw_rad: float, t_us: TimeUs, limits: Limits, dt_us: TimeUs = 200_000
) -> SplineReference:
    """From a measured place and velocity to rest: what to plan on from when the load strayed."""
    d = np.zeros((7, 4))
    d[0], d[1, :3] = np.append(p_WL, yaw_rad), v_WL
    first = control_from_derivatives(d, dt_us / US_PER_S)
    even = np.concatenate([first, first[-1] + np.arange(1, 9)[:, None] * (first[-1] - first[-2])])
    return stop_reference(SplineReference(t_us, dt_us, even), t_us, limits, dt_us)


def remaining_time(reference: Reference, t_us: TimeUs) -> float:
    """How long a reference still takes [s]."""
    return max(0.0, (reference.end_us - t_us) / US_PER_S)


def tilt(reference: Tilted, start_us: TimeUs, time: Array, R: Array) -> None:
    """Turn attitudes by the blends of a reference, in place.

    Args:
        reference: Gives the blends.
        start_us: Zero of the times [us].
        time: (k,) [s].
        R: Derivatives 0..6 of the attitude without them, (k, 7, 3, 3).
    """
    blends = np.empty((len(reference.tilts), 5))
    for row, b in zip(blends, reference.tilts, strict=True):
        row[0], row[1] = b.start_us - start_us, b.duration_us
        row[:2] /= US_PER_S
        row[2:] = b.phi
    _tilt(time, blends, _BINOMIAL, SMOOTH_RISE, R)


@njit
def _sample(
    control: Array, dt: float, time: Array, basis: Array, binomial: Array
) -> tuple[Array, Array]:
    """Kernel of `SplineReference.sample`, without the blends of tilt."""
    n = len(time)
    p, R = np.empty((n, 7, 3)), np.zeros((n, 7, 3, 3))
    d, s = np.empty((7, 4)), np.empty(7)
    axis = np.array([0.0, 0.0, 1.0])
    for q in range(n):
        evaluate(control, dt, time[q], d, basis)
        for k in range(7):
            s[k] = d[k, 3]
            for c in range(3):
                p[q, k, c] = d[k, c]
        _turn(axis, s, binomial, R[q])
    return p, R


@njit
def _tilt(time: Array, blends: Array, binomial: Array, smooth: Array, R: Array) -> None:
    """Kernel of `tilt`; a row of blends is start [s], duration [s] and phi [rad]."""
    s, turn, product = np.empty(7), np.empty((7, 3, 3)), np.empty((7, 3, 3))
    for q in range(len(time)):
        for b in range(len(blends)):
            _smooth_rise((time[q] - blends[b, 0]) / blends[b, 1], blends[b, 1], smooth, s)
            _turn(blends[b, 2:], s, binomial, turn)
            _leibniz(R[q], turn, binomial, product)
            R[q] = product


@njit
def _turn(phi: Array, s: Array, binomial: Array, out: Array) -> None:
    """Derivatives 0..6 of exp(hat(phi) s(t)), (7, 3, 3), from those of s, (7,).

    exp = I + sin(a) K + (1 - cos(a)) K^2, a = |phi| s; sine and cosine by
    c' = -s a', s' = c a' and Leibniz' rule.
    """
    angle = np.sqrt(phi[0] ** 2 + phi[1] ** 2 + phi[2] ** 2)
    ux, uy, uz = 0.0, 0.0, 1.0
    if angle > 0.0:
        ux, uy, uz = phi[0] / angle, phi[1] / angle, phi[2] / angle
    sine, cosine = np.zeros(7), np.zeros(7)
    sine[0], cosine[0] = np.sin(angle * s[0]), np.cos(angle * s[0])
    for n in range(6):
        for k in range(n + 1):
            rate = binomial[n, k] * angle * s[n + 1 - k]
            sine[n + 1] += rate * cosine[k]
            cosine[n + 1] -= rate * sine[k]
    for n in range(7):
        a, b = sine[n], (1.0 - cosine[n] if n == 0 else -cosine[n])
        unit = 1.0 if n == 0 else 0.0
        out[n, 0, 0] = unit + b * (ux * ux - 1.0)
        out[n, 1, 1] = unit + b * (uy * uy - 1.0)
        out[n, 2, 2] = unit + b * (uz * uz - 1.0)
        out[n, 0, 1], out[n, 1, 0] = b * ux * uy - a * uz, b * ux * uy + a * uz
        out[n, 0, 2], out[n, 2, 0] = b * ux * uz + a * uy, b * ux * uz - a * uy
        out[n, 1, 2], out[n, 2, 1] = b * uy * uz - a * ux, b * uy * uz + a * ux


@njit
def _smooth_rise(x: float, duration: float, smooth: Array, out: Array) -> None:
    """Derivatives 0..6 by time of a rise from 0 to 1 while x goes from 0 to 1, (7,)."""
    out[:] = 0.0
    if x >= 1.0:
        out[0] = 1.0
    if x <= 0.0 or x >= 1.0:
        return
    for c in range(6, -1, -1):  # Horner for all derivatives at once
        for k in range(6, 0, -1):
            out[k] = out[k] * x + out[k - 1]
        out[0] = out[0] * x + smooth[c]
    for _ in range(7):
        for k in range(6, 0, -1):
            out[k] = out[k] * x + out[k - 1]
        out[0] = out[0] * x
    scale = 1.0
    for k in range(1, 7):
        scale *= k / duration
        out[k] *= scale


@njit
def _leibniz(a: Array, b: Array, binomial: Array, out: Array) -> None:
    """Derivatives 0..6 of the product of two matrices, (7, 3, 3)."""
    for n in range(7):
        for r in range(3):
            for c in range(3):
                total = 0.0
                for k in range(n + 1):
                    w = binomial[n, k]
                    for e in range(3):
                        total += w * a[k, r, e] * b[n - k, e, c]
                out[n, r, c] = total
