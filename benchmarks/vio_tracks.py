# SPDX-License-Identifier: Apache-2.0
"""Claim: on real tracks the smoother stays within 5 cm and the filter within 6, rest or motion.

Real: 30 s of EuRoC V1_01, tracks of one camera with outliers (`eqvio_processed_30s.csv` of the
gtsam wheel), the whole clip, and cut so that it begins in motion; the truth scores and nothing
else. Made up (`simulated_tracks.py`): flights of 12 s with 0, 20 and 40 % of the tracks sliding
away, for Tukey, Huber and no M-estimator in the window, and NEES of the pose (6 is ideal).
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import gtsam
import numpy as np
from calibration import calibration_s
from pool import run_all
from provenance import provenance, write_report
from result_file import Row
from simulated_tracks import Flight, simulate

from skyhaul.cli.vio import Played, play
from skyhaul.cli.vio_source import open_source
from skyhaul.evaluation.trajectory_error import (
    Trajectory,
    match,
    pose_nees,
    position_nees,
    trajectory_error,
)
from skyhaul.evaluation.trajectory_file import read_trajectory
from skyhaul.perception.vio.ekf import EkfVio
from skyhaul.perception.vio.factors import Robust
from skyhaul.perception.vio.recording import Recording, part
from skyhaul.perception.vio.smoother import SmootherVio
from skyhaul.perception.vio.window import WindowParams
from skyhaul.types import US_PER_S

CLIP = Path(gtsam.findExampleDataFile("eqvio_processed_30s.csv"))
SIGMA_PX = 1.2
BEGIN_S = (0.0, 7.0, 10.0, 13.0, 16.0, 20.0)
BOUND_95 = 12.59  # chi-square of 6 degrees of freedom
ROBUST: tuple[Robust, ...] = ("tukey", "huber", "none")
OUTLIERS = (0.0, 0.2, 0.4)

Kind = SmootherVio | EkfVio


def begun_at(recording: Recording, begin_s: float) -> Recording:
    """The recording without its first seconds."""
    begin_us = round(begin_s * US_PER_S)
    first = int(np.searchsorted(recording.imu.stamp_us, begin_us))
    imu = part(recording.imu, first, len(recording.imu.stamp_us))
    frames = tuple(f for f in recording.frames() if f.stamp_us >= begin_us)
    return replace(recording, imu=imu, frames=lambda: iter(frames))


def figures(kind: Kind, recording: Recording, truth: Trajectory) -> dict[str, Any]:
    """Errors, consistency and time of one run."""
    played = play(kind.build(recording.rig, recording.sigma), recording)
    matched = match(played.trajectory, truth)
    if len(matched.row) < 3:
        return {"kind": kind.kind, "ate_m": None, "matched": len(matched.row)}
    error = trajectory_error(matched)
    covariance = covariances(played)[matched.row]
    nees = pose_nees(matched, covariance)
    return {
        "kind": kind.kind,
        "ate_m": error.ate_m,
        "ate_max_m": error.ate_max_m,
        "rpe_m": error.rpe_m,
        "rpe_deg": error.rpe_deg,
        "alignment": error.alignment,
        "matched": error.matched,
        "path_m": error.path_m,
        "nees_mean": float(np.mean(nees)),
        "nees_position_mean": float(np.mean(position_nees(matched, covariance))),
        "nees_share_under_95_bound": float(np.mean(nees < BOUND_95)),
        "lost": sum(e.status == "lost" for e in played.estimates),
        "cpu_s": played.cpu_s,
        "real_time_factor": played.duration_s / played.cpu_s,
        "calibration_s": calibration_s(),
    }


def covariances(played: Played) -> np.ndarray:  # type: ignore[type-arg]
    """Of the poses of the estimates that have a state, (n, 6, 6)."""
    known = [e for e in played.estimates if e.state is not None]
    return np.array([e.covariance[:6, :6] for e in known])


def real_runs(truth_file: Path) -> Iterator[dict[str, Any]]:
    """The clip, whole and cut, by both estimators."""
    truth, recording = read_trajectory(truth_file), open_source(CLIP, SIGMA_PX).recording
    for begin_s in BEGIN_S:
        for kind in (SmootherVio(), EkfVio()):
            yield {"begin_s": begin_s} | figures(kind, begun_at(recording, begin_s), truth)


Made = tuple[float, int, Robust | Literal["gate"]]
"""Share of the tracks that slide, seed, M-estimator of the smoother; `gate`: the filter."""


def outlier_run(what: Made) -> dict[str, Any]:
    """One made-up flight with sliding tracks."""
    share, seed, robust = what
    flown = simulate(Flight(seed=seed, duration_s=12.0, outliers=share, pace=1.3))
    kind = EkfVio() if robust == "gate" else SmootherVio(window=WindowParams(robust=robust))
    about = {"outliers": share, "seed": seed, "robust": robust}
    return about | figures(kind, flown.recording, flown.truth)


def outlier_runs(seeds: int, workers: int) -> list[dict[str, Any]]:
    """Made-up flights with sliding tracks, in order."""
    robusts: tuple[Robust | Literal["gate"], ...] = (*ROBUST, "gate")
    jobs = [(share, s, r) for share in OUTLIERS for s in range(seeds) for r in robusts]
    done = {}
    for job, run in run_all(outlier_run, jobs, workers):
        done[job] = run
        print({k: round(v, 4) if isinstance(v, float) else v for k, v in run.items()}, flush=True)
    return [done[job] for job in jobs]


def outlier_table(runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Median ATE and the worst one over the seeds; a run without a state counts as infinite."""
    table = []
    for kind, robust in (*(("smoother", r) for r in ROBUST), ("ekf", "gate")):
        row: dict[str, Any] = {"kind": kind, "robust": robust}
        for share in OUTLIERS:
            mine = [
                r for r in runs if (r["kind"], r["robust"], r["outliers"]) == (kind, robust, share)
            ]
            ate = [np.inf if r["ate_m"] is None else r["ate_m"] for r in mine]
            row[f"ate_m_at_{share:.0%}"] = float(np.median(ate))
            row[f"worst_m_at_{share:.0%}"] = float(np.max(ate))
        nees = [
            r["nees_mean"]
            for r in runs
            if (r["kind"], r["robust"]) == (kind, robust) and r["ate_m"]
        ]
        row["nees_mean"] = float(np.mean(nees))
        table.append(row)
    return table


