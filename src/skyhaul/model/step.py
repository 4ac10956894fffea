# SPDX-License-Identifier: Apache-2.0
"""One step of the taut team: an extrapolation integrator that picks order and sub-steps itself."""

import math

import numpy as np

from skyhaul.errors import SkyhaulError
from skyhaul.jit import njit
from skyhaul.model.dynamics import (
    AnyTeam,
    TautWork,
    arrays_of,
    pack,
    taut_derivative,
    taut_work,
    unpack,
)
from skyhaul.model.state import TautState
from skyhaul.model.team import TeamArrays
from skyhaul.types import Array

TOLERANCE = 1e-10
"""Largest estimated error of a sub-step, per entry, relative to max(1, |entry|)."""
_COLUMNS = 6  # of the extrapolation table: order 12
_SMALLEST_S = 1e-9  # sub-step below which we give up [s]


def step(team: AnyTeam, state: TautState, wrenches: Array, dt: float) -> TautState:
    """State of the team dt later, thrusts and body moments held.

    Every entry is exact to about `TOLERANCE`. Cables stay taut: where `tensions` is negative, the
    model pushes as a rod would; ask `slack_cables` before trusting it.

    Args:
        team: The team.
        state: State now.
        wrenches: Thrust along z_B and body moment of every vehicle, (n, 4) [N, N m].
        dt: Time to advance [s], > 0.

    Raises:
        SkyhaulError: when dt, the wrenches or the state are malformed, or the motion is too fast
            for sub-steps of 1 ns.

    Source: Paper eqs. (1)-(2); Hairer, Norsett, Wanner, "Solving ODEs I", II.9 (Gragg's
        extrapolated midpoint rule).
    """
    arrays, x = arrays_of(team), pack(state)
    u = np.array(wrenches, dtype=np.float64)
    _check_inputs(arrays, x, u, dt)
    if not integrate(arrays, x, u, float(dt), TOLERANCE):
        raise SkyhaulError(
            f"step cannot follow this motion over dt = {dt} s: it needs sub-steps below 1 ns; "
            "check the rates, forces and moments"
        )
    return unpack(x)


def _check_inputs(team: TeamArrays, x: Array, wrenches: Array, dt: float) -> None:
    n = len(team.m_B)
    if len(x) != 13 + 13 * n or wrenches.shape != (n, 4):
        raise SkyhaulError(
            f"step needs {n} cables and wrenches of shape ({n}, 4) for this team, got "
            f"{(len(x) - 13) // 13} and {wrenches.shape}"
        )
    if not (0.0 < dt < math.inf and np.isfinite(x).all() and np.isfinite(wrenches).all()):
        raise SkyhaulError(f"step needs dt > 0 and finite numbers, got dt = {dt}")


@njit
def integrate(team: TeamArrays, x: Array, wrenches: Array, dt: float, tolerance: float) -> bool:
    """Advance the packed state x in place; False when the sub-steps became too small."""
    table = np.empty((_COLUMNS, x.shape[0]))
    scratch = np.empty((4, x.shape[0]))
    work = taut_work(team.m_B.shape[0])
    done, h = 0.0, dt
    while done < dt:
        h = min(h, dt - done)
        columns = _extrapolate(team, x, wrenches, h, tolerance, work, table, scratch)
        if columns == 0:
            h *= 0.5
            if h < _SMALLEST_S:
                return False
            continue
        x[:] = table[columns - 1]
        project(x, team.m_B.shape[0])
        done = dt if dt - done <= h * (1.0 + 1e-12) else done + h
        if columns < _COLUMNS - 1:
            h *= 2.0
    return True


@njit
def _extrapolate(
    team: TeamArrays,
    x: Array,
    wrenches: Array,
    h: float,
    tolerance: float,
    work: TautWork,
    table: Array,
    scratch: Array,
) -> int:
    """Columns that the extrapolation needs over h, 0 when it does not converge.

    Row j of the table holds the midpoint rule with 2 (j + 1) sub-steps, then, by Aitken and
    Neville, its extrapolation through all rows up to j.
    """
    slope = scratch[2]
    taut_derivative(team, x, wrenches, work, slope)
    for j in range(_COLUMNS):
        _midpoint(team, x, wrenches, h, 2 * (j + 1), work, scratch)
        converged = True
        for s in range(x.shape[0]):
            value, change = scratch[1, s], math.inf
            for k in range(j):
                above, table[k, s] = table[k, s], value
                ratio = (j + 1.0) / (j - k)
                change = (value - above) / (ratio * ratio - 1.0)
                value += change
            table[j, s] = value
            if not abs(change) <= tolerance * max(1.0, abs(value)):  # also where it is nan
                converged = False
        if converged:
            return j + 1
    return 0


@njit
def _midpoint(
    team: TeamArrays,
    x: Array,
    wrenches: Array,
    h: float,
    count: int,
    work: TautWork,
    scratch: Array,
) -> None:
    """Gragg's midpoint rule over h in `count` sub-steps; from x, ends in `scratch[1]`.

    `scratch[2]` holds the derivative at x; rows 0, 1 and 3 are used.
    """
    before, now, slope = scratch[0], scratch[1], scratch[3]
    d = h / count
    for s in range(x.shape[0]):
        before[s] = x[s]
        now[s] = x[s] + d * scratch[2, s]
    for _ in range(count - 1):
        taut_derivative(team, now, wrenches, work, slope)
        for s in range(x.shape[0]):
            before[s], now[s] = now[s], before[s] + 2.0 * d * slope[s]


@njit
def project(x: Array, n: int) -> None:
    """Remove rounding from what must hold: unit quaternions and directions, cable rates normal."""
    _normalize(x, 3, 4)
    for i in range(n):
        k, o = 13 + 3 * i, 13 + 3 * n + 3 * i
        _normalize(x, k, 3)
        _normalize(x, 13 + 6 * n + 4 * i, 4)
        along = x[k] * x[o] + x[k + 1] * x[o + 1] + x[k + 2] * x[o + 2]
        for c in range(3):
            x[o + c] -= along * x[k + c]


@njit
def _normalize(x: Array, start: int, size: int) -> None:
    square = 0.0
    for c in range(start, start + size):
        square += x[c] * x[c]
    scale = 1.0 / math.sqrt(square)
    for c in range(start, start + size):
        x[c] *= scale
