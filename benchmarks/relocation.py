# SPDX-License-Identifier: Apache-2.0
"""Claim: after 5 s of darkness a vehicle finds its place: a third of the filter's error is left.

The flights of 60 m there and back of `loop_closure.py`. All images of a vehicle are black for 5 s,
once over ground that it has passed before, at three times of each flight; IMU and cameras then go
on. Each time with and without relocalisation; errors without any alignment. A relocation is false
when it leaves more than 0.3 m or 5 deg of error and more than there was. Takes what
`loop_closure.py` rendered in the same --work, and renders what is missing.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from calibration import calibration_s
from loop_closure import FALSE_M, FALSE_RAD, flight_job
from provenance import commit, provenance, write_report
from result_file import Row
from vio_flight_data import Seen, fly_track, seen_of
from vio_flights import Errors, errors_of, start_pose

from skyhaul.perception.vio.api import VioEstimate, VioStatus
from skyhaul.perception.vio.vehicle import VehicleVio, rig_of
from skyhaul.perception.vio.warm_up import warm_up
from skyhaul.sensors.api import VehicleReading
from skyhaul.types import US_PER_S

WAY_M = 60
DARK_S = 5.0
BEGINS_S = (45.0, 57.0, 69.0)
AFTER_S, UNTIL_S = 1.5, 10.0
"""Errors count from then to then after the light has come back."""
CALM_S = 60.0
"""How long the flight without darkness goes that tells what the map costs."""
Kind = Literal["ekf", "smoother"]


@dataclass(frozen=True, eq=False)
class Ran:
    """Estimates of a vehicle and what they took."""

    estimates: tuple[VioEstimate, ...]
    cpu_s_per_s: float
    places: int


def darkened(seen: Seen, begin_s: float, until_s: float) -> Iterator[VehicleReading]:
    """What came in up to a time, black for `DARK_S`."""
    for reading in seen.readings():
        t_s = reading.stamp_us / US_PER_S
        if t_s > until_s:
            return
        frames = reading.frames
        if begin_s <= t_s < begin_s + DARK_S:
            frames = tuple(replace(f, image=np.zeros_like(f.image)) for f in frames)
        yield replace(reading, frames=frames)


def follow(seen: Seen, seed: int, vio: VehicleVio, begin_s: float, until_s: float) -> Ran:
    """The odometry of a vehicle through the dark."""
    odometry = vio.build(flight_job(WAY_M, seed).config().sensors.calibration())
    memory, out, cpu_s = odometry.init(start_pose(seen, seed, 0)), [], 0.0
    for reading in darkened(seen, begin_s, until_s):
        began = time.process_time()
        memory, estimate = odometry.step(memory, reading)
        cpu_s += time.process_time() - began
        if estimate is not None and estimate.state is not None:
            out.append(estimate)
    return Ran(tuple(out), cpu_s / until_s, len(memory.places.places))


def run(seed: int, kind: Kind, begin_s: float, work: Path) -> dict[str, Any]:
    """One darkness, with and without relocalisation."""
    seen, light_s = seen_of(flight_job(WAY_M, seed), 0, work), begin_s + DARK_S
    figures: dict[str, Any] = {"seed": seed, "kind": kind, "dark_from_s": begin_s}
    for name, vio in _with_and_without(kind):
        ran = follow(seen, seed, vio, begin_s, light_s + UNTIL_S)
        e, _ = errors_of(ran.estimates, seen)
        off, after = np.linalg.norm(e.p, axis=1), e.t_s >= light_s + AFTER_S
        figures |= {
            f"{name}_in_the_dark_m": float(off[e.t_s < light_s][-1]),
            f"{name}_after_m": float(np.sqrt(np.mean(off[after] ** 2))),
            f"{name}_after_most_m": float(off[after].max()),
            f"{name}_after_deg": float(
                np.degrees(np.sqrt(np.mean(np.sum(e.turn[after] ** 2, axis=1))))
            ),
            f"{name}_nees": float(e.nees[after].mean()),
            f"{name}_lost": sum(x.status is VioStatus.LOST for x in ran.estimates),
            f"{name}_cpu_s_per_s": ran.cpu_s_per_s,
        }
        if name == "with":
            figures |= _relocations(ran, e, light_s)
    return figures | {"calibration_s": calibration_s(), "commit": commit()}


def _with_and_without(kind: Kind) -> tuple[tuple[str, VehicleVio], tuple[str, VehicleVio]]:
    return ("with", VehicleVio(kind=kind)), ("without", VehicleVio(kind=kind, relocation=None))


def _relocations(ran: Ran, e: Errors, light_s: float) -> dict[str, Any]:
    """When the vehicle was relocated, and how many times to a wrong place."""
    at = [k for k, x in enumerate(ran.estimates) if x.relocated]
    off, turn = np.linalg.norm(e.p, axis=1), np.linalg.norm(e.turn, axis=1)
    false = [
        k
        for k in at
        if (off[k] > FALSE_M and off[k] > off[k - 1])
        or (turn[k] > FALSE_RAD and turn[k] > turn[k - 1])
    ]
    return {
        "relocated": len(at),
        "relocated_after_s": float(e.t_s[at[0]] - light_s) if at else None,
        "off_before_m": float(off[at[0] - 1]) if at else None,
        "off_then_m": float(off[at[0]]) if at else None,
        "false": len(false),
        "places": ran.places,
    }


def calm(seed: int, work: Path) -> dict[str, Any]:
    """What the map costs a vehicle that is never lost, and that it changes nothing."""
    seen = seen_of(flight_job(WAY_M, seed), 0, work)
    a, b = (follow(seen, seed, v, -DARK_S - 1.0, CALM_S) for _, v in _with_and_without("ekf"))
    same = all(
        x.covariance.tobytes() == y.covariance.tobytes()
        and x.state is not None
        and y.state is not None
        and x.state.p_WI.tobytes() == y.state.p_WI.tobytes()
        for x, y in zip(a.estimates, b.estimates, strict=True)
    )
    cost = a.cpu_s_per_s - b.cpu_s_per_s
    return {"seed": seed, "kind": "ekf", "same": same, "map_cpu_s_per_s": cost, "places": a.places}


def rows(kind: Kind, runs: list[dict[str, Any]]) -> list[Row]:
    """The lines of one estimator."""

    def of(key: str) -> list[float]:
        return [float(r[key]) for r in runs if r[key] is not None]

    def rms(key: str) -> float:
        return float(np.sqrt(np.mean(np.square(of(key)))))

    def after(name: str) -> str:
        most = max(of(f"{name}_after_most_m"))
        return f"{100 * rms(f'{name}_after_m'):.1f} ({100 * most:.1f})"

    found = sum(r["relocated"] > 0 for r in runs)
    left = rms("with_after_m") / rms("without_after_m")
    delay_s = float(np.median(of("relocated_after_s")))
    turned = f"{rms('with_after_deg'):.2f}, {rms('without_after_deg'):.2f}"
    nees = f"{np.mean(of('with_nees')):.1f}, {np.mean(of('without_nees')):.1f}"
    return [
        Row(f"{kind}: darknesses of 5 s", len(runs)),
        Row(f"{kind}: relocated", found),
        Row(f"{kind}: relocated to a wrong place", int(sum(of("false"))), "", "0"),
        Row(f"{kind}: time from light to relocation, median", delay_s, "s"),
        Row(f"{kind}: error when light comes back, RMS", 100 * rms("with_in_the_dark_m"), "cm"),
        Row(f"{kind}: error at the relocation, RMS", 100 * rms("off_then_m"), "cm"),
        Row(f"{kind}: error after with relocation, RMS (largest)", after("with"), "cm"),
        Row(f"{kind}: error after without, RMS (largest)", after("without"), "cm"),
        Row(f"{kind}: the first over the second", left, "", "<= 1/3" if kind == "ekf" else ""),
        Row(f"{kind}: attitude after, with and without", turned, "deg"),
        Row(f"{kind}: NEES of the pose after, with and without", nees),
    ]


def main() -> None:
    """Run all and write `results/relocation.json`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="flights (default: 3)")
    parser.add_argument("--kinds", default="ekf,smoother", help="estimators (default: both)")
    parser.add_argument("--work", type=Path, default=Path("build/loop_closure"))
    parser.add_argument("--quick", action="store_true", help="one darkness; writes nothing")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    seeds = range(1 if args.quick else args.seeds)
    begins_s = BEGINS_S[:1] if args.quick else BEGINS_S
    warm_up(rig_of(flight_job(WAY_M, 0).config().sensors.calibration()))
    for seed in seeds:
        fly_track(flight_job(WAY_M, seed), args.work)
    runs, table = [], []
    for kind in args.kinds.split(","):
        mine = []
        for seed in seeds:
            for begin_s in begins_s:
                mine.append(run(seed, kind, begin_s, args.work))
                print(mine[-1], flush=True)
        runs += mine
        table += rows(kind, mine)
    still = [calm(seed, args.work) for seed in seeds]
    cost = float(np.median([c["map_cpu_s_per_s"] for c in still]))
    same = f"{sum(c['same'] for c in still)}/{len(still)}"
    table += [
        Row("never lost: flights whose estimates the map leaves as they are", same, "", "all"),
        Row("never lost: the map of a vehicle, median", cost, "CPU-s/s"),
    ]
    for row in table:
        print(f"{row.measure}: {row.value} {row.unit}  [{row.bar}]")
    if not args.quick:
        report = {
            "claim": (__doc__ or "").splitlines()[0].removeprefix("Claim: ").rstrip("."),
            "rows": [vars(row) for row in table],
            "runs": [*runs, *still],
            **provenance([r["calibration_s"] for r in runs]),
        }
        print(f"-> {write_report('relocation', report)}")


if __name__ == "__main__":
    main()
