# SPDX-License-Identifier: Apache-2.0
"""Claim: solving on events saves 80 % of the solves of 20 Hz at <= 5 % more error on `figure8`.

Five ways to fly the same flights: re-solving on events with feedback along the plan, at 20 Hz from
the measured state (the classical NMPC, one SQP iteration each), at 2 Hz with the same feedback and
the same SQP iterations as on events, and, on events too, the geometric law without optimisation
and the NMPC of the literal wrench. `figure8` and `sudden` have nothing that a seed could change, so
they are flown once in still air and five times in turbulence. CPU seconds are those of the payload
controller.

All worlds take an hour on two cores. Flights are kept in `results/triggers.partial.jsonl`, so that
a run that was broken off goes on, and the result is written after each world with those that are
done (`--kept`: with the flights that are); delete that file to begin anew.
"""

import statistics
from typing import Any

from fly import Flown, Job, chosen, fly_all, read_kept
from provenance import RESULTS
from result_file import Result, Row, arguments, least, median, numbers, publish, spread, successes

WAYS = {
    "event": (),
    "20 Hz": ("mission.trigger.kind=periodic",),
    "2 Hz + feedback": ("mission.trigger.kind=periodic-feedback",),
    "geometric": ("control.payload.kind=geometric",),
    "wrench": ("control.payload.kind=wrench",),
}
TURBULENCE = ("world.wind.turbulence_mps=0.5",)
WORLDS: dict[str, tuple[str, tuple[str, ...], range]] = {
    "figure8": ("figure8", (), range(1)),
    "figure8 in turbulence": ("figure8", TURBULENCE, range(5)),
    "paper": ("paper", (), range(5)),
    "crossing": ("crossing", (), range(5)),
    "sudden": ("sudden", (), range(1)),
    "sudden in turbulence": ("sudden", TURBULENCE, range(5)),
}
"""Name: scenario, overrides, seeds."""
FEWER_BAR, RMSE_BAR = 80.0, 5.0
KEYS = (
    *("collisions", "min_clearance_m", "min_tension_n", "mission_time_s"),
    *("tracking_rmse_m", "tracking_max_m", "payload_swing_rms_deg"),
    *("nmpc_solves", "nmpc_solves_per_s", "nmpc_solve_ms_p50", "nmpc_solve_ms_p99"),
    *("nmpc_failures", "compute_cpu_s_nmpc", "compute_cpu_s", "bytes_sent"),
)


def line(flights: list[Flown]) -> dict[str, Any]:
    """One line of the table: a way in a world over its seeds."""
    world, way = flights[0].job.case.split(": ")
    return {
        "world": world,
        "way": way,
        "success": successes(flights),
        "collisions": int(sum(numbers(flights, "collisions"))),
        "min_clearance_m": least(flights, "min_clearance_m"),
        "rmse_mm": spread(flights, "tracking_rmse_m", 1e3),
        "swing_rms_deg": spread(flights, "payload_swing_rms_deg"),
        "solves_per_s": spread(flights, "nmpc_solves_per_s"),
        "solves": spread(flights, "nmpc_solves"),
        "nmpc_failures": int(sum(numbers(flights, "nmpc_failures"))),
        "controller_cpu_s": spread(flights, "compute_cpu_s_nmpc"),
        "mission_time_s": spread(flights, "mission_time_s"),
        "calibration_s": statistics.median(f.calibration_s for f in flights),
    }


def against(flown: list[Flown], world: str, key: str, other: str) -> float | None:
    """How much a metric of the event trigger lies below (-) or above (+) another way's [%]."""
    ours, theirs = (median(chosen(flown, case=f"{world}: {w}"), key) for w in ("event", other))
    return None if not theirs or ours is None else 100.0 * (ours / theirs - 1.0)


