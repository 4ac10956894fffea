# SPDX-License-Identifier: Apache-2.0
"""Mixer of an X quadrotor: total thrust and body moment <-> thrusts of its four rotors.

Rotor order, seen from above, x forward, y left: 0 front left, 1 rear left, 2 rear right, 3 front
right. Rotors 0 and 2 turn clockwise, so the air turns the body counter-clockwise (+z) there;
rotors 1 and 3 the other way round. A wrench is (thrust along z_B, moment about x_B, y_B, z_B).
"""

import math

import numpy as np

from skyhaul.jit import njit
from skyhaul.model.team import Team, TeamArrays
from skyhaul.types import Array

ROTOR_DIR_B = np.sqrt(0.5) * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
"""Unit direction of each rotor from the centre, x and y in body axes, (4, 2)."""
ROTOR_SPIN = np.array([1.0, -1.0, 1.0, -1.0])
"""Sign of each rotor's yaw moment on the body, (4,)."""


def mixer_matrix(arm_m: float, torque_per_thrust_m: float) -> Array:
    """Matrix A with wrench = A rotor_thrust, (4, 4).

    tau_B = sum_k p_BK x (f_k e_3) + spin_k c f_k e_3
    """
    x, y = arm_m * ROTOR_DIR_B.T
    return np.stack([np.ones(4), y, -x, torque_per_thrust_m * ROTOR_SPIN])


def rotors_to_wrench(team: Team | TeamArrays, rotor_thrust: Array) -> Array:
    """Wrenches that the rotors give: (..., 4) [N] -> (..., 4) [N, N m]."""
    wrench: Array = rotor_thrust @ _matrix(team).T
    return wrench


def wrench_to_rotors(team: Team | TeamArrays, wrench: Array) -> Array:
    """Rotor thrusts that give a wrench, not limited: (..., 4) [N, N m] -> (..., 4) [N]."""
    rotors: Array = wrench @ np.linalg.inv(_matrix(team)).T
    return rotors


def saturate_rotors(team: Team | TeamArrays, wrench: Array) -> Array:
    """Rotor thrusts within their limits that come closest to the wrenches.

    f_k in [F_min / 4, F_max / 4]. Yaw moment is given up first, down to zero. If that does not do,
    the total thrust is shifted as little as roll and pitch moment ask; these shrink only where
    the rotors' range cannot hold their spread.

    Args:
        team: The team.
        wrench: Total thrust and body moment of every vehicle, (n, 4) [N, N m].

    Returns:
        Rotor thrusts, (n, 4) [N].

    Source:    Paper eq. (5).
    Deviation: Eq. (5) has no lower bound (PAPER_NOTES 6); see `test_no_rotor_leaves_its_limits`.
    """
    arrays = team.arrays() if isinstance(team, Team) else team
    out = np.empty((len(arrays.m_B), 4))
    saturate_rotors_kernel(arrays, np.ascontiguousarray(wrench, dtype=np.float64), out)
    return out


@njit
def saturate_rotors_kernel(team: TeamArrays, wrench: Array, out: Array) -> None:
    """`saturate_rotors` for numba: wrench (n, 4) into rotor thrusts `out` (n, 4)."""
    lever = 4.0 * team.arm * math.sqrt(0.5)
    for i in range(wrench.shape[0]):
        low, high = 0.25 * team.thrust_min[i], 0.25 * team.thrust_max[i]
        mean, roll, pitch = 0.25 * wrench[i, 0], wrench[i, 1] / lever, wrench[i, 2] / lever
        yaw = 0.25 * wrench[i, 3] / team.torque_per_thrust
        least, most = _yaw_range(mean, roll, pitch, low, high)
        if max(least, min(yaw, 0.0)) > min(most, max(yaw, 0.0)):
            peak = abs(roll) + abs(pitch)  # largest of the four tilt parts; the smallest is -peak
            shrink = min(1.0, 0.5 * (high - low) / max(peak, 1e-300))
            roll, pitch, peak = roll * shrink, pitch * shrink, peak * shrink
            mean = min(max(mean, low + peak), high - peak)
            least, most = _yaw_range(mean, roll, pitch, low, high)
        yaw = min(max(yaw, least), most)
        parts = (roll - pitch + yaw, roll + pitch - yaw, pitch - roll + yaw, -roll - pitch - yaw)
        for k in range(4):
            out[i, k] = min(max(mean + parts[k], low), high)  # rounding apart, already inside


@njit
def _yaw_range(
    mean: float, roll: float, pitch: float, low: float, high: float
) -> tuple[float, float]:
    """Smallest and largest yaw part with which every rotor is within its limits."""
    first, third = mean + roll - pitch, mean - roll + pitch
    second, fourth = mean + roll + pitch, mean - roll - pitch
    least = max(low - min(first, third), max(second, fourth) - high)
    most = min(high - max(first, third), min(second, fourth) - low)
    return least, most


def _matrix(team: Team | TeamArrays) -> Array:
    if isinstance(team, Team):
        return mixer_matrix(team.vehicle.arm_m, team.vehicle.torque_per_thrust_m)
    return mixer_matrix(team.arm, team.torque_per_thrust)
