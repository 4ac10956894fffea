# SPDX-License-Identifier: Apache-2.0
"""Where in a camera's image the team's own bodies are: what fires there is never a mover.

Vehicles, load and cables move against the room and fire like movers. Their places and sizes are
known from the team's own state, so their share of the image is left out: a cell is blind when a
ray through its middle passes one of them closer than its radius, a margin, and what the cell's own
half width and the pose's error are at that distance.
"""

import math
from typing import NamedTuple

import numpy as np

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.jit import njit
from skyhaul.model.state import TeamState
from skyhaul.model.team import Team
from skyhaul.types import Array, Mask

_NEAR_M = 0.2
"""Of its own cable a camera does not see what is nearer to its vehicle than this [m]."""


class Bodies(NamedTuple):
    """Balls swept along segments: a vehicle's and the load's segments have no length."""

    a_W: Array  # (k, 3) [m]
    b_W: Array  # (k, 3) [m]
    radius: Array  # (k,) [m]


def own_bodies(team: Team, state: TeamState, attached: Mask, vehicle: int) -> Bodies:
    """Everything of the team but one vehicle, which does not see itself."""
    n, R_WL = team.count, quat_to_R(state.q_WL)
    hooks_W = state.p_WL + team.hooks_L() @ R_WL.T
    others = np.flatnonzero(np.arange(n) != vehicle)
    cables = np.flatnonzero(attached)
    far_end = state.p_WB[cables]
    own = cables == vehicle
    off = hooks_W[cables] - far_end
    length = np.linalg.norm(off, axis=1, keepdims=True)
    far_end = np.where(own[:, None], far_end + np.minimum(_NEAR_M / length, 1.0) * off, far_end)
    payload = team.payload
    if payload.kind == "rigid":
        load_radius = 0.5 * float(np.linalg.norm(payload.size_m))
    else:
        load_radius = payload.radius_m
    vehicle_radius = math.hypot(team.vehicle.radius_m, team.vehicle.half_height_m)
    return Bodies(
        a_W=np.concatenate([state.p_WB[others], state.p_WL[None], hooks_W[cables]]),
        b_W=np.concatenate([state.p_WB[others], state.p_WL[None], far_end]),
        radius=np.concatenate([
            np.full(len(others), vehicle_radius), [load_radius],
            np.full(len(cables), team.cable_radius_m),
        ]),
    )  # fmt: skip


def blind_cells(rays_W: Array, p_WC: Array, bodies: Bodies, margin_m: float, slack: float) -> Mask:
    """Which cells of an image show the team itself.

    Args:
        rays_W: Unit rays through the middles of the cells, (k, 3).
        p_WC: Where the camera is, (3,) [m].
        bodies: Of the team.
        margin_m: By which they are grown [m].
        slack: By which they are grown per metre of distance: half a cell and the pose's error.
    """
    blind = np.zeros(len(rays_W), np.bool_)
    _cover(rays_W, p_WC, bodies, margin_m, slack, blind)
    return blind


@njit
def _cover(
    rays: Array, p_WC: Array, bodies: Bodies, margin: float, slack: float, blind: Mask
) -> None:
    """Mark rays that pass a body."""
    for j in range(bodies.radius.shape[0]):
        a, b = bodies.a_W[j], bodies.b_W[j]
        ax, ay, az = a[0] - p_WC[0], a[1] - p_WC[1], a[2] - p_WC[2]
        ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        for i in range(rays.shape[0]):
            gap, t = ray_to_segment(rays[i, 0], rays[i, 1], rays[i, 2], ax, ay, az, ex, ey, ez)
            if gap <= bodies.radius[j] + margin + slack * t:
                blind[i] = True


@njit
def ray_to_segment(
    dx: float, dy: float, dz: float, ax: float, ay: float, az: float,
    ex: float, ey: float, ez: float,
) -> tuple[float, float]:  # fmt: skip
    """Gap between the ray t d, t >= 0, and the segment a + s e, 0 <= s <= 1; and that t [m].

    Source: Ericson, "Real-time collision detection" (2005), 5.1.9.
    """
    ee = ex * ex + ey * ey + ez * ez
    ae = ax * ex + ay * ey + az * ez
    da, de = dx * ax + dy * ay + dz * az, dx * ex + dy * ey + dz * ez
    across = ee - de * de
    s = min(max((da * de - ae) / across, 0.0), 1.0) if across > 1e-12 else 0.0
    t = max(da + s * de, 0.0)
    if ee > 0.0:
        s = min(max((t * de - ae) / ee, 0.0), 1.0)
        t = max(da + s * de, 0.0)
    x, y, z = ax + s * ex - t * dx, ay + s * ey - t * dy, az + s * ez - t * dz
    return math.sqrt(x * x + y * y + z * z), t
