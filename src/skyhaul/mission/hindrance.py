# SPDX-License-Identifier: Apache-2.0
"""What keeps a mission from its end: for the sentence that says how a flight ended."""

from dataclasses import dataclass

import numpy as np

from skyhaul.geometry.team_clearance import team_clearances
from skyhaul.model.envelope import TeamShape
from skyhaul.planning.api import PlanStatus, ReferencePlan
from skyhaul.plant.api import Truth
from skyhaul.types import US_PER_S, Array, TimeUs

BESIDE_M = 0.3
"""An obstacle this near to the team's shape at the goal keeps it away: the planner's map is coarser
than the truth by about this [m]."""
_TAKEN = (PlanStatus.RELAXED, PlanStatus.GOAL_BLOCKED)


@dataclass(frozen=True)
class Hindrance:
    """What is in the way, and since when."""

    what: str
    since_us: TimeUs
    goal: bool = False  # it is at the goal

    def sentence(self, name: str | None = None) -> str:
        """In words; `name` is that of an obstacle at the goal."""
        what = f"{self.what} by {name!r}" if self.goal and name is not None else self.what
        return f"{what} since {self.since_us / US_PER_S:.1f} s"


def hindrance(before: Hindrance | None, t_us: TimeUs, result: ReferencePlan) -> Hindrance | None:
    """Why a plan ends short of the goal; it began when this cause first showed."""
    if result.reaches_goal:
        return None
    taken = result.path.status in _TAKEN
    if taken:
        what = "goal blocked"
    elif result.path.status is PlanStatus.FOUND:
        what = "no clear way along the path to the goal"
    else:
        what = "no path to the goal"
    same = before is not None and before.what == what
    return before if same else Hindrance(what, t_us, taken)


def at_goal(truth: Truth, shape: TeamShape, p_WG: Array, names: tuple[str, ...]) -> str | None:
    """Name of the present obstacle nearest to the team's shape at the goal, if it is near.

    Args:
        truth: The true state.
        shape: The team's shape, its load at the goal.
        p_WG: The goal, (3,) [m].
        names: Of all obstacles.
    """
    o, size = truth.obstacles, (shape.radius_m, shape.above_m, shape.below_m)
    if not truth.present.any():
        return None
    gaps = team_clearances(size, np.asarray(p_WG, np.float64), o.kind, o.size, o.p_WO, o.R_WO)
    gaps = np.where(truth.present, gaps, np.inf)
    nearest = int(np.argmin(gaps))
    return names[nearest] if gaps[nearest] < BESIDE_M else None
