# SPDX-License-Identifier: Apache-2.0
"""Claim: the team's filter knows the load to 5 cm and 2 deg, cables to 2 deg and 5 % of tension.

Recorded flights (`team_recordings`), their sensors simulated, the tag found in real images; the
vehicles' odometry is exact (`--vio perfect`), has errors of a model (`model`) or is real
(`estimated`): that of `vio_flights.py` on simulated cameras, made here where it is missing.
Cases besides the flights: a vehicle that dies, a tag that nobody sees for 3 s, one odometry that
drifts five times as fast, a load's IMU that is silent for 0.5 s.
"""

import argparse
import hashlib
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from calibration import calibration_s
from pool import run_all
from provenance import provenance, write_report
from result_file import Row
from team_odometry import drifting, from_file, modelled, places
from team_recordings import Recording, record
from vio_flight_data import track_file
from vio_flights import VEHICLES, flight_job, odometry_file, run_jobs

import skyhaul.mission.odometry as odometry_model
import skyhaul.perception.team
from skyhaul.geometry.quaternion import quat_conj, quat_log, quat_mul
from skyhaul.mission.odometry import ModelledOdometry, without_errors
from skyhaul.perception.api import TeamEstimate
from skyhaul.perception.team.api import SurveyedTeam, TagSight, TeamReports, VehicleReport
from skyhaul.perception.team.fused import FusedEstimator, FusedTeam
from skyhaul.perception.vio.api import VioEstimate
from skyhaul.sensors.api import ImuReading
from skyhaul.types import Array, TimeUs

NO_IMU = ImuReading(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))
THRUST_SCALE, THRUST_NOISE_N = 0.01, 0.01
"""Error of the thrust told by rotor speeds: of its scale, and white [N] (ours)."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A flight and what goes wrong with its sensors."""

    scenario: str = "paper"
    seed: int = 0
    vio: str = "model"
    hidden_s: tuple[float, float] | None = None  # nobody sees the tag
    drifting: int = -1
    silent_s: tuple[float, float] | None = None  # the load's IMU is silent

    @property
    def name(self) -> str:
        """For the result file."""
        parts = [self.scenario, str(self.seed), self.vio]
        parts += ["hidden"] if self.hidden_s else []
        parts += ["drifting"] if self.drifting >= 0 else []
        parts += ["silent"] if self.silent_s else []
        return " ".join(parts)


def odometry(
    recording: Recording, case: Case, files: Path | None
) -> list[Iterator[tuple[TimeUs, VioEstimate]]]:
    """Odometry of every vehicle, and when it comes."""
    n, model = recording.config.team.count, ModelledOdometry()
    if case.vio == "perfect":
        model = without_errors(model)
    if case.vio != "estimated":
        models = [drifting(model) if i == case.drifting else model for i in range(n)]
        return [modelled(recording, i, models[i]) for i in range(n)]
    if files is None:
        raise ValueError("estimated odometry needs a folder with <flight>_vehicle<i>.npz")
    return [from_file(files / f"{recording.name}_vehicle{i}.npz") for i in range(n)]


def surveyed(recording: Recording) -> SurveyedTeam:
    """Where the team stands at the start."""
    track, rng = recording.track, np.random.default_rng([recording.seed, 78])
    slip = 0.005 * rng.standard_normal(3)
    turn = np.array([0.0, 0.0, 0.01 * rng.standard_normal()])
    q = quat_mul(track.q_WL[0], np.array([1.0, *(0.5 * turn)]))
    q = q / np.linalg.norm(q)
    return SurveyedTeam(track.p_WL[0] + slip, q, track.p_WB[0].copy(), track.q_WB[0].copy())


def estimator(recording: Recording, params: FusedTeam | None = None) -> FusedEstimator:
    """The filter for a recorded flight."""
    sensors, team = recording.config.sensors, recording.config.team
    tag = sensors.tag(team)
    assert tag is not None
    imu = sensors.payload_imu.calibration()
    start = surveyed(recording)
    return (params or FusedTeam()).build(team, sensors.calibration(), imu, tag, start)


