# SPDX-License-Identifier: Apache-2.0
"""Planned yaw of the vehicles: fanned out about the motion, so that someone looks everywhere."""

import math
from dataclasses import dataclass

import numpy as np

from skyhaul.params import Params
from skyhaul.planning.api import Reference, Times
from skyhaul.types import US_PER_S, Array, TimeUs, frozen

_CUBIC = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
"""Row k, column j: coefficient of u^k in the weight of control point j of a cubic B-spline."""


@dataclass(frozen=True, kw_only=True)
class Heading(Params):
    """How the vehicles turn."""

    rate_dps: float = 45.0
    """Largest yaw rate [deg/s]."""
    accel_dps2: float = 90.0
    """Largest yaw acceleration [deg/s^2]."""
    slow_mps: float = 0.2
    """Below this horizontal speed of the load the heading holds [m/s]."""
    knot_s: float = 0.2
    """Knot spacing of the planned yaw [s]."""

    def __post_init__(self) -> None:
        for name in ("rate_dps", "accel_dps2", "slow_mps", "knot_s"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class HeadingPlan:
    """Heading of the fan over time, a cubic B-spline whose knots are multiples of `dt_us`.

    Control point j acts around time (first + j) dt; before and after it holds.
    """

    dt_us: TimeUs
    first: int
    control: Array  # (m,) [rad], not wrapped
    offsets: Array  # (n,) of each vehicle from the heading of the fan [rad]

    def __post_init__(self) -> None:
        frozen(self.control, self.offsets)

    def fan(self, t_us: Times) -> Array:
        """Heading of the fan and its first two derivatives, (k, 3) [rad, rad/s, ..]."""
        x = np.atleast_1d(np.asarray(t_us, dtype=np.float64)) / self.dt_us
        knot = np.floor(x)
        u, h = x - knot, self.dt_us / US_PER_S
        j = knot.astype(np.int64)[:, None] - 1 - self.first + np.arange(4)
        c = self.control[np.clip(j, 0, len(self.control) - 1)] @ _CUBIC.T
        value = c[:, 0] + u * (c[:, 1] + u * (c[:, 2] + u * c[:, 3]))
        rate = (c[:, 1] + u * (2.0 * c[:, 2] + u * 3.0 * c[:, 3])) / h
        accel = (2.0 * c[:, 2] + 6.0 * u * c[:, 3]) / (h * h)
        return np.column_stack([value, rate, accel])

    def sample(self, t_us: Times) -> Array:
        """Yaw of every vehicle and its first two derivatives, (k, n, 3)."""
        fan = self.fan(t_us)
        out = np.repeat(fan[:, None], len(self.offsets), axis=1)
        out[:, :, 0] += self.offsets
        return out


def fan_out(
    reference: Reference,
    n: int,
    t_us: TimeUs,
    before: "HeadingPlan | float" = 0.0,
    params: Heading | None = None,
) -> HeadingPlan:
    """Headings along a reference: vehicle i looks 360 i / n deg from the direction of motion.

    The heading follows the horizontal velocity with limited rate and acceleration, and holds
    while the load is slow.

    Args:
        reference: Motion of the load.
        n: Number of vehicles.
        t_us: From when on [us]; what `before` says until two knots later is kept.
        before: The plan in force, or a heading at rest [rad].
        params: Limits; None: the defaults.
    """
    params = params or Heading()
    dt_us = round(US_PER_S * params.knot_s)
    now = t_us // dt_us
    last = max(math.ceil(reference.end_us / dt_us), now) + 8
    if isinstance(before, HeadingPlan) and before.dt_us == dt_us:
        j = np.clip(np.arange(now - 1, now + 3) - before.first, 0, len(before.control) - 1)
        kept = before.control[j]
    else:
        heading = before.fan(np.array([t_us]))[0, 0] if isinstance(before, HeadingPlan) else before
        kept = np.full(4, float(heading))
    knots = np.arange(now + 3, last + 1)
    velocity = reference.sample(knots * dt_us).p_WD[:, 1]
    turned = _follow(kept, velocity, params)
    offsets = 2.0 * math.pi * np.arange(n) / n
    return HeadingPlan(dt_us, int(now - 1), np.concatenate([kept, turned]), offsets)


def _follow(kept: Array, velocity: Array, params: Heading) -> Array:
    """Headings, one a knot, that follow velocities, (k, 3), after the last of those kept."""
    dt = params.knot_s
    top, step = math.radians(params.rate_dps), math.radians(params.accel_dps2) * dt
    heading, rate = float(kept[-1]), float(kept[-1] - kept[-2]) / dt
    out = np.empty(len(velocity))
    for i, v in enumerate(velocity):
        wanted = 0.0
        if math.hypot(v[0], v[1]) > params.slow_mps:
            error = math.remainder(math.atan2(v[1], v[0]) - heading, 2.0 * math.pi)
            # the rate from which one can still come to rest at the wanted heading
            stop = math.sqrt(2.0 * (step / dt) * abs(error))
            wanted = math.copysign(min(top, 0.7 * stop, abs(error) / dt), error)
        rate += min(max(wanted - rate, -step), step)
        heading += rate * dt
        out[i] = heading
    return out
