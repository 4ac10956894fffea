# SPDX-License-Identifier: Apache-2.0
"""Whether a mission counts as done; judged from what was recorded, not from what was claimed."""

from typing import Any

import numpy as np

from skyhaul.evaluation.series import Run
from skyhaul.world.scenario import GoTo, Scenario

MetricMap = dict[str, Any]

NO_OUTCOME = "interrupted: the run has no recorded end"


def fault_of(run: Run, metrics: MetricMap) -> str | None:
    """Why the mission does not count as done, one sentence; None: it does.

    Done: the flight says so, and the recorded truth bears it out: the load held at the goal, or,
    in a task without one, never far from its reference; after lift-off no contact (a lost vehicle
    may fall to the floor, and on nobody), no touch of an obstacle and no slack cable.
    """
    outcome = run.events.outcome
    if outcome is None:
        return NO_OUTCOME
    if not outcome.success:
        return outcome.reason
    if isinstance(run.scenario.task, GoTo) and not _held(run, run.scenario.task):
        return "the load was not held at the goal"
    strayed = limits(run.scenario)["limit_tracking_max_m"]
    if strayed is not None and (metrics["tracking_max_m"] or 0.0) > strayed:
        off_m = metrics["tracking_max_m"]
        return f"the load was {off_m:.2f} m off its reference; task.within_m allows {strayed:g} m"
    hits = metrics["collisions"] - metrics["collisions_lost_vehicle"]
    if hits:
        first = next(c for c in run.events.contacts if c.airborne and not c.lost)
        what = f"{first.body_a} touched {first.body_b} at {first.t_s:.2f} s"
        return what if hits == 1 else f"{what}, the first of {hits} contacts"
    if metrics["min_clearance_m"] is not None and metrics["min_clearance_m"] <= 0.0:
        return f"the clearance fell to {metrics['min_clearance_m']:.3f} m"
    if metrics["min_tension_n"] is not None and metrics["min_tension_n"] <= 0.0:
        return f"a cable was slack for {metrics['slack_time_s']:.3f} s after lift-off"
    return None


def limits(scenario: Scenario) -> MetricMap:
    """The run's own criteria as `limit_<key>`, with the sense that the table knows."""
    task = scenario.task
    return {
        "limit_mission_time_s": scenario.time_limit_s,
        "limit_distance_to_goal_m": task.within_m if isinstance(task, GoTo) else None,
        "limit_tracking_max_m": None if isinstance(task, GoTo) else task.within_m,
        "limit_min_quad_distance_m": 2.0 * scenario.team.vehicle.radius_m,
    }


def goal_distance_m(run: Run) -> float | None:
    """Distance of the load to the goal at the end [m]; None without a goal."""
    task = run.scenario.task
    if not isinstance(task, GoTo) or not len(run.t_s):
        return None
    return float(np.linalg.norm(run.series["load"][-1, 0:3] - np.array(task.goal_m)))


def _held(run: Run, task: GoTo) -> bool:
    """Whether the last `hold_s` (less one row) of the run were spent near the goal and slowly."""
    t = run.t_s
    if not len(t) or t[-1] - t[0] < task.hold_s:
        return False
    last = run.series["load"][t > t[-1] - task.hold_s + 0.011]
    near = np.linalg.norm(last[:, 0:3] - np.array(task.goal_m), axis=1) < task.within_m
    slow = np.linalg.norm(last[:, 7:10], axis=1) < task.below_mps
    return bool(np.all(near & slow))
