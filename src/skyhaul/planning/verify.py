# SPDX-License-Identifier: Apache-2.0
"""Clearance of a finished curve, at the exact times, with the one clearance function."""

import math
from typing import NamedTuple

import numpy as np

from skyhaul.jit import njit
from skyhaul.mapping.api import MapArrays, WorldMap
from skyhaul.mapping.clearance import static_clearance, tube_clearance
from skyhaul.planning.api import Reference
from skyhaul.planning.bspline import BASIS, evaluate_position
from skyhaul.planning.reference import SplineReference
from skyhaul.types import US_PER_S, Array, TimeUs

# mypy: disable-error-code="no-any-return"

LOOK_S = 0.02
"""Close to obstacles the curve is looked at this often [s]."""
ESCAPE_S = 2.5
"""A curve that begins too close must be clear after this [s]."""
ESCAPE_M = 0.05
"""On its way out it may come this much closer [m]."""


class Pace(NamedTuple):
    """How fast things come nearer, and how near they may."""

    fast: float  # bound of the speed of the load against anything [m/s]
    wanted: float  # clearance wanted [m]


Verdict = tuple[float, float, float]
"""Smallest clearance [m], when the curve is first not clear (inf: never) [s], clearance now [m]."""


@njit
def verify_spline(
    m: MapArrays, control: Array, dt: float, start: float, since: float, pace: Pace, basis: Array
) -> Verdict:
    """Look along a spline from `since` to its end, and on at rest up to the map's horizon.

    With c the clearance at one look, the next may come c / fast later: in between the clearance
    stays positive; closer than `LOOK_S` fast / 2 is not clear. A curve that begins closer than
    wanted need not keep what is wanted; one that begins too close is let out: it must not come
    much closer and be clear soon (`ESCAPE_S`).

    Args:
        m: The map.
        control: Control points, (k, 4).
        dt: Knot spacing [s].
        start: First knot, after the map's stamp [s].
        since: From where to look, after the first knot [s].
        pace: Speed bound and clearance wanted.
        basis: `bspline.BASIS`.

    Returns:
        See `Verdict`; the time counts from `since`.
    """
    p, scratch = np.empty(3), np.empty(3)
    end = max((len(control) - 7) * dt, m.horizon - start) - since
    hard = 0.5 * LOOK_S * pace.fast
    need, smallest, first = max(hard, pace.wanted), math.inf, math.inf
    t, escaping, at_first = 0.0, False, math.inf
    while True:
        evaluate_position(control, dt, since + t, p, basis)
        c = static_clearance(m, p[0], p[1], p[2])
        c = min(c, tube_clearance(m, p[0], p[1], p[2], start + since + t, c, scratch))
        if t == 0.0:
            at_first, escaping = c, c < hard
            need = need if c >= need else hard
        smallest = min(smallest, c)
        if c < need:
            if not escaping or t > ESCAPE_S or c < at_first - ESCAPE_M:
                first = min(first, t)
        else:
            escaping = False
        if t >= end:
            return smallest, first, at_first
        t = min(end, t + max(LOOK_S, c / pace.fast))


def fastest(world_map: WorldMap, speed_mps: float) -> float:
    """Bound of the speed of the load against anything that moves, with some margin [m/s]."""
    tracks = world_map.arrays.tracks
    mover = 0.0
    if len(tracks.kind) > 0:
        mover = float(np.max(np.linalg.norm(tracks.v_WO, axis=1) + tracks.growth))
    return 1.2 * speed_mps + mover


def verify(
    world_map: WorldMap, reference: Reference, since_us: TimeUs, speed_mps: float
) -> Verdict:
    """`verify_spline` for any reference, from a time on.

    Other kinds than splines are looked at every `LOOK_S`.
    """
    if isinstance(reference, SplineReference):
        start = (reference.start_us - world_map.stamp_us) / US_PER_S
        since = (since_us - reference.start_us) / US_PER_S
        pace = Pace(fastest(world_map, speed_mps), 0.0)
        return verify_spline(
            world_map.arrays, reference.control, reference.dt_s, start, since, pace, BASIS
        )
    last = max(reference.end_us, world_map.stamp_us + round(US_PER_S * world_map.tube_horizon_s))
    t_us = np.arange(since_us, max(last, since_us) + 1, round(US_PER_S * LOOK_S))
    c = world_map.clearance(reference.sample(t_us).p_WD[:, 0], t_us)
    bad = np.nonzero(c < 0.5 * LOOK_S * fastest(world_map, speed_mps))[0]
    first = float(t_us[bad[0]] - since_us) / US_PER_S if len(bad) else math.inf
    return float(np.min(c)), first, float(c[0])
