# SPDX-License-Identifier: Apache-2.0
"""One tick of the team's filter: move on, correct, read out."""

from typing import NamedTuple

from skyhaul.geometry.kernels import mat_t_vec, quat_inv_rotate
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
from skyhaul.perception.team.false_samples import believed
from skyhaul.perception.team.layout import KEPT, FilterParams, FilterState, copied
from skyhaul.perception.team.motion import (
    advance_load,
    advance_vehicle,
    latest,
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
_LATE_US = 8_000.0
"""A vehicle's IMU is silent when no sample has come for this long [us]."""
_BRIDGE_S = 0.3
"""How long a vehicle is moved on without samples [s]."""
_FADE = 0.95
"""What is left of a rate after a period without a sample."""
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
        i = int(row[0])
        _bridge(p, s, i, row[1] - 1e6 * p.dt[0], 0.0)
        if row[1] > latest(s, i) and _believed_of_vehicle(p, s, i, row[1:]):
            advance_vehicle(p, s, i, row[1], three(row, 2), three(row, 5))
            s.made_up[i] = 0.0
    for i in range(n):
        _bridge(p, s, i, t_us - _LATE_US, thrust[i] - before.nav_last[i, 11])
    for k in range(new.odometry.shape[0]):
        row = new.odometry[k]
        take_odometry(p, s, int(row[0]), row[1], row[2:18], row[18:].reshape(6, 6))
    load = load_at(p, s, t_us)
    for k in range(new.samples.shape[0]):
        gather(p, s, load, int(new.samples[k, 0]))
    for k in range(new.load.shape[0]):
        row = new.load[k]
        if row[0] > s.load_us[0] and _believed_of_load(s, row):
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
def _believed_of_vehicle(p: FilterParams, s: FilterState, i: int, sample: Array) -> bool:
    """Whether a sample of vehicle i, (7,), is believed; the first one is."""
    if s.head[i] == 0.0:
        return True
    last = s.past[i, int(s.head[i] - 1.0) % KEPT]
    dt = 1e-6 * (sample[0] - last[0]) + s.made_up[i] * p.dt[0]
    return believed(last[1:], s.waiting[i], sample, dt)


@njit
def _believed_of_load(s: FilterState, sample: Array) -> bool:
    """The same of the load; its biases are small beside what is asked for."""
    if s.load_us[3] == 0.0:
        return True
    dt = 1e-6 * (sample[0] - s.load_us[0])
    return believed(s.load_last[:6], s.waiting[-1], sample, dt)


@njit
def _bridge(p: FilterParams, s: FilterState, i: int, until_us: float, push: float) -> None:
    """Move vehicle i on to a time without its IMU, for `_BRIDGE_S` at most; then it stands.

    Its rate fades, as it does under attitude control, and the cable pulls on as before: the
    specific force changes with the thrust alone, by `push` / m along the rotors [N].
    """
    dt_us = 1e6 * p.dt[0]
    change = mat_t_vec(p.R_BI, (0.0, 0.0, push / p.mass[i]))
    while (
        s.head[i] > 0.0
        and until_us - latest(s, i) > 0.5 * dt_us
        and s.made_up[i] * p.dt[0] < _BRIDGE_S
    ):
        row, x = s.past[i, int(s.head[i] - 1.0) % KEPT], s.nav[i]
        w = (_FADE * (row[1] - x[10]), _FADE * (row[2] - x[11]), _FADE * (row[3] - x[12]))
        gyro = (w[0] + x[10], w[1] + x[11], w[2] + x[12])
        accel = (row[4] + change[0], row[5] + change[1], row[6] + change[2])
        advance_vehicle(p, s, i, row[0] + dt_us, gyro, accel)
        for c in range(3):
            s.nav_last[i, 3 + c] = 0.0
        s.made_up[i] += 1.0
        change = (0.0, 0.0, 0.0)


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
