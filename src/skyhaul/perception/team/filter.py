# SPDX-License-Identifier: Apache-2.0
"""One tick of the team's filter: move on, correct, read out."""

from typing import NamedTuple

from skyhaul.geometry.kernels import quat_inv_rotate
from skyhaul.jit import njit
from skyhaul.perception.team.cables import (
    add_balance,
    correct_at_rest,
    correct_by_balance,
    correct_by_cable,
    force_at_rest,
    force_now,
    gather,
    rest,
    unbiased,
)
from skyhaul.perception.team.layout import FilterParams, FilterState, copied
from skyhaul.perception.team.motion import (
    advance_load,
    advance_vehicle,
    load_at,
    take_odometry,
    three,
)
from skyhaul.perception.team.output import Output, read_out
from skyhaul.perception.team.sights import take_sight
from skyhaul.types import Array, Mask

WINDOW_TICKS = 25
"""Cables and the load's balance correct the state once in so many ticks."""
_STEP_US = 2_000
_LOST_US = 25_000.0
"""The load's IMU is silent when no sample has come for this long [us]."""


class Arrived(NamedTuple):
    """What came in one tick, one row each."""

    samples: Array  # (k, 8) vehicle, time at the end of the period [us], rate, force, I axes
    load: Array  # (k, 7) time at the end of the period [us], rate, force, L axes
    odometry: Array  # (k, 54) vehicle, time [us], pose and motion (16,), covariance (36,)
    sights: Array  # (k, 10) vehicle, time [us], corners [px]


@njit
def tick(
    p: FilterParams, before: FilterState, t_us: float, new: Arrived, thrust: Array, attached: Mask
) -> tuple[FilterState, Output]:
    """One tick of the filter: move on, correct, read out; `before` stays as it is."""
    s = copied(before)
    n = p.mass.shape[0]
    for i in range(n):
        s.nav_last[i, 9] = 0.5 * (thrust[i] + s.nav_last[i, 11]) if s.head[i] > 0 else thrust[i]
        s.nav_last[i, 10], s.nav_last[i, 11] = 1.0 if attached[i] else 0.0, thrust[i]
        if s.head[i] == 0.0:
            force_at_rest(p, s, i)
    for k in range(new.samples.shape[0]):
        row = new.samples[k]
        advance_vehicle(p, s, int(row[0]), row[1], three(row, 2), three(row, 5))
    for k in range(new.odometry.shape[0]):
        row = new.odometry[k]
        take_odometry(p, s, int(row[0]), row[1], row[2:18], row[18:].reshape(6, 6))
    load = load_at(p, s, t_us)
    for k in range(new.samples.shape[0]):
        gather(p, s, load, int(new.samples[k, 0]))
    for k in range(new.load.shape[0]):
        row = new.load[k]
        if row[0] > s.load_us[0]:
            advance_load(p, s, row[0], three(row, 1), three(row, 4), 1.0)
            rest(p, s, p.dt[1])
            add_balance(p, s, attached)
    while t_us - s.load_us[0] > _LOST_US:
        _without_sample(p, s, attached)
    for k in range(new.sights.shape[0]):
        row = new.sights[k]
        if attached[int(row[0])]:
            take_sight(p, s, int(row[0]), row[1], row[2:].reshape(4, 2))
    now = int(t_us) // _STEP_US
    for i in range(n):
        if (now + 2 * i) % WINDOW_TICKS == 0:
            correct_by_cable(p, s, load_at(p, s, t_us), i, attached[i])
    if now % WINDOW_TICKS == 1:
        correct_by_balance(p, s, attached)
        if s.load_us[2] > 0.2:
            correct_at_rest(s)
    return s, read_out(p, s, t_us, attached)


@njit
def _without_sample(p: FilterParams, s: FilterState, attached: Mask) -> None:
    """Move the load on without its IMU: the cables' forces, a rate that fades, much noise."""
    total = (0.0, 0.0, 0.0)
    for i in range(p.mass.shape[0]):
        if attached[i] and s.taut[i, 0] > 0.0:
            F = unbiased(p, s, i, force_now(p, s, i))
            total = (total[0] - F[0], total[1] - F[1], total[2] - F[2])
    f = quat_inv_rotate(s.load[3:7], total)
    x, last, m = s.load, s.load_last, p.load_mass
    gyro = (0.95 * last[0] + x[10], 0.95 * last[1] + x[11], 0.95 * last[2] + x[12])
    accel = (f[0] / m + x[13], f[1] / m + x[14], f[2] / m + x[15])
    advance_load(p, s, s.load_us[0] + 1e6 * p.dt[1], gyro, accel, 100.0)
