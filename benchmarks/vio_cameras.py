# SPDX-License-Identifier: Apache-2.0
"""Claim: four cameras hold a vehicle's place where the front pair alone loses it.

Vehicles of `paper`, by the filter with all four cameras and with the front pair alone (as many
corners in all). Twice: as flown, and with a plain wall before the front pair from 8 s to 12 s,
where its images keep a hundredth of their contrast. Needs what `vio_flights.py` rendered.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from calibration import calibration_s
from provenance import provenance, write_report
from result_file import Row
from vio_flight_data import FlightJob, Seen, seen_of
from vio_flights import CASES, errors_of, fly_odometry, start_pose

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


def run(
    seed: int, vehicle: int, cameras: tuple[int, ...], plain: bool, work: Path
) -> dict[str, Any]:
    """One vehicle with some of its cameras, which come first in the rig."""
    scenario, overrides = CASES["paper"]
    job = FlightJob(scenario, seed, overrides, "paper")
    seen, calibration = seen_of(job, vehicle, work), job.config().sensors.calibration()
    rig = replace(calibration.rig, cameras=tuple(calibration.rig.cameras[c] for c in cameras))
    odometry = VehicleVio().build(replace(calibration, rig=rig))
    estimates = fly_odometry(odometry, Some(seen, cameras, plain), start_pose(seen, seed, vehicle))
    e, _ = errors_of(estimates, seen)
    off = np.linalg.norm(e.p, axis=1)
    return {
        "seed": seed, "vehicle": vehicle, "cameras": len(cameras), "plain": plain,
        "ate_m": float(np.sqrt(np.mean(off**2))), "ate_max_m": float(off.max()),
        "ate_share": float(np.sqrt(np.mean(off**2)) / e.path_m[-1]),
        "attitude_rms_deg": float(np.degrees(np.sqrt(np.mean(np.sum(e.turn**2, axis=1))))),
        "nees_mean": float(e.nees.mean()),
        "lost_frames": sum(x.status is VioStatus.LOST for x in estimates),
    }  # fmt: skip


def main() -> None:
    """Run all and write `results/vio_cameras.json`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="flights (default: 2)")
    parser.add_argument("--work", type=Path, default=Path("build/vio_flights"))
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    runs, timed, table = [], [calibration_s()], []
    for plain in (False, True):
        for cameras in ((0, 1, 2, 3), FRONT):
            mine = []
            for seed in range(args.seeds):
                for vehicle in range(4):
                    mine.append(run(seed, vehicle, cameras, plain, args.work))
                    print({k: round(v, 4) for k, v in mine[-1].items()}, flush=True)
            what = "a plain wall before the front pair for 4 s" if plain else "as flown"
            name = f"{len(cameras)} cameras, {what}"
            share = 100 * np.array([r["ate_share"] for r in mine])
            lost = sum(r["lost_frames"] for r in mine)
            table += [
                Row(f"{name}: ATE, mean (worst)", f"{share.mean():.2f} ({share.max():.2f})", "%"),
                Row(
                    f"{name}: largest error of the position",
                    100 * max(r["ate_max_m"] for r in mine), "cm",
                ),
                Row(f"{name}: frames LOST", lost),
            ]  # fmt: skip
            runs += mine
            timed.append(calibration_s())
    for row in table:
        print(f"{row.measure}: {row.value} {row.unit}")
    report = {
        "claim": (__doc__ or "").splitlines()[0].removeprefix("Claim: ").rstrip("."),
        "rows": [vars(row) for row in table],
        "runs": runs,
        **provenance(timed),
    }
    print(f"-> {write_report('vio_cameras', report)}")


if __name__ == "__main__":
    main()