def rows(real: list[dict[str, Any]], table: list[dict[str, Any]]) -> list[Row]:
    """The lines of the tables."""
    out = []
    for run in real:
        begun = "at rest" if run["begin_s"] == 0.0 else f"in motion at {run['begin_s']:g} s"
        name = f"EuRoC V1_01 clip, {run['kind']}, begun {begun}"
        out.append(Row(f"{name}: ATE (SE3, {run['matched']} pairs)", run["ate_m"], "m", "<= 0.05"))
        out.append(Row(f"{name}: times real time, CPU", run["real_time_factor"], "x", "> 1"))
    for line in table:
        clean, worst = line["ate_m_at_0%"], line["ate_m_at_40%"]
        bar = "<= 1.5" if line["robust"] == "tukey" else ""
        name = f"made-up flights, {line['kind']}, {line['robust']}"
        out.append(
            Row(f"{name}: ATE at 40 % sliding tracks over that at 0 %", worst / clean, "", bar)
        )
    return out


def main() -> None:
    """Print the runs and write `results/vio_tracks.json`."""
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=default, help="folder of the recordings")
    parser.add_argument("--seeds", type=int, default=3, help="made-up flights (default: 3)")
    parser.add_argument("--workers", type=int, default=1, help="processes (default: 1)")
    args = parser.parse_args()
    truth_file = args.data / "euroc" / "V1_01_easy_truth.csv"
    real = []
    if truth_file.is_file():
        for run in real_runs(truth_file):
            print(
                {k: round(v, 4) if isinstance(v, float) else v for k, v in run.items()}, flush=True
            )
            real.append(run)
    else:
        print(f"real clip skipped: no {truth_file}; give --data DIR")
    made_up = outlier_runs(args.seeds, args.workers)
    table = outlier_table(made_up)
    for row in table:
        print({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()})
    report = {
        "claim": (__doc__ or "").splitlines()[0].removeprefix("Claim: ").rstrip("."),
        "rows": [vars(row) for row in rows(real, table)],
        "sigma_px": SIGMA_PX,
        "real": real,
        "outliers": table,
        "made_up": made_up,
        **provenance(),
    }
    print(f"-> {write_report('vio_tracks', report)}")


if __name__ == "__main__":
    main()
