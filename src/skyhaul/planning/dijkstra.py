# SPDX-License-Identifier: Apache-2.0
"""Dijkstra's search over the clearance field: the yardstick of the informed one."""

from dataclasses import dataclass
from typing import Literal

from skyhaul.mapping.api import WorldMap
from skyhaul.params import Params
from skyhaul.planning.api import Plan
from skyhaul.planning.astar import AStar
from skyhaul.types import Array, TimeUs


@dataclass(frozen=True, kw_only=True)
class Dijkstra(Params):
    """Cheapest 26-connected path, searched evenly on all sides: no heuristic to be wrong.

    It finds paths of the same cost as `AStar` and expands every voxel that is nearer than the
    goal; what the two do with one start, goal and map differs in effort only.
    """

    kind: Literal["dijkstra"] = "dijkstra"
    clearance_m: float = 0.08
    """Smallest clearance of the team's shape on the path [m]."""
    band_m: float = 0.4
    """Clearances less than this above the smallest cost more [m]."""
    band_weight: float = 1.0
    """How much more at the smallest clearance, as a share."""
    max_expanded: int = 3_000_000
    """Search budget [voxels]."""
    moving_expanded: int = 200_000
    """Search budget among movers, where waiting may do as well [voxels]."""
    relax_m: float = 1.5
    """A blocked start or goal is moved to the nearest free voxel within this distance [m]."""
    straight: bool = True
    """Take line-of-sight shortcuts."""

    def __post_init__(self) -> None:
        self._uninformed()  # it checks the ranges

    def plan(
        self,
        world_map: WorldMap,
        p_WS: Array,
        p_WG: Array,
        speed_mps: float,
        start_us: TimeUs | None = None,
    ) -> Plan:
        """See `PathPlanner.plan`."""
        return self._uninformed().plan(world_map, p_WS, p_WG, speed_mps, start_us)

    def _uninformed(self) -> AStar:
        return AStar(
            clearance_m=self.clearance_m,
            band_m=self.band_m,
            band_weight=self.band_weight,
            heuristic="none",
            max_expanded=self.max_expanded,
            moving_expanded=self.moving_expanded,
            relax_m=self.relax_m,
            straight=self.straight,
        )
