# SPDX-License-Identifier: Apache-2.0
"""Rotors: limits, first-order lag, failure."""

import math

from skyhaul.jit import njit
from skyhaul.model.team import TeamArrays
from skyhaul.types import Array, Mask


@njit
def rotor_lag(
    team: TeamArrays, alive: Mask, command: Array, dt: float, thrust: Array, mean: Array
) -> None:
    """Advance the rotor thrusts by dt under a held command.

    T' = (sat(cmd) - T) / lag, solved exactly; sat clips to [F_min / 4, F_max / 4]. The rotors of
    a dead vehicle run down to zero with the same lag.

    Args:
        team: The team; `motor_lag` 0 means that thrust follows at once.
        alive: Vehicles whose rotors still turn, (n,).
        command: Commanded thrusts, (n, 4) [N].
        dt: Time to advance [s].
        thrust: Thrusts, (n, 4) [N]; from now to dt later, in place.
        mean: Mean thrusts over dt, (n, 4) [N]; written.

    Source: Paper eq. (5); PAPER_NOTES 6.
    """
    keep, blend = 0.0, 0.0
    if team.motor_lag > 0.0:
        keep = math.exp(-dt / team.motor_lag)
        blend = team.motor_lag / dt * (1.0 - keep)
    for i in range(thrust.shape[0]):
        low, high = 0.25 * team.thrust_min[i], 0.25 * team.thrust_max[i]
        for k in range(4):
            target = min(max(command[i, k], low), high) if alive[i] else 0.0
            gap = thrust[i, k] - target
            mean[i, k] = target + gap * blend
            thrust[i, k] = target + gap * keep
