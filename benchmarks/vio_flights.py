# SPDX-License-Identifier: Apache-2.0
"""Claim: on flights of `paper` each vehicle knows where it is to 1 % of its path, and how well.

Flown on truth; cameras and IMU of every vehicle are simulated, its odometry runs causally on them.
The start is surveyed (1 mm, 1 mrad, errors drawn), the vehicle stands for the first 0.1 s, which it
is told. ATE without any alignment, as a share of the path; attitude; NEES of the pose, 6 is ideal.

Cases: `paper`; `hover` for 30 s; `dark`; `blackout`: three of four cameras fail for a second, two
of them dropped, one frozen. What was rendered stays in --work, what was run in a file there, so
that a benchmark that was broken off goes on.
"""

import argparse
import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from calibration import calibration_s
from pool import run_all
from provenance import commit, provenance, write_report
from result_file import Row
from vio_flight_data import FlightJob, Seen, fly_track, seen_of

from skyhaul.evaluation.trajectory_error import Trajectory, match, trajectory_error
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.so3 import so3_log
from skyhaul.perception.vio.api import StartPose, VioEstimate, VioStatus
from skyhaul.perception.vio.vehicle import VehicleOdometry, VehicleVio
from skyhaul.perception.vio.warm_up import warm_up
from skyhaul.types import US_PER_S, Array

NO_EVENTS = "sensors.rig.event_camera=null"
BLACKOUT_S, DARK_S = 10.0, 10.0
STANDS_US = 100_000
SURVEY_M, SURVEY_RAD = 1e-3, 1e-3
NEES_BAND, NEES_BOUND = (3.0, 9.0), 12.59
VEHICLES = range(4)


def _blackout() -> str:
    """Three cameras of every vehicle fail."""
    kinds = (
        ("front right", "dropped-frames"),
        ("rear", "dropped-frames"),
        ("down", "frozen-camera"),
    )
    faults = [
        {"kind": kind, "vehicle": v, "camera": camera, "start_s": BLACKOUT_S, "duration_s": 1.0}
        for v in VEHICLES
        for camera, kind in kinds
    ]
    return f"sensors.faults={json.dumps(faults)}"


CASES = {
    "paper": ("paper", (NO_EVENTS,)),
    "hover": ("hover", (NO_EVENTS, "task.duration_s=30", "time_limit_s=40")),
    "dark": ("dark", (NO_EVENTS,)),
    "blackout": ("paper", (NO_EVENTS, _blackout())),
}
EVENT_S = {"blackout": BLACKOUT_S + 1.0, "dark": DARK_S}
"""When an event is over after which the bars must hold again 3 s later."""


