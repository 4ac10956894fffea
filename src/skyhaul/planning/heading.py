# SPDX-License-Identifier: Apache-2.0
"""Planned yaw of the vehicles: all look outward, and one of them along the motion."""

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
    sector_margin: float = 0.1
    """A vehicle that looks along the motion does so for this share of a sector longer, before the
    next one takes over."""
    knot_s: float = 0.2
    """Knot spacing of the planned yaw [s]."""

    def __post_init__(self) -> None:
        for name in ("rate_dps", "accel_dps2", "slow_mps", "knot_s"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not self.sector_margin >= 0.0:
            raise ValueError(f"sector_margin must be >= 0, got {self.sector_margin}")


@dataclass(frozen=True, eq=False)
class HeadingPlan:
    """Turn of the fan over time, a cubic B-spline whose knots are multiples of `dt_us`.

    Control point j acts around time (first + j) dt; before and after it holds.
    """

    dt_us: TimeUs
    first: int
    control: Array  # (m,) [rad], not wrapped
    offsets: Array  # (n,) yaw of each vehicle at turn 0: outward along its cable [rad]

    def __post_init__(self) -> None:
        frozen(self.control, self.offsets)

    def fan(self, t_us: Times) -> Array:
        """Turn of the fan and its first two derivatives, (k, 3) [rad, rad/s, ..]."""
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
    azimuths: Array,
    t_us: TimeUs,
    before: "HeadingPlan | float" = 0.0,
    params: Heading | None = None,
) -> HeadingPlan:
    """Headings along a reference: every vehicle looks outward, one of them along the motion.

    Vehicle i looks along its own cable's azimuth, seen from the load, and the whole fan turns with
    the load's yaw. To bring one vehicle's view onto the horizontal motion the fan turns further by
    at most half a sector, 180 / n deg: the load stays behind and below every vehicle. Rate and
    acceleration are limited, and the fan holds while the load is slow.

    Args:
        reference: Motion of the load.
        azimuths: Directions of the cables around the load, L axes, (n,) [rad].
        t_us: From when on [us]; what `before` says until two knots later is kept.
        before: The plan in force, or a turn at rest [rad].
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
        turn = before.fan(np.array([t_us]))[0, 0] if isinstance(before, HeadingPlan) else before
        kept = np.full(4, float(turn))
    sample = reference.sample(np.arange(now + 3, last + 1) * dt_us)
    velocity, R_WD = sample.p_WD[:, 1], sample.R_WD[:, 0]
    yaw = np.unwrap(np.arctan2(R_WD[:, 1, 0], R_WD[:, 0, 0]))
    turned = _follow(kept, velocity, yaw, azimuths, params)
    return HeadingPlan(dt_us, int(now - 1), np.concatenate([kept, turned]), azimuths.copy())


def _follow(kept: Array, velocity: Array, yaw: Array, azimuths: Array, params: Heading) -> Array:
    """Turns of the fan, one a knot, after the last of those kept.

    Args:
        kept: Turns before, (m >= 2) [rad].
        velocity: Of the load at the knots, (k, 3) [m/s].
        yaw: Of the load at the knots, not wrapped, (k,) [rad].
        azimuths: See `fan_out`.
        params: Limits.
    """
    dt = params.knot_s
    top, step = math.radians(params.rate_dps), math.radians(params.accel_dps2) * dt
    turn, rate = float(kept[-1]), float(kept[-1] - kept[-2]) / dt
    out = np.empty(len(velocity))
    for i, v in enumerate(velocity):
        error = _turn_wanted(turn, v, float(yaw[i]), azimuths, params) - turn
        # the rate from which one can still come to rest at the wanted turn
        stop = math.sqrt(2.0 * (step / dt) * abs(error))
        wanted = math.copysign(min(top, 0.7 * stop, abs(error) / dt), error)
        rate += min(max(wanted - rate, -step), step)
        turn += rate * dt
        out[i] = turn
    return out


def _turn_wanted(turn: float, v: Array, yaw: float, azimuths: Array, params: Heading) -> float:
    """The turn nearest to the present one that points a vehicle along v, within half a sector.

    A whole turn of the fan looks the same: `turn` is compared with the load's yaw next to it.
    """
    sector = 2.0 * math.pi / len(azimuths)
    most = (0.5 + params.sector_margin) * sector
    outward = yaw + 2.0 * math.pi * round((turn - yaw) / (2.0 * math.pi))
    if math.hypot(v[0], v[1]) <= params.slow_mps:
        return min(max(turn, outward - most), outward + most)
    motion = math.atan2(v[1], v[0]) - float(azimuths[0])
    near = turn + math.remainder(motion - turn, sector)
    if abs(near - outward) <= most:
        return near
    return outward + math.remainder(motion - outward, sector)
