# SPDX-License-Identifier: Apache-2.0
"""Points of a path -> speed along it -> control points of the reference."""

import math
from typing import NamedTuple

import numpy as np

from skyhaul.jit import njit
from skyhaul.planning.path import curvatures
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"

LATERAL_SHARE = 0.8
"""Share of the acceleration that a corner may take."""
CREEP_MPS = 0.02
"""No corner is taken slower than this [m/s]."""


class Drive(NamedTuple):
    """How fast a path is flown, and where the load rests on the way."""

    speed: float  # [m/s]
    accel: float  # [m/s^2]
    brake: float  # acceleration along the first leg, up to `brake_until` [m/s^2]
    brake_until: float  # [m]
    rest_at: float  # the load rests at this distance along the path [m]; < 0: nowhere
    rest_s: float  # for so long [s]
    end_at: float  # the path ends after this distance [m]


class Run(NamedTuple):
    """A path in time."""

    points: Array  # (k, 3) [m]
    way: Array  # (k,) distance from the first point [m]
    speed: Array  # (k,) [m/s]
    time: Array  # (k,) when it gets there [s]
    rest_index: int  # where it rests; -1: nowhere
    rest_s: float  # [s]
    feasible: bool  # whether the speed it has at first is not too high for what follows


@njit
def run_along(points: Array, speed_0: float, drive: Drive) -> Run:
    """Fastest speeds along a path: limits on speed and on acceleration along and across.

    Forward-backward pass over v^2: a_along^2 + (curvature v^2)^2 <= accel^2.

    Args:
        points: Path, (k, 3) [m].
        speed_0: Speed at the first point [m/s].
        drive: Limits, rests.
    """
    points, way, rest = _with_rest(points, drive)
    n = len(points)
    bend = curvatures(points)
    v2 = np.empty(n)
    start = speed_0 * speed_0
    for i in range(n):
        slowing = start - 1.8 * _accel(drive, way[i]) * way[i]  # from a speed above the limit
        v2[i] = max(drive.speed * drive.speed, slowing)
        if bend[i] > 1e-9:
            v2[i] = min(v2[i], max(LATERAL_SHARE * _accel(drive, way[i]) / bend[i], CREEP_MPS**2))
    v2[n - 1] = 0.0
    if rest >= 0:
        v2[rest] = 0.0
    if rest == 0:
        v2[0] = 0.0
    for i in range(n - 2, -1, -1):
        v2[i] = min(v2[i], _reachable(v2[i + 1], way[i + 1] - way[i], bend[i + 1], drive, way[i]))
    feasible = start <= v2[0] * 1.02 + 1e-4
    v2[0] = min(start, v2[0])
    for i in range(n - 1):
        v2[i + 1] = min(v2[i + 1], _reachable(v2[i], way[i + 1] - way[i], bend[i], drive, way[i]))
    speed, time = np.sqrt(v2), np.zeros(n)
    for i in range(n - 1):
        pause = drive.rest_s if i == rest else 0.0
        both = max(speed[i] + speed[i + 1], 1e-6)
        time[i + 1] = time[i] + pause + 2.0 * (way[i + 1] - way[i]) / both
    return Run(points, way, speed, time, rest, drive.rest_s if rest >= 0 else 0.0, feasible)


@njit
def _accel(drive: Drive, way: float) -> float:
    """Acceleration allowed at a distance along the path."""
    return max(drive.brake, drive.accel) if way < drive.brake_until else drive.accel


@njit
def _reachable(v2: float, step: float, bend: float, drive: Drive, way: float) -> float:
    """Square of the speed that can be had a step away."""
    a = _accel(drive, way)
    across = min(bend * v2, a)
    return v2 + 2.0 * step * max(math.sqrt(a * a - across * across), 0.1 * a)


@njit
def _with_rest(points: Array, drive: Drive) -> tuple[Array, Array, int]:
    """The path cut at `end_at`, with a point where it rests: points, ways, index of the rest."""
    n = len(points)
    out, way = np.empty((n + 2, 3)), np.zeros(n + 2)
    out[0] = points[0]
    k, rest, done = 1, -1, 0.0
    if drive.rest_at == 0.0:
        rest = 0
    for i in range(1, n):
        step = 0.0
        for c in range(3):
            step += (points[i, c] - points[i - 1, c]) ** 2
        step = math.sqrt(step)
        if step < 1e-9:
            continue
        for at in (drive.rest_at, drive.end_at):
            if done < at <= done + step and at > 0.0:
                for c in range(3):
                    share = (at - done) / step
                    out[k, c] = points[i - 1, c] + share * (points[i, c] - points[i - 1, c])
                way[k] = at
                if at == drive.rest_at:
                    rest = k
                k += 1
                if at == drive.end_at:
                    return out[:k], way[:k], rest
        done += step
        if way[k - 1] < done - 1e-9:
            out[k], way[k] = points[i], done
            k += 1
    out[k - 1] = points[n - 1]
    return out[:k], way[:k], rest


@njit
def control_points(first: Array, run: Run, dt: float) -> Array:
    """Control points of the spline: given ones, then the run at even times, then rest.

    Args:
        first: Those given, (f, 4), f = 7 or 8; the run begins at the last of them.
        run: Path in time.
        dt: Knot spacing [s].

    Returns:
        (m, 4); yaw goes on turning at its last rate, which halves with every control point.
    """
    n = len(run.points)
    total = run.time[n - 1]
    steps = math.ceil(total / dt - 1e-9)
    given = len(first)
    out = np.empty((given + steps + 7, 4))
    out[:given] = first
    i = 0
    for q in range(1, steps + 8):
        t = min(q * dt, total)
        while i < n - 2 and run.time[i + 1] < t:
            i += 1
        _place(run, i, t, out[given - 1 + q])
    turn = first[given - 1, 3] - first[given - 2, 3]
    for q in range(steps + 7):
        turn *= 0.5
        out[given + q, 3] = out[given + q - 1, 3] + (turn if q < steps else 0.0)
    return out


@njit
def _place(run: Run, i: int, t: float, out: Array) -> None:
    """Where the run is at time t, between its points i and i + 1."""
    if len(run.points) < 2:
        out[:3] = run.points[0]
        return
    begin = run.time[i] + (run.rest_s if i == run.rest_index else 0.0)
    span, step = run.time[i + 1] - begin, run.way[i + 1] - run.way[i]
    tau = min(max(t - begin, 0.0), span)
    share = 1.0
    if span > 0.0 and tau < span:
        a = (run.speed[i + 1] - run.speed[i]) / span
        share = min((run.speed[i] * tau + 0.5 * a * tau * tau) / step, 1.0)
    for c in range(3):
        out[c] = run.points[i, c] + share * (run.points[i + 1, c] - run.points[i, c])
