# SPDX-License-Identifier: Apache-2.0
"""Obstacles as half-spaces: one row per stage and obstacle, linear in the load's position.

The clearance of the team's cylinder to a mover's tube is convex in the load's position, so its
linearisation never promises more room than there is. The static layer is not convex: its half-space
is taken at the predicted place and at a probe farther off the nearest obstacle, where the opposite
wall of a narrow passage is seen.
"""

from typing import NamedTuple

import numpy as np

from skyhaul.mapping.api import WorldMap
from skyhaul.types import Array

STATIC_ROWS = 2
"""Rows for what stands: at the predicted place and at the probe."""
PROBE_M = 0.4
"""Distance of the probe from the predicted place [m]."""
REACH_M = 1.2
"""Obstacles farther than this do not enter the problem [m]."""


class CorridorRows(NamedTuple):
    """Half-spaces g (p - p_k) + clearance >= 0 at k places."""

    normal_W: Array  # (k, rows, 3) unit or zero: away from the obstacle
    clearance: Array  # (k, rows) at p_k [m]
    active: Array  # (k, rows) 1 or 0


def corridor_rows(world_map: WorldMap, p_WL: Array, t_us: Array, movers: int) -> CorridorRows:
    """Half-spaces around predicted places of the load.

    Args:
        world_map: M(t).
        p_WL: Predicted places, (k, 3) [m].
        t_us: When the load is there, (k,) [us].
        movers: Rows for tracks; of more tracks the nearest along the prediction count.
    """
    here = world_map.clearance_gradient(p_WL, t_us)
    probe = p_WL + PROBE_M * here.static_grad
    late = np.full(len(t_us), world_map.stamp_us + 1e6 * (world_map.tube_horizon_s + 1.0))
    there = world_map.clearance_gradient(probe, late)
    nearest = np.argsort(here.track.min(axis=0, initial=np.inf))[:movers]
    normal = np.zeros((len(p_WL), STATIC_ROWS + movers, 3))
    clearance = np.full((len(p_WL), STATIC_ROWS + movers), np.inf)
    normal[:, 0], clearance[:, 0] = here.static_grad, here.static
    normal[:, 1] = there.static_grad
    clearance[:, 1] = there.static - PROBE_M * np.sum(there.static_grad * here.static_grad, axis=1)
    used = slice(STATIC_ROWS, STATIC_ROWS + len(nearest))
    normal[:, used], clearance[:, used] = here.track_grad[:, nearest], here.track[:, nearest]
    reached = clearance < min(REACH_M, world_map.truncation_m)
    directed = np.einsum("kra,kra->kr", normal, normal) > 0.25
    active = reached & directed
    return CorridorRows(normal, np.where(active, clearance, 0.0), active.astype(np.float64))
