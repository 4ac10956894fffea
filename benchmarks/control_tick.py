# SPDX-License-Identifier: Apache-2.0
"""Claim: one control tick of four vehicles takes some 20 to 40 us, far below the 2 ms it has.

CPU time of the tick, of a single vehicle's tick, and of the tension distribution when the wanted
forces are within the limits and when they are not (random changes by 40 % of a tension, seeds
0-199), for 4 and 8 vehicles; with a calibration loop timed in the same run.
"""

import json
import time

import numpy as np
from calibration import calibration_s
from provenance import provenance, write_report
from timing import cpu_us

from skyhaul.control.allocation import AllocationLimits, ForceLimits, distribute, wrench_weights
from skyhaul.control.geometric import Geometric, hold_plan
from skyhaul.control.vehicle import CableTracking
from skyhaul.jit import njit
from skyhaul.model import (
    Team,
    cable_state,
    hover_forces,
    hover_state,
    hover_wrenches,
    team_state,
)
from skyhaul.perception.api import TeamEstimate
from skyhaul.types import Array

SEEDS = 200
PLACE = np.array([0.0, 0.0, 2.0])


def tick_us(n: int) -> dict[str, dict[str, float]]:
    """The tick of a hovering team of n, and of one of its vehicles."""
    team = Team(count=n)
    bodies = team_state(team, hover_state(team, PLACE))
    estimate = TeamEstimate(
        stamp_us=0,
        team=bodies,
        cables=cable_state(team, bodies, np.linalg.norm(hover_forces(team), axis=1)),
        attached=np.ones(n, dtype=bool),
        thrust=hover_wrenches(team)[:, 0],
        load_covariance=np.zeros((12, 12)),
    )
    plan = hold_plan(team, 0, PLACE, np.eye(3), np.ones(n, dtype=bool), Geometric())
    tracker, yaw = CableTracking().build(team), np.zeros(n)
    memory, _ = tracker.step(tracker.init(n), estimate, plan, yaw)
    return {
        "all": cpu_us(lambda: tracker.step(memory, estimate, plan, yaw), 2000),
        "one": cpu_us(lambda: tracker.step_one(memory, estimate, plan, yaw, 0), 2000),
    }


@njit
def _repeat(f: Array, limits: ForceLimits, count: int, slack: Array) -> int:
    """`distribute` `count` times from the same forces; returns the steps of one."""
    steps = 0
    for _ in range(count):
        steps = distribute(f.copy(), limits, 60, slack).steps
    return steps


def distribution_us(n: int) -> dict[str, object]:
    """The tension distribution inside numba, idle and with limits that bind."""
    team, params, slack = Team(count=n), AllocationLimits(), np.empty(6)
    arrays = team.arrays()
    limits = ForceLimits(
        axis=team.formation_dirs_L().copy(),
        arm=team.hooks_L().copy(),
        offset=np.outer(arrays.m_B, [0.0, 0.0, arrays.g]),
        thrust_max=arrays.thrust_max,
        length=arrays.length,
        active=np.ones(n),
        tension_min=team.tension_min_n,
        cone_tan=float(np.tan(np.deg2rad(params.cone_deg))),
        separation=0.9 * team.separation_m,
        weight=wrench_weights(params, team.hook_ring_m),
        tolerance=params.tolerance_n,
    )
    hover = hover_forces(team)
    size = 0.4 * float(np.linalg.norm(hover[0]))
    times, steps = [], []
    for seed in range(SEEDS):
        wanted = hover + np.random.default_rng(seed).normal(scale=size, size=hover.shape)
        found = _repeat(wanted, limits, 1, slack)
        if found:
            begin = time.process_time()
            _repeat(wanted, limits, 200, slack)
            times.append(1e6 * (time.process_time() - begin) / 200)
            steps.append(found)
    nominal = cpu_us(lambda: _repeat(hover, limits, 2000, slack), 1)
    p50, p99 = np.percentile(times, [50, 99])
    return {
        "within_limits": {k: v / 2000 for k, v in nominal.items()},
        "limits_bind": {"p50": float(p50), "p99": float(p99), "max": max(times)},
        "steps": {"p50": float(np.median(steps)), "max": max(steps)},
        "cases": len(times),
    }


def main() -> None:
    """Time everything and write the result."""
    calibration = calibration_s()
    ticks = {n: tick_us(n) for n in (4, 8)}
    shares = {n: distribution_us(n) for n in (4, 8)}
    report = {
        "claim": "a control tick of 4 vehicles takes 20 to 40 us",
        "rows": [
            {
                "measure": "control tick at 500 Hz, 4 vehicles",
                "value": ticks[4]["all"]["median"],
                "unit": "us CPU",
                "bar": "<= 40",
            },
            {
                "measure": "tension distribution, 4 cables, limits bind, 99th percentile",
                "value": shares[4]["limits_bind"]["p99"],
                "unit": "us CPU",
                "bar": "<= 50",
            },
        ],
        "tick_us": ticks,
        "distribution_us": shares,
        "seeds": [0, SEEDS - 1],
        **provenance([calibration]),
    }
    write_report("control_tick", report)
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
