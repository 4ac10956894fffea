# SPDX-License-Identifier: Apache-2.0
"""The team's shape for planning: an upright cylinder that holds load, cables and vehicles."""

import math
from dataclasses import dataclass

import numpy as np

from skyhaul.model.team import Team


@dataclass(frozen=True, kw_only=True)
class TeamShape:
    """Upright cylinder around the load's centre of mass; the same for every yaw.

    Source: PAPER_NOTES 29, the paper's "safety distance r" made definite.
    """

    radius_m: float
    """Horizontal reach [m]."""
    above_m: float
    """Height above the centre of mass of the load [m]."""
    below_m: float
    """Depth below the centre of mass of the load [m]."""


def team_shape(team: Team, margin_m: float) -> TeamShape:
    """The smallest cylinder around the formation at its target cable angle, plus a margin.

    Args:
        team: The team.
        margin_m: Added on every side: swing, tracking error, tilt [m].
    """
    p_LA, out, length = team.hooks_L(), team.formation_dirs_L(), team.cable_lengths_m()
    p_LB = p_LA + length[:, None] * out
    vehicle, payload = team.vehicle, team.payload
    if payload.kind == "rigid":
        x, y, z = (0.5 * e for e in payload.size_m)
        load_radius, load_below = math.hypot(x, y), z
    else:
        load_radius = load_below = payload.radius_m
    reach = float(np.max(np.hypot(p_LB[:, 0], p_LB[:, 1]))) + vehicle.radius_m
    return TeamShape(
        radius_m=max(reach, load_radius) + margin_m,
        above_m=float(np.max(p_LB[:, 2])) + vehicle.half_height_m + margin_m,
        below_m=load_below + margin_m,
    )
