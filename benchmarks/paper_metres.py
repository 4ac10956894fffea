# SPDX-License-Identifier: Apache-2.0
"""Claim: the paper's scenario at 1 unit = 1 m, fly-in and hook-up included, in 5 of 5 seeds."""

from typing import Any

from fly import Job, fly_all
from result_file import Result, Row, arguments, least, most, numbers, publish, spread, successes

from skyhaul.evaluation.series import Run

SEEDS = range(5)
KEYS = (
    *("fly_in_s", "hooked_up_s", "lift_off_s", "mission_time_s", "distance_to_goal_m"),
    *("payload_path_m", "path_ratio", "collisions", "min_clearance_m", "min_tension_n"),
    *("tracking_rmse_m", "nmpc_solves", "nmpc_failures", "replans", "plan_ms_p50", "plan_ms_p99"),
    *("compute_cpu_s", "real_time_factor", "program_faults"),
)


def phases(run: Run) -> dict[str, Any]:
    """How long the vehicles flew in, when all hooks were closed, when the load was carried."""
    spans = run.phase_spans
    fly_in = [end - begin for name, begin, end in spans if name == "fly in"]
    hooked = (run.series["cable_attached"] > 0.0).all(axis=1)
    return {
        "fly_in_s": sum(fly_in) if fly_in else None,
        "hooked_up_s": float(run.t_s[hooked.argmax()]) if hooked.any() else None,
        "lift_off_s": float(run.t_s[run.airborne.argmax()]) if run.airborne.any() else None,
    }


def main() -> None:
    """Fly all seeds and write the result."""
    args = arguments(__doc__)
    seeds = SEEDS[:1] if args.quick else SEEDS
    jobs = [Job("paper-metres", seed, case="paper-metres", measures=(phases,)) for seed in seeds]
    flown = fly_all(jobs, args.workers)
    n, name = len(flown), "`paper-metres`"
    rows = [
        Row(f"{name}: missions done", successes(flown), "", f"{n}/{n}"),
        Row(f"{name}: all hooked up after, median (range)", spread(flown, "hooked_up_s"), "s"),
        Row(f"{name}: contacts after lift-off", int(sum(numbers(flown, "collisions"))), "", "0"),
        Row(f"{name}: least clearance", least(flown, "min_clearance_m"), "m", "> 0"),
        Row(f"{name}: least tension after lift-off", least(flown, "min_tension_n"), "N", "> 0"),
        Row(f"{name}: payload RMSE, worst", most(flown, "tracking_rmse_m"), "m"),
        Row(f"{name}: mission time, median (range)", spread(flown, "mission_time_s"), "s"),
        Row(f"{name}: CPU time of a flight, median (range)", spread(flown, "compute_cpu_s"), "s"),
    ]
    result = Result(
        name="paper_metres",
        claim="paper-metres: 5 of 5 seeds, fly-in and hook-up included",
        rows=rows,
        flights=flown,
        keys=KEYS,
        notes={},
    )
    publish(result, write=not args.quick)


if __name__ == "__main__":
    main()
