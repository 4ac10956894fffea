# SPDX-License-Identifier: Apache-2.0
"""Claim: four cameras hold a vehicle's place where the front pair alone loses it.

Vehicles of `paper`, by the filter with all four cameras and with the front pair alone (as many
corners in all). Twice: as flown, and with a plain wall before the front pair from 8 s to 12 s,
where its images keep a hundredth of their contrast. Takes what `vio_flights.py` rendered in the
same --work, and renders what is missing.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from calibration import calibration_s
from pool import run_all
from provenance import provenance, write_report
from result_file import Row
from vio_flight_data import Seen, fly_track, seen_of
from vio_flights import errors_of, flight_job, fly_odometry, start_pose

from skyhaul.perception.vio.api import VioStatus
from skyhaul.perception.vio.vehicle import VehicleVio
from skyhaul.sensors.api import VehicleReading

FRONT = (0, 1)
PLAIN_S = (8.0, 12.0)


@dataclass(frozen=True, eq=False)
class Some:
    """What some of the cameras saw, of a plain wall for a while."""

    seen: Seen
    cameras: tuple[int, ...]
    plain: bool

    def readings(self) -> Iterator[VehicleReading]:
        """As those of all cameras."""
        rng = np.random.default_rng(5)
        for reading in self.seen.readings():
            frames = []
            for f in reading.frames:
                if f.camera not in self.cameras:
                    continue
                if self.plain and f.camera in FRONT and PLAIN_S[0] <= f.stamp_us / 1e6 < PLAIN_S[1]:
                    grey = 110.0 + 0.01 * (f.image - 110.0) + rng.normal(0.0, 1.0, f.image.shape)
                    f = replace(f, image=np.clip(np.round(grey), 0, 255).astype(np.uint8))
                frames.append(f)
            yield replace(reading, frames=tuple(frames))


Job = tuple[int, int, tuple[int, ...], bool, Path]
"""Seed, vehicle, cameras, whether the wall is plain, work folder."""


def run(what: Job) -> dict[str, Any]:
    """One vehicle with some of its cameras, which come first in the rig."""
    seed, vehicle, cameras, plain, work = what
    job = flight_job("paper", seed)
    seen, calibration = seen_of(job, vehicle, work), job.config().sensors.calibration()
    rig = replace(calibration.rig, cameras=tuple(calibration.rig.cameras[c] for c in cameras))
    odometry = VehicleVio().build(replace(calibration, rig=rig))
    start = start_pose(seen, seed, vehicle)
    estimates, _ = fly_odometry(odometry, Some(seen, cameras, plain), start)
    e, _ = errors_of(estimates, seen)
    off = np.linalg.norm(e.p, axis=1)
    return {
        "seed": seed, "vehicle": vehicle, "cameras": len(cameras), "plain": plain,
        "ate_m": float(np.sqrt(np.mean(off**2))), "ate_max_m": float(off.max()),
        "ate_share": float(np.sqrt(np.mean(off**2)) / e.path_m[-1]),
        "attitude_rms_deg": float(np.degrees(np.sqrt(np.mean(np.sum(e.turn**2, axis=1))))),
        "nees_mean": float(e.nees.mean()),
        "lost_frames": sum(x.status is VioStatus.LOST for x in estimates),
        "calibration_s": calibration_s(),
    }  # fmt: skip


def _fly(flight: tuple[int, Path]) -> bool:
    seed, work = flight
    return fly_track(flight_job("paper", seed), work)


def _render(what: tuple[int, int, Path]) -> None:
    seed, vehicle, work = what
    seen_of(flight_job("paper", seed), vehicle, work)


def rows(runs: list[dict[str, Any]]) -> list[Row]:
    """The lines of the table."""
    table = []
    for plain in (False, True):
        for count in (4, len(FRONT)):
            mine = [r for r in runs if (r["plain"], r["cameras"]) == (plain, count)]
            what = "a plain wall before the front pair for 4 s" if plain else "as flown"
            name = f"{count} cameras, {what}"
            share = 100 * np.array([r["ate_share"] for r in mine])
            far = 100 * max(r["ate_max_m"] for r in mine)
            table += [
                Row(f"{name}: ATE, mean (worst)", f"{share.mean():.2f} ({share.max():.2f})", "%"),
                Row(f"{name}: largest error of the position", far, "cm"),
                Row(f"{name}: frames LOST", sum(r["lost_frames"] for r in mine)),
            ]
    return table


def main() -> None:
    """Run all and write `results/vio_cameras.json`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="flights (default: 2)")
    parser.add_argument("--work", type=Path, default=Path("build/vio_flights"))
    parser.add_argument("--workers", type=int, default=1, help="processes (default: 1)")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    for _ in run_all(_fly, [(seed, args.work) for seed in range(args.seeds)], args.workers):
        pass
    vehicles = [(seed, vehicle) for seed in range(args.seeds) for vehicle in range(4)]
    for _ in run_all(_render, [(s, v, args.work) for s, v in vehicles], args.workers):
        pass
    jobs = [
        (s, v, cameras, plain, args.work)
        for plain in (False, True)
        for cameras in ((0, 1, 2, 3), FRONT)
        for s, v in vehicles
    ]
    done = {}
    for job, figures in run_all(run, jobs, args.workers):
        done[job] = figures
        print({k: round(v, 4) for k, v in figures.items()}, flush=True)
    runs = [done[job] for job in jobs]
    table = rows(runs)
    for row in table:
        print(f"{row.measure}: {row.value} {row.unit}")
    report = {
        "claim": (__doc__ or "").splitlines()[0].removeprefix("Claim: ").rstrip("."),
        "rows": [vars(row) for row in table],
        "runs": runs,
        **provenance([r["calibration_s"] for r in runs]),
    }
    print(f"-> {write_report('vio_cameras', report)}")


if __name__ == "__main__":
    main()
