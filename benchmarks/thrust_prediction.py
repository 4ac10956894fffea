# SPDX-License-Identifier: Apache-2.0
"""Claim: the plant's thrusts on `crossing` are those the NMPC predicted, within 5 %.

Thrust of each vehicle in the plant (sum of its four rotors, lag and mixing included) against the
thrust that the force plan in force had predicted for that moment, 100 times a second after
lift-off, relative to the prediction.
"""

from typing import Any

import numpy as np
from fly import Job, fly_all
from result_file import Result, Row, arguments, most, publish, spread, successes

from skyhaul.evaluation.series import Run

SEEDS = range(5)
BAR_PERCENT = 5.0
KEYS = (
    *("thrust_error_rms_percent", "thrust_error_p95_percent", "thrust_error_p99_percent"),
    *("thrust_error_max_percent", "thrust_error_mean_percent", "thrust_rows"),
    *("collisions", "min_clearance_m", "tracking_rmse_m", "nmpc_solves", "compute_cpu_s"),
)


def thrust_error(run: Run) -> dict[str, Any]:
    """Relative difference of flown and predicted thrust over all vehicles that carry [%]."""
    flown = run.series["vehicle_rotor"].sum(axis=2)
    planned = run.series["vehicle_thrust_plan"]
    ok = run.airborne[:, None] & run.carrying & np.isfinite(planned) & (planned > 0.0)
    error = 100.0 * (flown[ok] - planned[ok]) / planned[ok]
    size = np.abs(error)
    return {
        "thrust_error_rms_percent": float(np.sqrt(np.mean(error**2))),
        "thrust_error_mean_percent": float(error.mean()),
        "thrust_error_p95_percent": float(np.percentile(size, 95)),
        "thrust_error_p99_percent": float(np.percentile(size, 99)),
        "thrust_error_max_percent": float(size.max()),
        "thrust_rows": int(ok.sum()),
    }


def main() -> None:
    """Fly all seeds and write the result."""
    args = arguments(__doc__)
    seeds = SEEDS[:1] if args.quick else SEEDS
    jobs = [Job("crossing", seed, case="crossing", measures=(thrust_error,)) for seed in seeds]
    flown = fly_all(jobs, args.workers)
    name, bar = "`crossing`, flown against predicted thrust", f"<= {BAR_PERCENT:g}"
    rows = [
        Row(f"{name}: RMS, worst seed", most(flown, "thrust_error_rms_percent"), "%", bar),
        Row(
            f"{name}: 95th percentile, worst seed",
            most(flown, "thrust_error_p95_percent"),
            "%",
            bar,
        ),
        Row(f"{name}: RMS, median (range)", spread(flown, "thrust_error_rms_percent"), "%", bar),
        Row(f"{name}: largest", most(flown, "thrust_error_max_percent"), "%"),
        Row("`crossing`: missions done", successes(flown), "", f"{len(flown)}/{len(flown)}"),
        Row(
            "`crossing`: CPU time of a flight, median (range)", spread(flown, "compute_cpu_s"), "s"
        ),
    ]
    result = Result(
        name="thrust_prediction",
        claim="plant thrust within 5 % of the thrust the NMPC predicted, on crossing",
        rows=rows,
        flights=flown,
        keys=KEYS,
        notes={},
    )
    publish(result, write=not args.quick)


if __name__ == "__main__":
    main()
