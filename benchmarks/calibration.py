# SPDX-License-Identifier: Apache-2.0
"""How fast this machine is now: a loop of pure Python, timed beside every benchmark."""

import time

ITERATIONS = 5_000_000


def calibration_s() -> float:
    """CPU time of the loop [s]; on an idle core of 2024 about 0.15 to 0.3 s."""
    begin, k = time.process_time(), 0
    while k < ITERATIONS:
        k += 1
    return time.process_time() - begin
