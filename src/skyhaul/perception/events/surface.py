# SPDX-License-Identifier: Apache-2.0
"""What a new event's neighbours tell of its motion, and how that goes with the camera's own.

An edge of the image that moves with velocity f [px/s] leaves newest times that rise along its way:
t_i - t_j = g . (u_i - u_j) with g . f = 1. The slope g [s/px] is fitted to the newest events of the
same polarity, with a weak prior for g = 0, twice: the second time those that lie off the plane
count less.

    g = (sum d d^T + I)^-1 sum d dt,    n = g / |g|,    s = 1 / |g|    (direction, normal speed)

Something that stands at range rho moves in the image with f = r + w / rho: r = A dturn / dt is what
the camera's turn makes of it, w = -J v what its velocity v does, J the Jacobian of the lens at the
pixel's unit ray. So s = n . r + n . w / rho, and

    range = n . w / (s - n . r)

is the range at which it would stand. It is that of the scene where something stands, and anything,
often negative or shorter than any wall is near, where it moves by itself. Nodes start with these
quantities, each squeezed to the order of 1.

Source:    Benosman et al., "Event-based visual flow" (TNNLS 2014) for the plane through times;
    range from flow and known velocity is structure from motion for one normal flow.
Deviation: The turn is taken off the flow and not off the coordinates: where little is left of a
    displacement, a plane through turned coordinates has no slope to speak of.
Limits:    Only motion across an edge is seen. What moves less than a pixel within the window has no
    slope. A camera that does not move tells no range: w = 0.
"""

from typing import NamedTuple

import numpy as np

from skyhaul.jit import njit_inner
from skyhaul.perception.events.api import Float32
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"

INPUTS = 16
"""What a node starts with, see `node_inputs`."""

PLANE_EDGE, PLANE_NODE = 42, 40
"""Multiplications and multiply-adds that `graph` and this file spend on an edge, at most, and on a
node: 6 for the turn and 6 for the mean of e_ij; twice 15 for the plane; 2 for the mean age."""

POLARITY, DIRECTION, ACROSS = 0, slice(4, 6), 12
"""Those that change in a mirror or with the sign of the light."""

_SLOPE = 0.002  # [s/px]
_STEEPEST = 5e-4  # [s/px]
_NORMAL = 30.0  # [px/s]
_OWN = 10.0  # [px m/s]
_SLOW = 5.0  # [px/s]
_LONG_S = 0.3
_MISFIT_S = 1e-4
_TINY = 1e-9


class Surface(NamedTuple):
    """Neighbours of the same polarity, the newest of their pixels; overwritten by each event."""

    dx: Array  # (K,) from neighbour to event [px]
    dy: Array  # (K,)
    dt: Array  # (K,) [s]
    turned: Array  # (K, 2) part of the displacement that the camera's turn explains [px]


class Plane(NamedTuple):
    """A plane through the times."""

    gx: float  # [s/px]
    gy: float
    misfit: float  # [s]
    rx: float  # flow by the camera's turn [px/s]
    ry: float


def no_surface(most: int) -> Surface:
    """Room for the neighbours of one event."""
    return Surface(np.zeros(most), np.zeros(most), np.zeros(most), np.zeros((most, 2)))


@njit_inner
def fitted_plane(n: int, surface: Surface) -> Plane:
    """The plane through the times of n neighbours and the event."""
    gx, gy, misfit = 0.0, 0.0, 0.0
    rx, ry = 0.0, 0.0
    for again in range(2):
        xx, xy, yy, xt, yt, tt, count = 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0
        qx, qy = 0.0, 0.0
        scale = 1.0 / (misfit + _MISFIT_S)
        for m in range(n):
            x, y, t, weight = surface.dx[m], surface.dy[m], surface.dt[m], 1.0
            if again:
                off = scale * (t - gx * x - gy * y)
                weight = 1.0 / (1.0 + off * off * off * off)
            xx += weight * x * x
            xy += weight * x * y
            yy += weight * y * y
            xt += weight * x * t
            yt += weight * y * t
            tt += weight * t * t
            count += weight
            qx += weight * surface.turned[m, 0] * t
            qy += weight * surface.turned[m, 1] * t
        share = 1.0 / (xx * yy - xy * xy)
        gx, gy = share * (yy * xt - xy * yt), share * (xx * yt - xy * xt)
        misfit = np.sqrt(max(tt - gx * xt - gy * yt, 0.0) / max(count, 1.0))
        rx, ry = qx / (tt + _TINY), qy / (tt + _TINY)
    return Plane(gx, gy, misfit, rx, ry)


@njit_inner
def node_inputs(
    p: np.float32, n: int, same: int, plane: Plane, w0: float, w1: float,
    pause: float, active_s: float, out: Float32,
) -> None:  # fmt: skip
    """What a node starts with, (INPUTS,).

    Args:
        p: Polarity.
        n: Neighbours.
        same: Those on the surface.
        plane: Through their times.
        w0: Flow times range of what stands, x [px m/s].
        w1: The same, y.
        pause: Time since the event before at the pixel, in windows, at most 1.
        active_s: Mean time for which the neighbours' pixels have been firing [s].
        out: Polarity; 1; neighbours on the surface and all; direction n, shorter where the
            surface is flat (2); speed s; n . r; n . w; range; |w|; misfit; n x w; |r|; pause;
            activity.
    """
    g = np.sqrt(plane.gx * plane.gx + plane.gy * plane.gy)
    w, r = np.sqrt(w0 * w0 + w1 * w1), np.sqrt(plane.rx * plane.rx + plane.ry * plane.ry)
    inverse = 1.0 / (g + _TINY)
    nx, ny = inverse * plane.gx, inverse * plane.gy
    trust = g / (g + _SLOPE)
    speed = 1.0 / (g + _STEEPEST)
    turning, moving = nx * plane.rx + ny * plane.ry, nx * w0 + ny * w1
    across = nx * w1 - ny * w0
    left = speed - turning
    metres = moving * left / (left * left + _SLOW * _SLOW)
    out[0] = p
    out[1] = 1.0
    out[2] = same / 16.0
    out[3] = n / 16.0
    out[4] = trust * nx
    out[5] = trust * ny
    out[6] = speed / (speed + _NORMAL)
    out[7] = turning / (abs(turning) + _NORMAL)
    out[8] = moving / (abs(moving) + _OWN)
    out[9] = metres / (abs(metres) + 1.0)
    out[10] = w / (w + _OWN)
    out[11] = plane.misfit / (plane.misfit + 0.01)
    out[12] = across / (abs(across) + _OWN)
    out[13] = r / (r + _NORMAL)
    out[14] = pause
    out[15] = active_s / (active_s + _LONG_S)