class Timed:
    """Something, and the CPU time of every call of one of its methods."""

    def __init__(self, inner: Any, method: str = "step") -> None:  # noqa: ANN401
        self.inner, self.method, self.cpu_s = inner, method, list[float]()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        """What the inner one has, timed where it is the method."""
        return self._call if name == self.method else getattr(self.inner, name)

    def _call(self, *args: Any) -> Any:  # noqa: ANN401
        began = time.process_time()
        out = getattr(self.inner, self.method)(*args)
        self.cpu_s.append(time.process_time() - began)
        return out


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of a run at its estimates."""

    t_s: Array  # (n,)
    p: Array  # (n, 3) true less estimated position [m]
    turn: Array  # (n, 3) the same of the attitude [rad]
    nees: Array  # (n,)
    path_m: Array  # (n,) flown so far


def start_pose(seen: Seen, seed: int, vehicle: int) -> StartPose:
    """The first pose as it was surveyed."""
    rng = np.random.default_rng([seed, vehicle, 77])
    R = quat_to_R(seen.truth.q_WI[0])
    p = seen.truth.p_WI[0] + SURVEY_M * rng.normal(size=3)
    yaw = math.atan2(R[1, 0], R[0, 0]) + SURVEY_RAD * rng.normal()
    return StartPose(p, yaw, SURVEY_M, SURVEY_RAD, STANDS_US)


def fly_odometry(
    odometry: VehicleOdometry, seen: Seen, start: StartPose
) -> tuple[list[VioEstimate], list[int]]:
    """All estimates of a vehicle, and when the readings had come that made them [us]."""
    memory, out, came_us = odometry.init(start), [], []
    for reading in seen.readings():
        memory, estimate = odometry.step(memory, reading)
        if estimate is not None:
            out.append(estimate)
            came_us.append(reading.stamp_us)
    return out, came_us


def odometry_file(work: Path, kind: str, case: str, seed: int, vehicle: int) -> Path:
    """Where the estimates of a vehicle are kept, as `team_odometry.from_file` reads them."""
    return work / f"odometry-{kind}" / f"{case}_{seed}_vehicle{vehicle}.npz"


def keep_estimates(path: Path, estimates: Sequence[VioEstimate], came_us: Sequence[int]) -> None:
    """Write the estimates that have a state."""
    both = zip(estimates, came_us, strict=True)
    rows = [(e, e.state, t) for e, t in both if e.state is not None]
    part = path.with_suffix(".part.npz")
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(
        part,
        stamp_us=np.array([e.stamp_us for e, _, _ in rows]),
        came_us=np.array([t for _, _, t in rows]),
        p_WI=np.array([s.p_WI for _, s, _ in rows]),
        q_WI=np.array([s.q_WI for _, s, _ in rows]),
        v_WI=np.array([s.v_WI for _, s, _ in rows]),
        gyro_bias=np.array([s.gyro_bias for _, s, _ in rows]),
        accel_bias=np.array([s.accel_bias for _, s, _ in rows]),
        covariance=np.array([e.covariance for e, _, _ in rows]),
        tracking=np.array([e.status is VioStatus.TRACKING for e, _, _ in rows]),
    )
    part.replace(path)


def errors_of(estimates: Sequence[VioEstimate], seen: Seen) -> tuple[Errors, Any]:
    """Errors without alignment, and the pairs of poses."""
    known = [e for e in estimates if e.state is not None]
    stamps = np.array([1000 * e.stamp_us for e in known])
    states = [e.state for e in known]
    path = Trajectory(
        stamps, np.array([s.p_WI for s in states]), np.array([s.q_WI for s in states])
    )
    truth = Trajectory(1000 * seen.truth.t_us, seen.truth.p_WI, seen.truth.q_WI)
    pairs = match(path, truth)
    R_hat, R = quat_to_R(pairs.estimate.q), quat_to_R(pairs.truth.q)
    p = pairs.truth.p - pairs.estimate.p
    turn = so3_log(np.swapaxes(R_hat, 1, 2) @ R)
    covariance = np.array([e.covariance[:6, :6] for e in known])[pairs.row]
    e = np.hstack([p, turn])
    nees = np.einsum("ni,ni->n", e, np.linalg.solve(covariance, e[:, :, None])[:, :, 0])
    steps = np.linalg.norm(np.diff(pairs.truth.p, axis=0, prepend=pairs.truth.p[:1]), axis=1)
    return Errors(pairs.truth.time_ns / 1e9, p, turn, nees, np.cumsum(steps)), pairs


def run(case: str, seed: int, vehicle: int, vio: VehicleVio, work: Path) -> dict[str, Any]:
    """One vehicle of one flight."""
    job = flight_job(case, seed)
    seen, sensors = seen_of(job, vehicle, work), job.config().sensors
    built = vio.build(sensors.calibration())
    warm_up(built.estimator.rig)
    cv2.setNumThreads(1)  # CPU time of one core: OpenCV's idle threads would count as well
    odometry = replace(
        built,
        tracker=Timed(built.tracker),
        estimator=Timed(built.estimator),
        relocaliser=Timed(built.relocaliser, "follow"),
    )
    estimates, came_us = fly_odometry(odometry, seen, start_pose(seen, seed, vehicle))
    keep_estimates(odometry_file(work, vio.kind, case, seed, vehicle), estimates, came_us)
    e, pairs = errors_of(estimates, seen)
    none, se3 = trajectory_error(pairs, "none"), trajectory_error(pairs, "se3")
    path_m, angle = float(e.path_m[-1]), np.degrees(np.linalg.norm(e.turn, axis=1))
    duration_s = (estimates[-1].stamp_us - estimates[0].stamp_us) / US_PER_S
    chosen = vio.ekf if vio.kind == "ekf" else vio.smoother
    front, back, places = (
        np.array(part.cpu_s)
        for part in (odometry.tracker, odometry.estimator, odometry.relocaliser)
    )
    off = np.linalg.norm(e.p, axis=1)
    figures = {
        "case": case, "seed": seed, "vehicle": vehicle, "kind": vio.kind,
        "path_m": path_m,
        "ate_m": none.ate_m, "ate_share": none.ate_m / path_m, "ate_max_m": none.ate_max_m,
        "ate_se3_m": se3.ate_m, "drift_end_m": float(off[-1]),
        "attitude_rms_deg": float(np.sqrt(np.mean(angle**2))),
        "attitude_max_deg": float(angle.max()),
        "nees_mean": float(e.nees.mean()),
        "nees_under_95_bound": float(np.mean(e.nees < NEES_BOUND)),
        "first_state_s": float(e.t_s[0]),
        "frames": len(estimates),
        "lost_frames": sum(x.status is VioStatus.LOST for x in estimates),
        "tracking_ms_per_frame": 1e3 * float(front.mean()),
        "back_end_ms_per_keyframe": 1e3 * float(back.sum()) * chosen.keyframe_s / duration_s,
        "back_end_ms_p95": 1e3 * float(np.quantile(back, 0.95)),
        "cpu_s_per_s": float(front.sum() + back.sum() + places.sum()) / duration_s,
        "nees": _curve(e.t_s, e.nees),
        "calibration_s": calibration_s(), "commit": commit(),
    }  # fmt: skip
    if case in EVENT_S:
        late = e.t_s >= EVENT_S[case] + 3.0
        share = np.sqrt(np.mean(off[late] ** 2)) / path_m
        figures["after_event_ate_share"] = float(share)
        figures["after_event_attitude_deg"] = float(np.sqrt(np.mean(angle[late] ** 2)))
    return figures


def _curve(t_s: Array, values: Array) -> list[float]:
    """Mean in each second, from the first one on; short seconds at the end are left out."""
    return [float(values[(t_s >= k) & (t_s < k + 1)].mean()) for k in range(int(t_s[-1]))]


def nees_over_time(runs: Sequence[dict[str, Any]]) -> Array:
    """Mean over the runs in each second that all of them have."""
    length = min(len(r["nees"]) for r in runs)
    mean: Array = np.mean([r["nees"][:length] for r in runs], axis=0)
    return mean


def rows(case: str, runs: Sequence[dict[str, Any]]) -> list[Row]:
    """The lines of the table of a case."""
    n, seeds = f"{case}, {runs[0]['kind']}", sorted({r["seed"] for r in runs})

    def of(key: str) -> Array:
        return np.array([r[key] for r in runs])

    team = [np.mean([r["ate_share"] for r in runs if r["seed"] == s]) for s in seeds]
    cpu = [sum(r["cpu_s_per_s"] for r in runs if r["seed"] == s) for s in seeds]
    curve = nees_over_time(runs)
    inside = (curve >= NEES_BAND[0]) & (curve <= NEES_BAND[1])
    out = [
        Row(f"{n}: flights, vehicles", f"{len(seeds)}, {len(runs)}"),
        Row(f"{n}: ATE without alignment, worst vehicle", 100 * of("ate_share").max(), "%", "<= 1"),
        Row(f"{n}: the same, worst mean of a team", 100 * max(team), "%", "<= 0.5"),
        Row(f"{n}: ATE, mean of all", 100 * of("ate_m").mean(), "cm"),
        Row(f"{n}: ATE after SE3 alignment, mean", 100 * of("ate_se3_m").mean(), "cm"),
        Row(f"{n}: largest error of the position", 100 * of("ate_max_m").max(), "cm"),
        Row(
            f"{n}: error at the end, worst",
            100 * of("drift_end_m").max(), "cm", "<= 5" if case == "hover" else "",
        ),
        Row(f"{n}: attitude RMS, worst vehicle", of("attitude_rms_deg").max(), "deg", "<= 1"),
        Row(f"{n}: attitude, largest", of("attitude_max_deg").max(), "deg"),
        Row(f"{n}: frames LOST", int(of("lost_frames").sum()), "", "0"),
        Row(f"{n}: mean NEES of the pose", of("nees_mean").mean()),
        Row(
            f"{n}: seconds with mean NEES in 3 .. 9",
            float(inside.mean()), "", ">= 0.9" if case == "paper" else "",
        ),
        Row(f"{n}: share under the 95 % bound", of("nees_under_95_bound").mean()),
        Row(f"{n}: tracking, median", np.median(of("tracking_ms_per_frame")), "ms/frame", "<= 8"),
        Row(
            f"{n}: back end, median",
            np.median(of("back_end_ms_per_keyframe")), "ms/keyframe", "<= 25",
        ),
        Row(f"{n}: four vehicles together, median", np.median(cpu), "CPU-s/s", "<= 0.6"),
    ]  # fmt: skip
    if of("path_m").max() < 1.0:  # a share of no path says nothing
        out = [row for row in out if row.unit != "%"]
    if case in EVENT_S:
        share, angle = of("after_event_ate_share"), of("after_event_attitude_deg")
        out += [
            Row(f"{n}: ATE from 3 s after the event on, worst", 100 * share.max(), "%", "<= 1"),
            Row(f"{n}: the same of the attitude", angle.max(), "deg", "<= 1"),
        ]
    return [
        replace(r, value=float(r.value)) if isinstance(r.value, np.floating) else r for r in out
    ]


Job = tuple[str, int, int, Literal["smoother", "ekf"]]
"""Case, seed, vehicle, estimator."""


def run_jobs(jobs: Sequence[Job], work: Path, workers: int) -> Iterator[tuple[Job, dict[str, Any]]]:
    """Fly what has not been flown, then run each vehicle; figures as they are done."""
    flights = list(dict.fromkeys((case, seed) for case, seed, _, _ in jobs))
    for (case, seed, _), new in run_all(_fly, [(c, s, work) for c, s in flights], workers):
        if new:
            print(f"{case} seed {seed}: flown", flush=True)
    for (job, _), figures in run_all(_run, [(job, work) for job in jobs], workers):
        yield job, figures


def flight_job(case: str, seed: int) -> FlightJob:
    """The flight of a case."""
    scenario, overrides = CASES[case]
    return FlightJob(scenario, seed, overrides, case)


def _fly(flight: tuple[str, int, Path]) -> bool:
    case, seed, work = flight
    return fly_track(flight_job(case, seed), work)


def _run(job: tuple[Job, Path]) -> dict[str, Any]:
    (case, seed, vehicle, kind), work = job
    return run(case, seed, vehicle, VehicleVio(kind=kind), work)


def arguments() -> argparse.Namespace:
    """The flags."""
    parser = argparse.ArgumentParser(description=__doc__)
    every = ",".join(CASES)
    parser.add_argument("--cases", default=every, help=f"comma-separated (default: {every})")
    parser.add_argument("--seeds", default="0-9", help="first-last, each `paper` (default: 0-9)")
    parser.add_argument("--few", type=int, default=1, help="seeds of the other cases (default: 1)")
    parser.add_argument("--kinds", default="ekf,smoother", help="estimators (default: both)")
    parser.add_argument("--vehicles", default="0,1,2,3", help="comma-separated")
    parser.add_argument("--name", default="vio_flights", help="of the result file")
    parser.add_argument(
        "--work", type=Path, default=Path("build/vio_flights"), help="folder of what is kept"
    )
    parser.add_argument("--workers", type=int, default=1, help="processes (default: 1)")
    parser.add_argument("--quick", action="store_true", help="seed 0, vehicle 0; writes nothing")
    return parser.parse_args()


def main() -> None:
    """Run what is missing and write `results/vio_flights.json`."""
    args = arguments()
    args.work.mkdir(parents=True, exist_ok=True)
    first, _, last = args.seeds.partition("-")
    seeds = range(int(first), int(last or first) + 1)
    vehicles = [int(v) for v in args.vehicles.split(",")]
    if args.quick:
        seeds, vehicles = range(1), [0]
    kept = args.work / f"{args.name}.jsonl"
    done = {} if args.quick or not kept.is_file() else _read(kept)
    cases, kinds = args.cases.split(","), args.kinds.split(",")
    jobs = [
        (c, s, v, k)
        for c in cases
        for s in (seeds if c == "paper" else seeds[: args.few])
        for v in vehicles
        for k in kinds
    ]
    for job, figures in run_jobs([j for j in jobs if j not in done], args.work, args.workers):
        done[job] = figures
        _print(figures)
        if not args.quick:
            with kept.open("a") as file:
                file.write(json.dumps(done[job]) + "\n")
    table = [
        row
        for case in cases
        for kind in kinds
        for row in rows(case, [done[j] for j in jobs if (j[0], j[3]) == (case, kind)])
    ]
    for row in table:
        print(f"{row.measure}: {row.value} {row.unit}  [{row.bar}]")
    if not args.quick:
        report = {
            "claim": (__doc__ or "").splitlines()[0].removeprefix("Claim: ").rstrip("."),
            "rows": [vars(row) for row in table],
            "runs": [done[j] for j in jobs],
            **provenance([done[j]["calibration_s"] for j in jobs]),
        }
        print(f"-> {write_report(args.name, report)}")


def _read(kept: Path) -> dict[Job, dict[str, Any]]:
    runs = [json.loads(line) for line in kept.read_text().splitlines()]
    return {(r["case"], r["seed"], r["vehicle"], r["kind"]): r for r in runs}


def _print(r: dict[str, Any]) -> None:
    print(
        f"{r['case']} seed {r['seed']} vehicle {r['vehicle']} {r['kind']}: "
        f"ATE {100 * r['ate_m']:.1f} cm = {100 * r['ate_share']:.2f} % of {r['path_m']:.1f} m, "
        f"attitude {r['attitude_rms_deg']:.2f} deg (max {r['attitude_max_deg']:.2f}), "
        f"NEES {r['nees_mean']:.1f}, lost {r['lost_frames']}, "
        f"{r['tracking_ms_per_frame']:.1f} + {r['back_end_ms_per_keyframe']:.1f} ms "
        f"(calibration {r['calibration_s']:.2f} s)",
        flush=True,
    )


if __name__ == "__main__":
    main()
