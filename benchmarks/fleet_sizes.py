# SPDX-License-Identifier: Apache-2.0
"""Claim: 3 to 8 quadrotors fly `circle` and `paper` with the same code; a solve stays cheap.

The team's count is the only thing that changes; its formation follows. Load, cables and vehicles
are those of the scenario.
"""

import statistics
from typing import Any

from circle_tracking import laps_at_speed
from fly import Flown, Job, chosen, fly_all
from result_file import Result, Row, arguments, median, numbers, publish, successes

COUNTS = range(3, 9)
SEEDS = {"circle": range(1), "paper": range(3)}
SOLVE_BAR_MS = 15.0
PLACES = {"circle": ("team.hooks_m=null",), "paper": ("start.vehicles_m=null",)}
"""What places single vehicles in the file: left to the formation, since their number changes."""
KEYS = (
    *("lap_rmse_mm", "tracking_rmse_m", "nmpc_solves", "nmpc_solve_ms_p50", "nmpc_solve_ms_p99"),
    *(
        "nmpc_cpu_ms_mean",
        "nmpc_failures",
        "bytes_sent",
        "messages",
        "collisions",
        "min_clearance_m",
        "min_tension_n",
    ),
    *("min_quad_distance_m", "mission_time_s", "compute_cpu_s", "real_time_factor"),
)


def job(scenario: str, count: int, seed: int) -> Job:
    """One flight of a team of this size."""
    overrides = (f"team.count={count}", "team.azimuths_deg=null", *PLACES[scenario])
    measures = (laps_at_speed,) if scenario == "circle" else ()
    return Job(scenario, seed, overrides, case=f"{scenario}, N = {count}", measures=measures)


def line(flights: list[Flown]) -> dict[str, Any]:
    """One line of the table: a scenario and a team size over its seeds."""
    p99 = numbers(flights, "nmpc_solve_ms_p99")
    rmse = median(flights, "tracking_rmse_m")
    seconds = sum(numbers(flights, "mission_time_s"))
    return {
        "case": flights[0].job.case,
        "success": successes(flights),
        "rmse_mm": None if rmse is None else 1e3 * rmse,
        "lap_rmse_mm": median(flights, "lap_rmse_mm"),
        "solve_ms_p50": median(flights, "nmpc_solve_ms_p50"),
        "solve_ms_p99": max(p99, default=None),
        "solve_cpu_ms_mean": median(flights, "nmpc_cpu_ms_mean"),
        "bytes": median(flights, "bytes_sent"),
        "bytes_per_s": sum(numbers(flights, "bytes_sent")) / seconds if seconds else None,
        "min_clearance_m": min(numbers(flights, "min_clearance_m"), default=None),
        "min_tension_n": min(numbers(flights, "min_tension_n"), default=None),
        "cpu_s_per_s": sum(numbers(flights, "compute_cpu_s")) / seconds if seconds else None,
        "calibration_s": statistics.median(f.calibration_s for f in flights),
    }


def main() -> None:
    """Fly all sizes and write the result."""
    args = arguments(__doc__)
    counts = (3, 8) if args.quick else COUNTS
    jobs = [
        job(scenario, count, seed)
        for scenario, seeds in SEEDS.items()
        for count in counts
        for seed in (seeds[:1] if args.quick else seeds)
    ]
    if args.quick:
        jobs = [j for j in jobs if j.scenario == "circle"]
    flown = fly_all(jobs, args.workers)
    table = [line(chosen(flown, case=case)) for case in dict.fromkeys(j.case for j in jobs)]
    result = Result(
        name="fleet_sizes",
        claim="N = 3..8 on circle and paper: all missions done, N = 8 median solve <= 15 ms",
        rows=[_row(entry) for entry in table],
        flights=flown,
        keys=KEYS,
        notes={"table": table},
    )
    publish(result, write=not args.quick)


def _row(x: dict[str, Any]) -> Row:
    """A line of the table as one row of the README."""
    parts = [x["success"]]
    for key, form in _PARTS:
        if x[key] is not None:
            parts.append(form.format(x[key]))
    scenario, size = x["case"].split(", ")
    bar = f"all; median <= {SOLVE_BAR_MS:g} ms" if size == "N = 8" else "all"
    return Row(f"`{scenario}`, {size}", ", ".join(parts), "", bar)


_PARTS = (
    ("rmse_mm", "RMSE {:.1f} mm"),
    ("lap_rmse_mm", "at speed {:.1f} mm"),
    ("solve_ms_p50", "solve {:.1f} ms"),
    ("solve_ms_p99", "p99 {:.1f} ms"),
    ("solve_cpu_ms_mean", "mean CPU {:.1f} ms"),
    ("bytes_per_s", "{:.0f} B/s"),
)


if __name__ == "__main__":
    main()
