# SPDX-License-Identifier: Apache-2.0
"""A* over the clearance field."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from skyhaul.mapping.api import LayerArrays, MapArrays, WorldMap
from skyhaul.params import Params
from skyhaul.planning.api import Plan, PlanStatus
from skyhaul.planning.search import (
    FOUND,
    OUT_OF_BUDGET,
    SearchRules,
    nearest_free,
    search,
    trace,
    workspace,
)
from skyhaul.planning.shortcut import straighten
from skyhaul.types import US_PER_S, Array, IntArray, TimeUs

_STATUS = {FOUND: PlanStatus.FOUND, OUT_OF_BUDGET: PlanStatus.OUT_OF_BUDGET}


@dataclass(frozen=True, kw_only=True)
class AStar(Params):
    """Cheapest 26-connected path of the load, without cutting corners, then with shortcuts.

    Source:
        Paper Sec. III-C (unnumbered): f = g + h, infinite cost within r, high cost near it.
    Deviation:
        r is the team's own shape, already in the clearance field (PAPER_NOTES 29); h is octile,
        the Euclidean one selectable (PAPER_NOTES 28); movers block voxels at the time of passage.
    """

    kind: Literal["astar"] = "astar"
    clearance_m: float = 0.08
    """Smallest clearance of the team's shape on the path [m]."""
    band_m: float = 0.4
    """Clearances less than this above the smallest cost more [m]."""
    band_weight: float = 1.0
    """How much more at the smallest clearance, as a share."""
    heuristic: Literal["octile", "euclidean", "none"] = "octile"
    """Lower bound of the way that is left; none makes it Dijkstra's search."""
    max_expanded: int = 150_000
    """Search budget [voxels]."""
    moving_expanded: int = 30_000
    """Search budget among movers, where waiting may do as well [voxels]."""
    relax_m: float = 1.5
    """A blocked start or goal is moved to the nearest free voxel within this distance [m]."""
    straight: bool = True
    """Take line-of-sight shortcuts."""

    def __post_init__(self) -> None:
        for name in ("clearance_m", "band_m", "band_weight", "relax_m"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")
        for name in ("max_expanded", "moving_expanded"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be >= 1, got {getattr(self, name)}")

    def plan(
        self,
        world_map: WorldMap,
        p_WS: Array,
        p_WG: Array,
        speed_mps: float,
        start_us: TimeUs | None = None,
    ) -> Plan:
        """See `PathPlanner.plan`; `start_us` is when the load leaves S, default the map's stamp.

        With a rolling window the search runs over the coarse layer, and again over the window
        up to where the coarse path leaves it.
        """
        m = world_map.arrays
        p_WS, p_WG = np.asarray(p_WS, np.float64), np.asarray(p_WG, np.float64)
        start_s = 0.0 if start_us is None else (start_us - world_map.stamp_us) / US_PER_S
        rules = self._rules(world_map, start_s, speed_mps)
        if not m.windowed:
            return self._finish(m, rules, self._search(m, m.fine, rules, p_WS, p_WG))
        return self._finish(m, rules, self._two_levels(m, rules, p_WS, p_WG))

    def _rules(self, world_map: WorldMap, start_s: float, speed_mps: float) -> SearchRules:
        moving = len(world_map.tracks) > 0
        return SearchRules(
            clearance=self.clearance_m,
            band=self.band_m,
            weight=self.band_weight if self.band_m > 0.0 else 0.0,
            octile=self.heuristic == "octile",
            informed=self.heuristic != "none",
            budget=min(self.moving_expanded, self.max_expanded) if moving else self.max_expanded,
            tubes=moving,
            start=start_s,
            speed=max(speed_mps, 1e-3),
        )

    def _search(
        self, m: MapArrays, layer: LayerArrays, rules: SearchRules, p_WS: Array, p_WG: Array
    ) -> Plan:
        """A path over one layer, through voxel centres, S and G themselves at its ends."""
        start, goal = _cell(layer, p_WS), _cell(layer, p_WG)
        if start is None:
            return Plan(PlanStatus.START_BLOCKED)
        if goal is None:
            return Plan(PlanStatus.GOAL_BLOCKED)
        reach = max(1, round(self.relax_m / layer.voxel))
        wanted = goal.copy()
        if not nearest_free(m, layer, rules, p_WS, reach, start):
            return Plan(PlanStatus.START_BLOCKED)
        if not nearest_free(m, layer, rules._replace(tubes=False), p_WG, reach, goal):
            return Plan(PlanStatus.GOAL_BLOCKED)
        w = workspace(layer.clearance.size, rules.tubes)
        code, n_expanded = search(m, layer, start, goal, rules, w)
        if code != FOUND:
            return Plan(_STATUS.get(code, PlanStatus.NO_PATH), n_expanded=n_expanded)
        path = trace(layer, start, goal, w)
        relaxed = not np.array_equal(goal, wanted)
        ends = [p_WS[None], path[1:-1], path[-1:] if relaxed else p_WG[None]]
        status = PlanStatus.RELAXED if relaxed else PlanStatus.FOUND
        return Plan(status, np.concatenate(ends), n_expanded)

    def _two_levels(self, m: MapArrays, rules: SearchRules, p_WS: Array, p_WG: Array) -> Plan:
        """A coarse path, its part inside the window searched again finely."""
        near = self._rim_gap(m, p_WG[None])[0] > 0.0
        if near:
            return self._search(m, m.fine, rules, p_WS, p_WG)
        coarse = self._search(m, m.coarse, rules._replace(tubes=False), p_WS, p_WG)
        if len(coarse.p_WP) == 0:
            return coarse
        inside = self._rim_gap(m, coarse.p_WP) > 0.0
        leave = int(np.argmin(inside)) if not np.all(inside) else len(inside)
        if leave < 2:
            return coarse
        fine = self._search(m, m.fine, rules, p_WS, coarse.p_WP[leave - 1])
        if len(fine.p_WP) == 0:
            return replace(fine, n_expanded=fine.n_expanded + coarse.n_expanded)
        path = np.concatenate([fine.p_WP, coarse.p_WP[leave:]])
        return Plan(coarse.status, path, fine.n_expanded + coarse.n_expanded)

    def _rim_gap(self, m: MapArrays, p: Array) -> Array:
        """How far points are inside the part of the window that knows all around, (k,) [m]."""
        last = m.fine.origin + m.fine.voxel * (np.array(m.fine.clearance.shape) - 1)
        gap = np.minimum(p - m.fine.origin, last - p)
        gap[:, :2] -= m.shape[0]
        gap[:, 2] -= max(m.shape[1], m.shape[2])
        return np.asarray(np.min(gap, axis=1)) - self.clearance_m

    def _finish(self, m: MapArrays, rules: SearchRules, plan: Plan) -> Plan:
        if len(plan.p_WP) < 3 or not self.straight:
            return plan
        return replace(plan, p_WP=straighten(m, rules, plan.p_WP))


def _cell(layer: LayerArrays, p: Array) -> IntArray | None:
    """Voxel that contains a point, or None outside the layer."""
    cell = np.rint((p - layer.origin) / layer.voxel)
    if np.any(~np.isfinite(cell)) or np.any(cell < 0) or np.any(cell >= layer.clearance.shape):
        return None
    return cell.astype(np.int64)
