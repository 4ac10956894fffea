# SPDX-License-Identifier: Apache-2.0
"""CPU time of small calls."""

import statistics
import time
from collections.abc import Callable

REPEATS = 7


def cpu_us(call: Callable[[], object], count: int) -> dict[str, float]:
    """CPU time of one call: median and spread over the repeats [us]."""
    call()
    rows = []
    for _ in range(REPEATS):
        begin = time.process_time()
        for _ in range(count):
            call()
        rows.append(1e6 * (time.process_time() - begin) / count)
    return {"median": statistics.median(rows), "min": min(rows), "max": max(rows)}
