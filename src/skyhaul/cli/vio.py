# SPDX-License-Identifier: Apache-2.0
"""`skyhaul vio`: the visual-inertial estimators on a recording."""

import argparse
import json
import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyhaul.errors import FileError
from skyhaul.evaluation.trajectory_error import (
    Trajectory,
    TrajectoryError,
    match,
    trajectory_error,
)
from skyhaul.evaluation.trajectory_file import read_trajectory, write_tum
from skyhaul.perception.vio.api import Memory, StartPose, VioEstimate, VioEstimator, VioStatus
from skyhaul.perception.vio.ekf import EkfVio
from skyhaul.perception.vio.euroc import read_euroc
from skyhaul.perception.vio.front_end import FrontEnd
from skyhaul.perception.vio.recording import Recording
from skyhaul.perception.vio.smoother import SmootherVio
from skyhaul.perception.vio.track_file import read_track_file
from skyhaul.perception.vio.warm_up import warm_up
from skyhaul.types import US_PER_S

KINDS = {"smoother": SmootherVio, "ekf": EkfVio}


@dataclass(frozen=True, eq=False)
class Played:
    """What an estimator made of a recording."""

    estimates: tuple[VioEstimate, ...]
    trajectory: Trajectory
    duration_s: float
    cpu_s: float


def vio(args: argparse.Namespace) -> int:
    """Run an estimator over a recording, print its errors; 0 done, 3 when it never had a state."""
    truth = None if args.truth is None else read_trajectory(args.truth)
    recording = open_recording(args.dataset, args.sigma_px)
    kind = KINDS[args.kind]()
    played = play(kind.build(recording.rig, recording.sigma), recording)
    if not played.trajectory.time_ns.size:
        raise FileError(
            f"{args.dataset}: no state was found in {played.duration_s:.1f} s; the recording must "
            f"begin at rest for {kind.beginning.standing.init_s:g} s or move enough to show depth"
        )
    error = None if truth is None else score(played.trajectory, truth, args)
    if args.out is not None:
        write_tum(args.out, played.trajectory)
    summary = summarize(played, error)
    about = {"dataset": str(args.dataset), "kind": args.kind}
    if args.json:
        print(json.dumps(about | summary, indent=2))
    else:
        print_summary(about | summary)
    return 0


def open_recording(path: Path, sigma_px: float) -> Recording:
    """A recording by its path.

    Raises:
        FileError: When there is nothing, or nothing that we can read.
    """
    if not path.exists():
        raise FileError(f"{path}: does not exist; give a feature-track CSV or an EuRoC folder")
    if path.is_dir():
        return read_euroc(path, sigma_px, FrontEnd())
    return read_track_file(path, sigma_px)


def play(estimator: VioEstimator[Memory], recording: Recording) -> Played:
    """Feed a recording to an estimator; its kernels are compiled before the clock starts."""
    warm_up(recording.rig)
    memory, estimates = estimator.init(StartPose()), []
    began = time.process_time()
    for imu, tracks in recording.readings():
        memory, estimate = estimator.step(memory, imu, tracks)
        estimates.append(estimate)
    cpu_s = time.process_time() - began
    states = [(e.stamp_us, e.state) for e in estimates if e.state is not None]
    trajectory = Trajectory(
        np.array([recording.epoch_ns + 1000 * t for t, _ in states], dtype=np.int64),
        np.array([s.p_WI for _, s in states]).reshape(-1, 3),
        np.array([s.q_WI for _, s in states]).reshape(-1, 4),
    )
    duration_s = (estimates[-1].stamp_us - estimates[0].stamp_us) / US_PER_S
    return Played(tuple(estimates), trajectory, duration_s, cpu_s)


def score(trajectory: Trajectory, truth: Trajectory, args: argparse.Namespace) -> TrajectoryError:
    """Errors against a truth.

    Raises:
        FileError: When fewer than three poses have a truth.
    """
    matched = match(trajectory, truth)
    if len(matched.row) < 3:
        raise FileError(
            f"{args.truth}: overlaps {args.dataset} in {len(matched.row)} poses, three at least "
            f"are needed; check that both have the same clock"
        )
    return trajectory_error(matched, args.align)


def summarize(played: Played, error: TrajectoryError | None) -> dict[str, object]:
    """Figures of a run; null where there is no truth."""
    counts = {s: sum(e.status is s for e in played.estimates) for s in VioStatus}
    figures: dict[str, object] = {
        "frames": len(played.estimates),
        "duration_s": round(played.duration_s, 3),
        "frames_initializing": counts[VioStatus.INITIALIZING],
        "frames_tracking": counts[VioStatus.TRACKING],
        "frames_lost": counts[VioStatus.LOST],
        "cpu_s": round(played.cpu_s, 3),
        "real_time_factor": round(played.duration_s / max(played.cpu_s, 1e-9), 2),
    }
    names = (
        "ate_m",
        "ate_max_m",
        "rpe_m",
        "rpe_deg",
        "rpe_delta_s",
        "matched",
        "alignment",
        "scale",
        "path_m",
    )
    scored = {name: None if error is None else _plain(getattr(error, name)) for name in names}
    return figures | scored


def print_summary(summary: dict[str, object]) -> None:
    """Figures as a table."""
    s = summary
    print(f"{'recording':<18}{s['dataset']}  ({s['duration_s']} s, {s['frames']} frames)")
    print(f"{'estimator':<18}{s['kind']}")
    print(
        f"{'frames':<18}{s['frames_initializing']} initialising, {s['frames_tracking']} tracking, "
        f"{s['frames_lost']} lost"
    )
    print(f"{'CPU time':<18}{s['cpu_s']} s, {s['real_time_factor']} times real time")
    if s["ate_m"] is None:
        print(f"{'error':<18}not known: give --truth FILE")
        return
    print(
        f"{'ATE':<18}{s['ate_m']} m RMS, {s['ate_max_m']} m at most  "
        f"({s['alignment']} alignment, {s['matched']} pairs, path {s['path_m']} m)"
    )
    print(f"{'RPE':<18}{s['rpe_m']} m, {s['rpe_deg']} deg RMS over {s['rpe_delta_s']} s")


def _plain(value: object) -> object:
    """Numbers that JSON knows, rounded to a tenth of a millimetre."""
    if isinstance(value, float):
        return round(value, 4) if math.isfinite(value) else None
    return value
