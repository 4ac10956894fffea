# SPDX-License-Identifier: Apache-2.0
"""What is followed at every step between two rows: extremes and integrals."""

from typing import NamedTuple

import numpy as np

from skyhaul.jit import njit
from skyhaul.types import Array, Mask

CLEARANCE, DISTANCE, ENERGY, SLACK = 0, 1, 2, 3
"""Entries of `Extremes.team`."""


class Extremes(NamedTuple):
    """Running values; `follow` changes them in place."""

    team: Array  # (4,) least clearance [m], least vehicle distance [m], energy [J], slack [s]
    tension_min: Array  # (n,) [N]; inf where no cable carries
    tension_max: Array  # (n,) [N]; -inf where no cable carries
    thrust_max: Array  # (n,) [N]; -inf where the vehicle is dead


def start(n: int) -> Extremes:
    """Values before the first step."""
    inf = np.inf
    team = np.array([inf, inf, 0.0, 0.0])
    return Extremes(team, np.full(n, inf), np.full(n, -inf), np.full(n, -inf))


def restart(e: Extremes, keep_clearance: bool) -> None:
    """Begin a new row; energy and slack time run on."""
    if not keep_clearance:
        e.team[CLEARANCE] = np.inf
    e.team[DISTANCE] = np.inf
    e.tension_min.fill(np.inf)
    e.tension_max.fill(-np.inf)
    e.thrust_max.fill(-np.inf)


@njit
def follow(
    e: Extremes,
    clearance: float,
    p_WB: Array,
    rotor: Array,
    tension: Array,
    attached: Mask,
    alive: Mask,
    power_factor: float,
    slack_dt: float,
) -> None:
    """Take one step into the running values.

    Args:
        e: Running values.
        clearance: Of the team to all obstacles [m].
        p_WB: Vehicles, (n, 3) [m].
        rotor: Rotor thrusts, (n, 4) [N].
        tension: (n,) [N].
        attached: Cables that join vehicle and load, (n,).
        alive: Vehicles whose rotors turn, (n,).
        power_factor: Energy over T^1.5 in one step [J/N^1.5].
        slack_dt: Step length that counts as slack when a carrying cable is [s].
    """
    n = len(tension)
    e.team[0] = min(e.team[0], clearance)
    slack = False
    for i in range(n):
        total = 0.0
        for r in range(4):
            thrust = max(rotor[i, r], 0.0)
            total += thrust
            e.team[2] += power_factor * thrust * np.sqrt(thrust)
        if not alive[i]:
            continue
        e.thrust_max[i] = max(e.thrust_max[i], total)
        if not attached[i]:
            continue
        e.tension_min[i] = min(e.tension_min[i], tension[i])
        e.tension_max[i] = max(e.tension_max[i], tension[i])
        slack = slack or tension[i] <= 0.0
        for j in range(i):
            if alive[j] and attached[j]:
                x = p_WB[i, 0] - p_WB[j, 0]
                y = p_WB[i, 1] - p_WB[j, 1]
                z = p_WB[i, 2] - p_WB[j, 2]
                e.team[1] = min(e.team[1], np.sqrt(x * x + y * y + z * z))
    if slack:
        e.team[3] += slack_dt
