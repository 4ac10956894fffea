# SPDX-License-Identifier: Apache-2.0
"""Samples of an IMU that are false: told from those before alone, since the filter cannot wait."""

from skyhaul.jit import njit
from skyhaul.perception.vio.screening import FALSE_MPS2, FALSE_RAD_S, FALSE_RAD_S2
from skyhaul.types import Array


@njit
def believed(last: Array, waiting: Array, sample: Array, dt: float) -> bool:
    """Whether a sample is believed: if it goes on from the last one, or from one that waits.

    A sample that differs from the last one by more than a body can do since then waits; the next
    one may bear it out. So what stays is believed from the second sample on, and what comes and
    goes never is.

    Args:
        last: Rate and force that were believed last, (6,) [rad/s, m/s^2].
        waiting: Time, rate and force of a sample that waits, time -1 where none does, (7,);
            changed [us].
        sample: Time, rate and force, (7,).
        dt: Since the last one [s].
    """
    since = 1e-6 * (sample[0] - waiting[0])
    fine = _goes_on(last, sample[1:], dt)
    if not fine and waiting[0] >= 0.0:
        fine = _goes_on(waiting[1:], sample[1:], since)
    if fine:
        waiting[0] = -1.0
    else:
        waiting[:] = sample
    return fine


@njit
def _goes_on(before: Array, after: Array, dt: float) -> bool:
    """Whether a body can get from one sample to another; never to or from nan."""
    for c in range(3):
        if not abs(after[c] - before[c]) <= FALSE_RAD_S + FALSE_RAD_S2 * dt:
            return False
        if not abs(after[3 + c] - before[3 + c]) <= FALSE_MPS2:
            return False
    return True
