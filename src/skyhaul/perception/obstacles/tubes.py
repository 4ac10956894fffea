# SPDX-License-Identifier: Apache-2.0
"""Predicted tubes: where a track's obstacle is, by its covariance, up to a horizon."""

import numpy as np

from skyhaul.geometry.shapes import Sphere
from skyhaul.perception.api import Track
from skyhaul.perception.obstacles.motion import Belief, MotionFilter
from skyhaul.types import Array, IntArray, TimeUs

_NORMAL_95 = 1.6448536269514722
_SIZE_SIGMAS = 2.0


def radius_95(second_moment: Array) -> Array:
    """Radii of balls that hold 95 % of centred Gaussians, (..., 3, 3) [m^2] -> (...) [m].

    |e|^2 is taken as c times a chi-square with k degrees of freedom that has its mean and
    variance, and its quantile after Wilson and Hilferty.
    """
    trace = np.trace(second_moment, axis1=-2, axis2=-1)
    squares = np.sum(second_moment * np.swapaxes(second_moment, -1, -2), axis=(-2, -1))
    safe = np.maximum(trace, 1e-300)
    c, k = squares / safe, trace**2 / np.maximum(squares, 1e-300)
    h = 2.0 / (9.0 * np.maximum(k, 1e-9))
    quantile = k * (1.0 - h + _NORMAL_95 * np.sqrt(h)) ** 3
    radius: Array = np.sqrt(np.maximum(c * quantile, 0.0))
    return radius


def tracks_of(
    motion: MotionFilter, belief: Belief, stamp_us: TimeUs, name: IntArray, horizon_s: float
) -> tuple[Track, ...]:
    """Tracks as perception hands them out: balls, with tubes that hold over the horizon.

    The ball that holds 95 % grows faster than linearly; the tube is the chord of its radius
    between now and the horizon, so that it holds it in between.
    """
    if not len(name):
        return ()
    moments = motion.moments(belief)
    spreads = [motion.spread(belief, dt_s) for dt_s in (0.0, horizon_s)]
    now, then = radius_95(np.stack(spreads))
    radius = np.exp(moments.log_radius)
    size = radius * np.expm1(_SIZE_SIGMAS * np.sqrt(moments.radius_variance))
    return tuple(
        Track(
            track_id=int(name[i]),
            stamp_us=stamp_us,
            shape=Sphere(radius_m=float(radius[i])),
            p_WO=moments.p_WO[i],
            R_WO=np.eye(3),
            v_WO=moments.v_WO[i],
            covariance=moments.covariance[i],
            growth_mps=float((then[i] - now[i]) / horizon_s),
            tube_base_m=float(now[i] + size[i]),
        )
        for i in range(len(name))
    )
