# SPDX-License-Identifier: Apache-2.0
"""Claim: closing loops leaves less than a third of the error with which a vehicle comes home.

A team flies there and back along a hall, twice each way, and ends where it began: 60 m in a hall of
21 m and 120 m in one of 36 m. Flown on truth; one vehicle's four cameras and its IMU are simulated,
its odometry (the filter) runs causally on them, its keyframes are places, and loops are closed as
they are seen. Errors without any alignment. A closure is false when it is more than 0.3 m or 5 deg
off the truth. What was rendered stays in --work.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from calibration import calibration_s
from numpy.typing import NDArray
from provenance import commit, provenance, write_report
from result_file import Row
from vio_flight_data import FlightJob, Seen, fly_track, seen_of
from vio_flights import NO_EVENTS, start_pose

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.so3 import so3_log
from skyhaul.perception.slam.loops import LoopCloser, LoopMemory, LoopRules, on_map
from skyhaul.perception.vio.vehicle import VehicleVio, rig_of
from skyhaul.perception.vio.warm_up import warm_up
from skyhaul.types import US_PER_S, Array

HALF_M = {60: 7.5, 120: 15.0}
"""Way of the whole flight -> half the length of a lap."""
PERIOD_S_PER_M = 32.0 / 7.5
FALSE_M, FALSE_RAD = 0.3, np.radians(5.0)


def flight_job(way_m: int, seed: int) -> FlightJob:
    """The flight: up to speed, one lap, and to rest again."""
    half = HALF_M[way_m]
    end = half + 3.0
    overrides = (
        NO_EVENTS,
        f"world.room.min_m=[{-end},-4,0]",
        f"world.room.max_m=[{end},4,5]",
        f"world.map.origin_m=[{-end},-4,0]",
        f"world.map.size_m=[{2 * end},8,5]",
        f"task.size_m=[{half},0,0]",
        f"task.period_s={PERIOD_S_PER_M * half}",
        "task.laps=1",
        "time_limit_s=400",
    )
    return FlightJob("figure8", seed, overrides, f"there-and-back-{way_m}")


@dataclass(frozen=True, eq=False)
class Closed:
    """A run with its loops."""

    t_s: Array  # (k,)
    true: Array  # (k, 3) [m]
    alone: Array  # (k, 3) error of the odometry [m]
    mapped: Array  # (k, 3) error on the map [m]
    memory: LoopMemory
    keyframe_s: Array  # CPU time of each keyframe [s]


def follow(closer: LoopCloser, job: FlightJob, seen: Seen, vio: VehicleVio) -> Closed:
    """Odometry and loops of a vehicle, as they come."""
    odometry = vio.build(job.config().sensors.calibration())
    memory, places = odometry.init(start_pose(seen, job.seed, 0)), closer.init()
    rows, cpu = [], []
    for reading in seen.readings():
        memory, e = odometry.step(memory, reading)
        if e is None or e.state is None:
            continue
        if closer.due(places, e):
            begin = time.process_time()
            landmarks = odometry.estimator.landmarks(memory.estimator)
            places = closer.step(places, e, memory.tracker.cameras, landmarks)
            cpu.append(time.process_time() - begin)
        p = true_at(seen, e.stamp_us)[1]
        here = on_map(places, e.state)[0]
        rows.append((e.stamp_us / US_PER_S, *p, *(e.state.p_WI - p), *(here - p)))
    table = np.array(rows)
    parts = (table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7:10])
    return Closed(*parts, places, np.array(cpu))


def true_at(seen: Seen, stamp_us: int) -> tuple[Array, Array]:
    """R_WI and p_WI."""
    t = seen.truth
    k = min(int(np.searchsorted(t.t_us, stamp_us)), len(t.t_us) - 1)
    return quat_to_R(t.q_WI[k]), t.p_WI[k]


def off(memory: LoopMemory, seen: Seen) -> NDArray[np.float64]:
    """How far each loop is off the truth, (k, 2) [m, rad]."""
    rows = []
    for loop in memory.loops:
        (Ra, pa), (Rb, pb) = (true_at(seen, memory.places[k].stamp_us) for k in (loop.i, loop.j))
        turn = so3_log((Ra.T @ Rb).T @ loop.R_ij)
        rows.append((np.linalg.norm(Ra.T @ (pb - pa) - loop.p_ij), np.linalg.norm(turn)))
    return np.array(rows).reshape(-1, 2)


def bytes_of(memory: LoopMemory) -> int:
    """Size of what the places hold."""
    arrays = [
        a
        for p in memory.places
        for a in (p.corners.camera, p.corners.xy, p.corners.descriptor, p.p_IP, p.descriptor)
    ]
    return sum(a.nbytes for a in arrays)


def run(way_m: int, seed: int, work: Path) -> dict[str, Any]:
    """One flight."""
    job, vio = flight_job(way_m, seed), VehicleVio()
    fly_track(job, work)
    seen, calibration = seen_of(job, 0, work), job.config().sensors.calibration()
    odometry = vio.build(calibration)
    warm_up(rig_of(calibration))
    closer = LoopRules().build(rig_of(calibration), odometry.tracker.lenses)
    c = follow(closer, job, seen, vio)
    wrong = off(c.memory, seen)
    false = int(np.count_nonzero((wrong[:, 0] > FALSE_M) | (wrong[:, 1] > FALSE_RAD)))
    alone, mapped = (np.linalg.norm(e, axis=1) for e in (c.alone, c.mapped))
    path_m = float(np.linalg.norm(np.diff(c.true, axis=0), axis=1).sum())
    return {
        "way_m": way_m, "seed": seed, "path_m": path_m,
        "end_alone_m": float(alone[-1]), "end_mapped_m": float(mapped[-1]),
        "end_ratio": float(mapped[-1] / alone[-1]),
        "ate_alone_m": float(np.sqrt(np.mean(alone**2))),
        "ate_mapped_m": float(np.sqrt(np.mean(mapped**2))),
        "places": len(c.memory.places), "loops": len(wrong), "false_loops": false,
        "loop_off_m": float(np.sqrt(np.mean(wrong[:, 0] ** 2))) if len(wrong) else None,
        "loop_off_worst_m": float(wrong[:, 0].max()) if len(wrong) else None,
        "keyframe_ms": 1e3 * float(c.keyframe_s.mean()),
        "keyframe_ms_most": 1e3 * float(c.keyframe_s.max()),
        "cpu_s_per_s": float(c.keyframe_s.sum() / (c.t_s[-1] - c.t_s[0])),
        "map_bytes_per_m": bytes_of(c.memory) / path_m,
        "calibration_s": calibration_s(), "commit": commit(),
    }  # fmt: skip


def rows(way_m: int, runs: list[dict[str, Any]]) -> list[Row]:
    """The lines of one way."""
    n = f"there and back, {way_m} m"

    def of(key: str) -> list[float]:
        return [float(r[key]) for r in runs]

    return [
        Row(f"{n}: flights", len(runs)),
        Row(
            f"{n}: final error over that without loops, RMS over the flights",
            float(np.sqrt(_square(of("end_mapped_m")) / _square(of("end_alone_m")))),
            "",
            "<= 1/3",
        ),
        Row(f"{n}: the same, worst flight", max(of("end_ratio"))),
        Row(f"{n}: final error without loops, mean (worst)", _mean_worst(of("end_alone_m")), "cm"),
        Row(f"{n}: final error with loops, mean (worst)", _mean_worst(of("end_mapped_m")), "cm"),
        Row(f"{n}: RMS over the flight without loops, mean", _mean_worst(of("ate_alone_m")), "cm"),
        Row(f"{n}: RMS over the flight with loops, mean", _mean_worst(of("ate_mapped_m")), "cm"),
        Row(f"{n}: loops closed, mean", float(np.mean(of("loops")))),
        Row(f"{n}: false loops, all flights", int(sum(of("false_loops"))), "", "0"),
        Row(f"{n}: error of a loop, worst", 100 * max(of("loop_off_worst_m")), "cm"),
        Row(f"{n}: a keyframe, mean", float(np.mean(of("keyframe_ms"))), "ms CPU"),
        Row(f"{n}: of a vehicle", float(np.mean(of("cpu_s_per_s"))), "CPU-s/s"),
        Row(f"{n}: the map", float(np.mean(of("map_bytes_per_m"))) / 1e3, "kB/m"),
    ]


def _square(values: list[float]) -> float:
    return float(np.mean(np.square(values)))


def _mean_worst(values: list[float]) -> str:
    return f"{100 * np.mean(values):.1f} ({100 * max(values):.1f})"


def main() -> None:
    """Run all flights and write `results/loop_closure.json`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, default=Path("build/loop_closure"))
    parser.add_argument("--quick", action="store_true", help="60 m, seed 0; writes nothing")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    jobs = [(60, s) for s in range(5)] + [(120, s) for s in range(2)]
    runs = []
    for way_m, seed in jobs[:1] if args.quick else jobs:
        runs.append(run(way_m, seed, args.work))
        print(runs[-1], flush=True)
    table = [
        row
        for way in HALF_M
        if (here := [r for r in runs if r["way_m"] == way])
        for row in rows(way, here)
    ]
    for row in table:
        print(f"{row.measure}: {row.value} {row.unit}  [{row.bar}]")
    if not args.quick:
        report = {
            "claim": (__doc__ or "").splitlines()[0].removeprefix("Claim: ").rstrip("."),
            "rows": [vars(row) for row in table],
            "runs": runs,
            **provenance([r["calibration_s"] for r in runs]),
        }
        print(f"-> {write_report('loop_closure', report)}")


if __name__ == "__main__":
    main()
