# SPDX-License-Identifier: Apache-2.0
"""Claim: when a vehicle dies in flight, the others bring the load to the goal (4 -> 3, 5 -> 4).

The files let vehicle 1 die half way to the goal; here every vehicle of the team dies once there,
and in the team of four also at other places, and in turbulence. Contacts are counted after
lift-off: those of the dead vehicle with the floor are its fall; any other is a failure. A run that
was broken off goes on from `results/lost_vehicle.partial.jsonl`; delete that to begin anew.
"""

from typing import Any

import numpy as np
from fly import Flown, Job, chosen, fly_all
from provenance import RESULTS
from result_file import Result, Row, arguments, least, most, numbers, publish, spread, successes

from skyhaul.evaluation.series import Run

TEAMS = {"lost-vehicle": 4, "lost-vehicle-5": 5}
FILED = 1
"""The vehicle that dies in the scenario files."""
PLACES = (0.3, 0.7)
"""Other shares of the way at which vehicles die."""
TURBULENCE = ("world.wind.turbulence_mps=0.3",)
KEYS = (
    *("lost_at_s", "drop_m", "tilt_after_deg", "lowest_after_m", "contacts_of_the_fall"),
    *("contacts_other", "distance_to_goal_m", "mission_time_s", "min_tension_n", "min_clearance_m"),
    *("max_thrust_ratio", "tracking_rmse_m", "tracking_max_m", "slack_time_s", "compute_cpu_s"),
)


def aftermath(run: Run) -> dict[str, Any]:
    """What the loss of a vehicle did to load and team."""
    alive = run.series["vehicle_alive"] > 0.0
    lost = ~alive.all(axis=1)
    if not lost.any():
        return {"lost_at_s": None}
    k = int(np.argmax(lost))
    z, q = run.series["load"][:, 2], run.series["load"][:, 3:7]
    settled = q[-min(100, len(q) - k) :]
    tilt = np.degrees(np.arccos(1.0 - 2.0 * (settled[:, 1] ** 2 + settled[:, 2] ** 2)))
    early = slice(k, k + 300)
    hits = [c for c in run.events.contacts if c.airborne]
    falls = [c for c in hits if c.lost and "room" in (c.body_a, c.body_b)]
    return {
        "lost_at_s": float(run.t_s[k]),
        "drop_m": float(z[k] - z[early].min()),
        "lowest_after_m": float(z[k:].min()),
        "tilt_after_deg": float(tilt.mean()),
        "contacts_of_the_fall": len(falls),
        "contacts_other": len(hits) - len(falls),
    }


def rows(flights: list[Flown], name: str) -> list[Row]:
    """The lines about one team."""
    as_filed = chosen(flights, overrides=_dies(FILED))
    half_way = [f for f in flights if len(f.job.overrides) == 1]
    more = [f for f in flights if len(f.job.overrides) > 1]
    other = sum(int(x) for x in numbers(as_filed, "contacts_other"))
    return [
        Row(f"`{name}`: ends at the goal, as in its file", successes(as_filed), "", "1/1"),
        Row(f"`{name}`: contacts but for the fall, as in its file", other, "", "0"),
        Row(f"`{name}`: ends at the goal, whichever vehicle dies", successes(half_way), "",
            f"{len(half_way)}/{len(half_way)}"),
        *([Row(f"`{name}`: the same at 0.3 and 0.7 of the way, and in turbulence",
               successes(more))] if more else []),
        Row(f"`{name}`: contacts but for the fall, whichever dies",
            sum(int(x) for x in numbers(flights, "contacts_other"))),
        Row(f"`{name}`: least height of the load after the loss, as in its file",
            least(as_filed, "lowest_after_m"), "m", "> 0"),
        Row(f"`{name}`: drop of the load in 3 s, worst", most(flights, "drop_m"), "m"),
        Row(f"`{name}`: tilt of the load at the end, as in its file",
            most(as_filed, "tilt_after_deg"), "deg"),
        Row(f"`{name}`: largest thrust / limit", most(flights, "max_thrust_ratio"), "", "<= 1"),
        Row(f"`{name}`: payload RMSE, as in its file", most(as_filed, "tracking_rmse_m"), "m"),
        Row(f"`{name}`: CPU time of a flight, median (range)",
            spread(flights, "compute_cpu_s"), "s"),
    ]  # fmt: skip


def main() -> None:
    """Let every vehicle die once and write the result."""
    args = arguments(__doc__)
    jobs = [
        Job(name, 0, _dies(i), case=f"{name}: vehicle {i} dies", measures=(aftermath,))
        for name, count in TEAMS.items()
        for i in ((FILED,) if args.quick else range(count))
    ]
    kept = None if args.quick else RESULTS / "lost_vehicle.partial.jsonl"
    flown = fly_all(jobs, args.workers, kept)
    report(flown, write=not args.quick)
    if not args.quick:
        report(flown + fly_all(elsewhere(), args.workers, kept), write=True)
    if kept is not None:
        kept.unlink()


def report(flown: list[Flown], *, write: bool) -> None:
    """Print what the flights show, and write the result."""
    result = Result(
        name="lost_vehicle",
        claim="a vehicle dies half way and is released: load and others stay up and reach the goal",
        rows=[row for name in TEAMS for row in rows(chosen(flown, scenario=name), name)],
        flights=flown,
        keys=KEYS,
        notes={},
    )
    publish(result, write=write)


def elsewhere() -> list[Job]:
    """Every vehicle of four dies at other places, and in turbulence of two seeds."""
    name = "lost-vehicle"
    return [
        Job(name, 0, (*_dies(i), f"events[0].at_progress={at}"), case=f"{name}, at {at}: {i}",
            measures=(aftermath,))
        for at in PLACES for i in range(TEAMS[name])
    ] + [
        Job(name, seed, (*_dies(i), *TURBULENCE), case=f"{name}, turbulence: {i}",
            measures=(aftermath,))
        for seed in (1, 2) for i in range(TEAMS[name])
    ]  # fmt: skip


def _dies(vehicle: int) -> tuple[str, ...]:
    return (f"events[0].vehicle={vehicle}",)


if __name__ == "__main__":
    main()
