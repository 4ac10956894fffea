# SPDX-License-Identifier: Apache-2.0
"""What a way to the goal costs: one measure for all that choose between two."""

import numpy as np

from skyhaul.planning.api import Reference
from skyhaul.types import US_PER_S, TimeUs

METRE_S, ROOMY_M, TIGHT_S = 0.7, 0.25, 3.0
"""Cost of a metre of way [s]; clearance below which a way costs more [m], up to so much [s]."""
WORTH_S = 1.0
"""A way that costs so much less is always worth a change [s]."""
_SAMPLES = 64


def way_cost(left_s: float, length_m: float, smallest_m: float) -> float:
    """Cost of a way: the time it takes, its length, and little clearance [s].

    Args:
        left_s: Time that it still takes [s].
        length_m: Length that is left [m].
        smallest_m: Smallest clearance along it [m].
    """
    tight = min(max(0.0, 1.0 - smallest_m / ROOMY_M), 1.0)
    return left_s + METRE_S * length_m + TIGHT_S * tight


def reference_cost(reference: Reference, t_us: TimeUs, smallest_m: float) -> float:
    """`way_cost` of what is left of a reference after a time."""
    left_us = max(0, reference.end_us - t_us)
    times = t_us + np.linspace(0, left_us, _SAMPLES).astype(np.int64)
    p = reference.sample(times).p_WD[:, 0]
    length = float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum())
    return way_cost(left_us / US_PER_S, length, smallest_m)


def is_better(new_s: float, current_s: float, left_s: float, ratio: float) -> bool:
    """Whether a way is worth a change.

    It must cost less by a share 1 - ratio of the time that the current one still takes, or by
    `WORTH_S`, whichever is less: on a long way a second would else not count.

    Args:
        new_s: Its cost [s].
        current_s: Cost of what is left of the current one [s].
        left_s: Time that the current one still takes [s].
        ratio: 0 to 1.
    """
    return current_s - new_s > min((1.0 - ratio) * left_s, WORTH_S)