def reports(recording: Recording, case: Case, files: Path | None = None) -> Iterator[TeamReports]:
    """What the estimator gets, tick by tick."""
    track, n = recording.track, recording.config.team.count
    rng = np.random.default_rng([recording.seed, 79])
    thrust = track.rotor_thrust.sum(axis=2) * (1.0 + THRUST_SCALE * rng.standard_normal(n))
    thrust += THRUST_NOISE_N * rng.standard_normal(thrust.shape)
    load = {int(row[0]): row[1:] for row in recording.load_imu}
    rows = zip(recording.tag_us, recording.tag_vehicle, recording.tag_px, strict=True)
    tags = {(int(t), int(i)): px for t, i, px in rows}
    streams = odometry(recording, case, files)
    waiting = [next(s, None) for s in streams]
    period_us = 1_000_000 // recording.config.sensors.payload_imu.rate_hz
    for k in range(len(track)):
        t_us, vehicles = 2_000 * k, []
        hidden = case.hidden_s is not None and case.hidden_s[0] <= 1e-6 * t_us < case.hidden_s[1]
        silent = case.silent_s is not None and case.silent_s[0] <= 1e-6 * t_us < case.silent_s[1]
        for i in range(n):
            imu, vio, tag = NO_IMU, None, None
            if k:
                row = recording.vehicle_imu[k, i]
                imu = ImuReading(np.array([t_us - 1_000]), row[None, :3], row[None, 3:])
            if (next_one := waiting[i]) is not None and next_one[0] <= t_us:
                vio, waiting[i] = next_one[1], next(streams[i], None)
            if not hidden and (t_us, i) in tags:
                tag = TagSight(t_us, 0, tags[t_us, i].copy())
            attached = bool(track.attached[k, i])
            vehicles.append(VehicleReport(imu, vio, tag, float(thrust[k, i]), attached))
        load_imu = NO_IMU
        if t_us in load and not silent:
            row = load[t_us]
            load_imu = ImuReading(np.array([t_us - period_us // 2]), row[None, :3], row[None, 3:])
        yield TeamReports(t_us, tuple(vehicles), load_imu)


@dataclass(eq=False)
class Errors:
    """Errors at every tick of a flight."""

    load: list[Array] = field(default_factory=list)  # (12,)
    nees: list[float] = field(default_factory=list)
    rows: list[Array] = field(default_factory=list)  # (n, 6) see `_cable_errors`
    vehicles: list[Array] = field(default_factory=list)  # (n, 3) of positions in the team's frame
    odometry: list[Array] = field(default_factory=list)  # (n, 3) of the odometry's last positions
    cpu_s: float = 0.0
    tally: Array = field(default_factory=lambda: np.zeros(4))


def run(
    recording: Recording,
    case: Case,
    files: Path | None = None,
    params: FusedTeam | None = None,
    watch: Callable[[int, FusedEstimator, Any, TeamEstimate], None] | None = None,
) -> Errors:
    """Run the filter over a flight."""
    filter_, errors = estimator(recording, params), Errors()
    memory, own = filter_.init(), np.zeros((recording.config.team.count, 3))
    for k, reading in enumerate(reports(recording, case, files)):
        begin = time.process_time()
        memory, estimate = filter_.step(memory, reading)
        errors.cpu_s += time.process_time() - begin
        for i, v in enumerate(reading.vehicles):
            if v is not None and v.vio is not None and v.vio.state is not None:
                own[i] = v.vio.state.p_WI - places(recording, i)[k]
        errors.odometry.append(own.copy())
        _score(recording, k, estimate, errors)
        if watch is not None:
            watch(k, filter_, memory, estimate)
    errors.tally = memory.state.tally.copy()
    return errors


def _score(recording: Recording, k: int, estimate: TeamEstimate, errors: Errors) -> None:
    track, team, cables = recording.track, estimate.team, estimate.cables
    turn = quat_log(quat_mul(quat_conj(team.q_WL), track.q_WL[k]))
    e = np.concatenate(
        [track.p_WL[k] - team.p_WL, turn, track.v_WL[k] - team.v_WL, track.w_WL_L[k] - team.w_WL_L]
    )
    errors.load.append(e)
    if k % 25 == 0:
        errors.nees.append(float(e @ np.linalg.solve(estimate.load_covariance, e)))
    cosine = np.clip(np.sum(cables.dir_W * track.cable_dir_W[k], axis=1), -1.0, 1.0)
    rate = np.linalg.norm(cables.w_W - track.cable_w_W[k], axis=1)
    errors.rows.append(
        np.column_stack(
            [np.arccos(cosine), rate, cables.tension, track.tension[k], track.attached[k],
             track.length[k]]
        )
    )  # fmt: skip
    errors.vehicles.append(team.p_WB - track.p_WB[k])


def summary(recording: Recording, errors: Errors) -> dict[str, float]:
    """Figures of one flight."""
    e, c = np.array(errors.load), np.array(errors.rows)
    held, truly, said = c[..., 4] > 0, c[..., 3] > 0.0, c[..., 2] > 0.0
    air = np.arange(len(e)) >= int(np.argmax(np.all(truly | ~held, axis=1)))
    taut = truly & held
    gap = (c[..., 2] - c[..., 3])[taut]
    pull = c[..., 3][taut]
    strong = pull > 0.1
    seconds = 2e-3 * len(e)
    rms = lambda x: float(np.sqrt(np.mean(np.square(x))))  # noqa: E731
    vehicles, own = np.array(errors.vehicles), np.array(errors.odometry)
    apart = lambda x: np.linalg.norm(x - _mean(x, held), axis=2)[held]  # noqa: E731
    return {
        "position_rmse_m": rms(np.linalg.norm(e[:, :3], axis=1)),
        "position_max_m": float(np.linalg.norm(e[:, :3], axis=1).max()),
        "position_end_m": float(np.linalg.norm(e[-1, :3])),
        "attitude_rmse_deg": float(np.degrees(rms(np.linalg.norm(e[:, 3:6], axis=1)))),
        "attitude_max_deg": float(np.degrees(np.linalg.norm(e[:, 3:6], axis=1).max())),
        "velocity_rmse_mps": rms(np.linalg.norm(e[:, 6:9], axis=1)),
        "rate_rmse_radps": rms(np.linalg.norm(e[:, 9:], axis=1)),
        "cable_direction_rmse_deg": float(np.degrees(rms(c[..., 0][taut]))),
        "cable_direction_max_deg": float(np.degrees(c[..., 0][taut].max())),
        "cable_rate_rmse_radps": rms(c[..., 1][taut]),
        "tension_rmse_n": rms(gap),
        "tension_rmse_share": rms(gap) / rms(pull),
        "tension_relative_rms": rms(gap[strong] / pull[strong]),
        "slack_right": float(np.mean((said == truly)[held])),
        "slack_right_in_flight": float(np.mean((said == truly)[air][held[air]])),
        "nees_mean": float(np.mean(errors.nees)),
        "nees_below_95": float(np.mean(np.array(errors.nees) < 21.03)),
        "vehicle_rmse_m": rms(np.linalg.norm(vehicles[held], axis=1)),
        "vehicle_apart_m": rms(apart(vehicles)),
        "odometry_rmse_m": rms(np.linalg.norm(own[held], axis=1)),
        "odometry_apart_m": rms(apart(own)),
        "path_m": float(np.linalg.norm(np.diff(recording.track.p_WL, axis=0), axis=1).sum()),
        "tags_taken": errors.tally[0],
        "tags_refused": errors.tally[1],
        "others_refused": errors.tally[3],
        "cpu_s_per_s": errors.cpu_s / seconds,
        "tag_cpu_s_per_s": recording.tag_cpu_s / seconds,
        "tag_found": float(len(recording.tag_us) / recording.frames.sum()),
    }


def _mean(x: Array, held: Array) -> Array:
    """Mean over the vehicles that carry, (k, 1, 3)."""
    return np.asarray(
        (x * held[..., None]).sum(axis=1, keepdims=True) / held.sum(axis=1)[:, None, None]
    )


BARS = (
    ("position_rmse_m", "load position RMSE", "m", 1.0, "<= 0.05"),
    ("attitude_rmse_deg", "load attitude RMS", "deg", 1.0, "<= 2"),
    ("cable_direction_rmse_deg", "cable direction RMS", "deg", 1.0, "<= 2"),
    ("cable_rate_rmse_radps", "cable rate RMS", "rad/s", 1.0, "<= 0.3"),
    ("tension_rmse_share", "tension RMS of the RMS tension", "%", 100.0, "<= 5"),
)
"""What must hold: key, name, unit, factor, bar."""


def digest() -> str:
    """Of the code that makes the figures."""
    package = Path(skyhaul.perception.team.__file__).parent
    files = [*package.glob("*.py"), *Path(__file__).parent.glob("team_*.py")]
    files.append(Path(odometry_model.__file__))
    return hashlib.sha1(b"".join(f.read_bytes() for f in sorted(files))).hexdigest()


def result(job: tuple[Case, Path, Path | None]) -> dict[str, Any]:
    """Figures of a case; from the work folder where the same code has made them before."""
    case, work, files = job
    kept, code = work / f"{case.name.replace(' ', '_')}.json", digest()
    if kept.is_file() and case.vio != "estimated":  # its odometry may have changed
        known: dict[str, Any] = json.loads(kept.read_text("utf-8"))
        if known["code"] == code:
            return known
    flown = None
    if case.vio == "estimated":
        flown = track_file(flight_job(case.scenario, case.seed), work)
    recording = record(case.scenario, case.seed, work, flown if flown and flown.is_file() else None)
    errors = run(recording, case, files)
    row = {"case": case.name, **asdict(case), **summary(recording, errors), "code": code}
    row["calibration_s"] = calibration_s()
    kept.write_text(json.dumps(row), "utf-8")
    figures = ", ".join(
        f"{name} {factor * row[key]:.3g} {unit}" for key, name, unit, factor, _ in BARS
    )
    print(f"{case.name}: {figures}", flush=True)
    return row


def table(rows: list[dict[str, Any]], name: str) -> list[Row]:
    """Median and worst over flights."""
    out = []
    for key, what, unit, factor, bar in BARS:
        values = [factor * r[key] for r in rows]
        middle, worst = statistics.median(values), max(values)
        out.append(Row(f"{name}: {what}, worst flight", worst, unit, bar))
        out.append(Row(f"{name}: the same, median", middle, unit))
    right = [100.0 * r["slack_right"] for r in rows]
    out.append(Row(f"{name}: slack and taut told apart, worst flight", min(right), "%", ">= 98"))
    out.append(Row(f"{name}: the same, median", statistics.median(right), "%"))
    share = [100.0 * r["odometry_rmse_m"] / r["path_m"] for r in rows]
    out.append(Row(f"{name}: vehicles' own odometry, RMS, mean", statistics.fmean(share), "%"))
    own = statistics.median([r["odometry_rmse_m"] for r in rows])
    out.append(Row(f"{name}: the same, median", own, "m"))
    for key, what in (
        ("vehicle_rmse_m", "vehicles' position in the team's frame, RMS, median"),
        ("odometry_apart_m", "vehicles' own odometry, apart from each other, RMS, median"),
        ("vehicle_apart_m", "vehicles in the team's frame, apart from each other, RMS, median"),
    ):
        out.append(Row(f"{name}: {what}", statistics.median([r[key] for r in rows]), "m"))
    nees = statistics.fmean([r["nees_mean"] for r in rows])
    out.append(Row(f"{name}: NEES of the load (12), mean", nees, ""))
    return out


def make_odometry(seeds: Sequence[int], work: Path, kind: Any, workers: int) -> Path:  # noqa: ANN401
    """Run the odometry of each vehicle of `paper` that is not in the work folder yet."""
    vehicles = [("paper", seed, vehicle, kind) for seed in seeds for vehicle in VEHICLES]
    jobs = [
        (c, s, v, k) for c, s, v, k in vehicles if not odometry_file(work, k, c, s, v).is_file()
    ]
    for (_, seed, vehicle, _), figures in run_jobs(jobs, work, workers):
        share = 100 * figures["ate_share"]
        print(f"paper seed {seed} vehicle {vehicle}: ATE {share:.2f} % of the path", flush=True)
    return odometry_file(work, kind, "paper", 0, 0).parent


def flights(args: argparse.Namespace) -> list[int]:
    """The seeds of `paper`."""
    if args.quick:
        return [0]
    held_out = [int(s) for s in args.held_out.split(",") if s]
    return [*range(args.seeds), *held_out]


def cases(args: argparse.Namespace) -> dict[str, list[Case]]:
    """What is run, in groups."""
    seeds = flights(args)
    kinds = ["model", "perfect"] if args.vio == "all" else [args.vio]
    groups = {f"`paper`, odometry {v}": [Case(seed=s, vio=v) for s in seeds] for v in kinds}
    if args.vio == "estimated" or args.quick:
        return groups
    few, vio = range(min(2, args.seeds)), kinds[0]
    return groups | {
        "one vehicle dies": [Case(scenario="lost-vehicle", seed=s, vio=vio) for s in few],
        "nobody sees the tag for 3 s": [Case(seed=s, vio=vio, hidden_s=(10.0, 13.0)) for s in few],
        "one odometry drifts five times as fast": [Case(seed=s, vio=vio, drifting=2) for s in few],
        "the load's IMU is silent for 0.5 s": [
            Case(seed=s, vio=vio, silent_s=(10.0, 10.5)) for s in few
        ],
        "hover": [Case(scenario="hover", vio=vio)],
    }


def main() -> None:
    """Run what is asked for and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one flight; writes nothing")
    parser.add_argument("--seeds", type=int, default=10, help="flights of paper (default: 10)")
    parser.add_argument("--vio", choices=("all", "perfect", "model", "estimated"), default="all")
    parser.add_argument("--held-out", default="", help="further seeds, comma-separated")
    parser.add_argument("--odometry", type=Path, help="folder of <flight>_vehicle<i>.npz")
    parser.add_argument("--kind", choices=("ekf", "smoother"), default="ekf", help="of odometry")
    parser.add_argument("--workers", type=int, default=1, help="processes (default: 1)")
    work = Path(tempfile.gettempdir()) / "skyhaul_team_state"
    parser.add_argument("--work", type=Path, default=work, help="keeps flights and figures")
    args = parser.parse_args()
    files = args.odometry
    if args.vio == "estimated" and files is None:
        files = make_odometry(flights(args), args.work, args.kind, args.workers)
    run(record("hover", 0, args.work), Case(scenario="hover"))  # compiles
    plan = cases(args)
    jobs = [(case, args.work, files) for group in plan.values() for case in group]
    done = {case: row for (case, _, _), row in run_all(result, jobs, args.workers)}
    groups = {name: [done[case] for case in group] for name, group in plan.items()}
    rows = [row for name, group in groups.items() for row in table(group, name)]
    every = [r for group in groups.values() for r in group]
    cpu = [r["cpu_s_per_s"] + r["tag_cpu_s_per_s"] for r in every]
    rows.append(Row("CPU time of the filter and the tag's detector, median", statistics.median(cpu),
                    "CPU-s per simulated second", "<= 0.1"))  # fmt: skip
    rows.append(Row("the same, worst", max(cpu), "CPU-s per simulated second", "<= 0.1"))
    for row in rows:
        value = f"{row.value:.3g}" if isinstance(row.value, float) else row.value
        print(f"{row.measure}: {value} {row.unit}  [{row.bar}]")
    if args.quick:
        return
    report = {
        "claim": __doc__.split("\n")[0] if __doc__ else "",
        "rows": [vars(row) for row in rows],
        "flights": every,
        "seeds": flights(args),
        **provenance([r["calibration_s"] for r in every]),
    }
    name = "team_state_estimated" if args.vio == "estimated" else "team_state"
    print(f"-> {write_report(name, report)}")


if __name__ == "__main__":
    main()