def comparison(flown: list[Flown], world: str) -> list[Row]:
    """The lines about one world: solves and error against 20 Hz and against 2 Hz + feedback."""
    judged = world.startswith("figure8")
    rows = []
    for other in ("20 Hz", "2 Hz + feedback"):
        bars = (
            (f"<= -{FEWER_BAR:g}", f"<= +{RMSE_BAR:g}")
            if judged and other == "20 Hz"
            else ("",) * 2
        )
        solves = against(flown, world, "nmpc_solves_per_s", other)
        rmse = against(flown, world, "tracking_rmse_m", other)
        rows.append(Row(f"`{world}`: solves on events against {other}", solves, "%", bars[0]))
        rows.append(Row(f"`{world}`: RMSE on events against {other}", rmse, "%", bars[1]))
    return rows


def verdict(flown: list[Flown], worlds: list[str]) -> list[str]:
    """What the trigger adds over 2 Hz with the same feedback, in sentences made of the numbers."""
    out = []
    for world in worlds:
        solves = against(flown, world, "nmpc_solves_per_s", "2 Hz + feedback")
        rmse = against(flown, world, "tracking_rmse_m", "2 Hz + feedback")
        if solves is None or rmse is None:
            continue
        ways = ("event", "2 Hz + feedback")
        both = [chosen(flown, case=f"{world}: {way}") for way in ways]
        done = " and ".join(successes(flights) for flights in both)
        clear = [least(flights, "min_clearance_m") for flights in both]
        text = f"`{world}`, on events against 2 Hz + feedback: {solves:+.0f} % solves, "
        text += f"{rmse:+.0f} % RMSE; done {done}"
        if None not in clear:
            text += f"; least clearance {clear[0]:.3f} and {clear[1]:.3f} m"
        out.append(text)
    return out


def main() -> None:
    """Fly all ways in all worlds and write the result."""
    args = arguments(__doc__, ("--kept", "fly nothing, report the flights that are kept"))
    worlds = ["figure8"] if args.quick else list(WORLDS)
    kept = None if args.quick else RESULTS / "triggers.partial.jsonl"
    if args.kept:
        jobs = [job for world in worlds for job in jobs_of(world)]
        report(list(read_kept(kept, jobs).values()) if kept else [], write=True)
        return
    flown: list[Flown] = []
    for world in worlds:
        flown += fly_all(jobs_of(world), args.workers, kept)
        report(flown, write=not args.quick)
    if kept is not None:
        kept.unlink()


def jobs_of(world: str) -> list[Job]:
    """All ways in one world."""
    scenario, overrides, seeds = WORLDS[world]
    return [
        Job(scenario, seed, (*overrides, *extra), case=f"{world}: {way}")
        for way, extra in WAYS.items()
        for seed in seeds
    ]


def report(flown: list[Flown], *, write: bool) -> None:
    """Print what these flights show, and write the result."""
    cases = dict.fromkeys(f.job.case for f in flown)
    worlds = [world for world in WORLDS if any(case.startswith(f"{world}: ") for case in cases)]
    rows = [row for world in worlds for row in comparison(flown, world)]
    table = [line(chosen(flown, case=case)) for case in cases]
    rows += [_row(x) for x in table]
    result = Result(
        name="triggers",
        claim=">= 80 % fewer solves than 20 Hz at <= 5 % higher RMSE on figure8; the rest compared",
        rows=rows,
        flights=flown,
        keys=KEYS,
        notes={
            "not_flown_yet": [
                f"{world}: {way}"
                for world in WORLDS
                for way in WAYS
                if f"{world}: {way}" not in cases
            ],
            "table": table,
            "remarks": verdict(flown, worlds),
        },
    )
    publish(result, write=write)
    for sentence in result.notes["remarks"]:
        print(sentence)


def _row(x: dict[str, Any]) -> Row:
    """A line of the table as one row of the README."""
    clear = x["min_clearance_m"]
    parts = [
        x["success"],
        "no obstacle" if clear is None else f"{clear:.2f} m clear",
        f"RMSE {x['rmse_mm']} mm",
        f"swing {x['swing_rms_deg']} deg",
        f"{x['solves_per_s']} solves/s",
        f"controller {x['controller_cpu_s']} CPU s",
    ]
    return Row(f"`{x['world']}`, {x['way']}", ", ".join(parts))


if __name__ == "__main__":
    main()
