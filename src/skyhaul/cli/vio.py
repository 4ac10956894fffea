# SPDX-License-Identifier: Apache-2.0
"""`skyhaul vio`: the visual-inertial estimators on a recording."""

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from skyhaul.cli.recording_bar import RecordingBar
from skyhaul.cli.vio_source import open_source
from skyhaul.errors import FileError
from skyhaul.evaluation.dataset.table_file import NS_PER_S, seconds
from skyhaul.evaluation.trajectory_error import (
    MAX_GAP_S,
    Matched,
    Trajectory,
    TrajectoryError,
    match,
    trajectory_error,
)
from skyhaul.evaluation.trajectory_file import check_out, read_trajectory, write_tum
from skyhaul.perception.slam.loops import LoopMemory, LoopRules, on_map
from skyhaul.perception.slam.relocation import LandmarkMap, Relocation
from skyhaul.perception.vio.api import (
    Memory,
    StartPose,
    TrackFrame,
    VioEstimate,
    VioEstimator,
    VioStatus,
)
from skyhaul.perception.vio.ekf import EkfVio
from skyhaul.perception.vio.recording import Recording, Views
from skyhaul.perception.vio.smoother import SmootherVio
from skyhaul.perception.vio.warm_up import warm_up
from skyhaul.sensors.api import ImuReading
from skyhaul.types import US_PER_S, IntArray

KINDS = {"smoother": SmootherVio, "ekf": EkfVio}
LEAST_PAIRS = 3
"""Fewer poses leave an alignment open."""
SWAPPED_DEG = 3.0
"""A smaller error over a second does not come from quaternions in a wrong order."""


Frames = Iterator[tuple[ImuReading, TrackFrame, Views]]


@dataclass(frozen=True, eq=False)
class Played:
    """What an estimator made of a recording."""

    estimates: tuple[VioEstimate, ...]
    trajectory: Trajectory
    duration_s: float
    cpu_s: float
    mapped: Trajectory | None = None
    """On the map with its loops closed as they were seen; None without `--loops`."""
    loops: int = 0


def vio(args: argparse.Namespace) -> int:
    """Run an estimator over a recording, print its errors."""
    if args.out is not None:
        check_out(args.out)
    truth = None if args.truth is None else read_trajectory(args.truth)
    source = open_source(args.dataset, args.sigma_px)
    recording = source.recording
    if truth is not None:
        check_overlap(args, truth, source.time_ns)
    kind = KINDS[args.kind]()
    if args.loops and recording.images is None:
        raise FileError(
            f"{args.dataset}: loops are closed by images, this file has tracks alone; give an "
            f"EuRoC folder, or leave --loops out"
        )
    loops = LoopRules() if args.loops else None
    span_s = float(np.ptp(source.time_ns)) / NS_PER_S
    with RecordingBar(f"{args.kind}: {args.dataset.name}", span_s, sys.stderr) as bar:
        played = play(kind.build(recording.rig, recording.sigma), recording, loops, bar)
    if not played.trajectory.time_ns.size:
        raise FileError(
            f"{args.dataset}: no state was found in {played.duration_s:.1f} s; the recording must "
            f"begin at rest for {kind.beginning.standing.init_s:g} s or move enough to show depth"
        )
    best = played.mapped or played.trajectory
    error = None if truth is None else score(best, truth, args)
    summary = summarize(played, error)
    if played.mapped is not None:
        alone = None if truth is None else score(played.trajectory, truth, args).ate_m
        summary |= {"loops": played.loops, "ate_without_loops_m": _plain(alone)}
    about = {"dataset": str(args.dataset), "kind": args.kind}
    if args.out is not None:
        write_tum(args.out, best)
    if args.json:
        print(json.dumps(about | summary, indent=2))
    else:
        print_summary(about | summary)
    return 0


def play(
    estimator: VioEstimator[Memory],
    recording: Recording,
    loops: LoopRules | None = None,
    bar: RecordingBar | None = None,
) -> Played:
    """Feed a recording to an estimator; its kernels are compiled before the clock starts.

    With images it finds its place again after it was lost; with loops their map does that.
    """
    warm_up(recording.rig)
    closer, finder, none = None, None, Views()
    frames: Frames = ((i, f, none) for i, f in recording.readings())
    if recording.images is not None:
        rig, lenses, frames = recording.rig, recording.images.lenses, recording.views()
        finder = Relocation().build(rig, lenses) if loops is None else None
        closer = None if loops is None else loops.build(rig, lenses)
    memory, places, known = estimator.init(StartPose()), LoopMemory(), LandmarkMap()
    estimates, rows = [], []
    if bar is not None:
        bar.begin()
    began, first_us = time.process_time(), None
    for imu, tracks, views in frames:
        memory, estimate = estimator.step(memory, imu, tracks)
        if finder is not None:
            known, memory, estimate = finder.follow(known, estimator, memory, estimate, views)
        estimates.append(estimate)
        first_us = estimate.stamp_us if first_us is None else first_us
        if bar is not None:
            bar.update((estimate.stamp_us - first_us) / US_PER_S, estimate.status.value)
        if estimate.state is None:
            continue
        if closer is not None and closer.due(places, estimate):
            places = closer.step(places, estimate, views, estimator.landmarks(memory))
        state = estimate.state
        time_ns = recording.epoch_ns + 1000 * estimate.stamp_us
        rows.append((time_ns, state.p_WI, state.q_WI, *on_map(places, state)))
    cpu_s = time.process_time() - began
    stamps = np.array([r[0] for r in rows], dtype=np.int64)
    alone, mapped = (
        Trajectory(
            stamps,
            np.array([r[k] for r in rows]).reshape(-1, 3),
            np.array([r[k + 1] for r in rows]).reshape(-1, 4),
        )
        for k in (1, 3)
    )
    duration_s = (estimates[-1].stamp_us - estimates[0].stamp_us) / US_PER_S
    on = mapped if closer is not None else None
    return Played(tuple(estimates), alone, duration_s, cpu_s, on, len(places.loops))


def check_overlap(args: argparse.Namespace, truth: Trajectory, time_ns: IntArray) -> None:
    """Refuse a truth of another time before anything is played.

    Raises:
        FileError: When fewer than three frames lie within its time.
    """
    begin, end = truth.time_ns[0], truth.time_ns[-1]
    count = int(np.count_nonzero((begin <= time_ns) & (time_ns <= end)))
    if count < LEAST_PAIRS:
        raise FileError(
            f"{args.truth}: overlaps {args.dataset} in {count} frames, {LEAST_PAIRS} at least are "
            f"needed: it goes from {seconds(begin)} to {seconds(end)} s, the recording from "
            f"{seconds(time_ns[0])} to {seconds(time_ns[-1])} s; give both by one clock"
        )


def score(trajectory: Trajectory, truth: Trajectory, args: argparse.Namespace) -> TrajectoryError:
    """Errors against a truth.

    Raises:
        FileError: When fewer than three poses have a truth, or its quaternions are in another
            order.
    """
    matched = match(trajectory, truth)
    if len(matched.row) < LEAST_PAIRS:
        raise FileError(
            f"{args.truth}: overlaps the trajectory of {args.dataset} in {len(matched.row)} poses, "
            f"{LEAST_PAIRS} at least are needed, each between poses of the truth at most "
            f"{MAX_GAP_S} s apart"
        )
    error = trajectory_error(matched, args.align)
    order = other_order(matched, error)
    if order is not None:
        raise FileError(
            f"{args.truth}: its quaternions fit the recording only if they are in the order "
            f"{order}; EuRoC CSV has q w x y z, TUM text has qx qy qz qw: reorder the columns"
        )
    return error


def other_order(matched: Matched, error: TrajectoryError) -> str | None:
    """The order in which a truth's quaternions fit an estimate, if not the one they were read in.

    Motions of a second that are wrong by many degrees, and right once w stands at the other end.
    """
    if not error.rpe_deg > SWAPPED_DEG:
        return None
    truth = matched.truth
    for order, columns in (("w x y z", [1, 2, 3, 0]), ("x y z w", [3, 0, 1, 2])):
        other = Trajectory(truth.time_ns.copy(), truth.p.copy(), truth.q[:, columns].copy())
        turned = trajectory_error(Matched(matched.estimate, other, matched.row), "none")
        if turned.rpe_deg < 0.2 * error.rpe_deg:
            return order
    return None


def summarize(played: Played, error: TrajectoryError | None) -> dict[str, object]:
    """Figures of a run; null where there is no truth."""
    counts = {s: sum(e.status is s for e in played.estimates) for s in VioStatus}
    figures: dict[str, object] = {
        "frames": len(played.estimates),
        "duration_s": round(played.duration_s, 3),
        "frames_initializing": counts[VioStatus.INITIALIZING],
        "frames_tracking": counts[VioStatus.TRACKING],
        "frames_lost": counts[VioStatus.LOST],
        "relocated": sum(e.relocated for e in played.estimates),
        "cpu_s": round(played.cpu_s, 3),
        "real_time_factor": round(played.duration_s / max(played.cpu_s, 1e-9), 2),
    }
    names = (
        "ate_m",
        "ate_max_m",
        "rpe_m",
        "rpe_deg",
        "rpe_delta_s",
        "rpe_pairs",
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
        f"{s['frames_lost']} lost, {s['relocated']} times relocated"
    )
    print(f"{'CPU time':<18}{s['cpu_s']} s, {s['real_time_factor']} times real time")
    if "loops" in s:
        without = s["ate_without_loops_m"]
        beside = "" if without is None else f"; ATE without them {without} m RMS"
        print(f"{'loops':<18}{s['loops']} closed{beside}")
    if s["ate_m"] is None:
        print(f"{'error':<18}not known: give --truth FILE")
        return
    scale = f", scale {s['scale']}" if s["alignment"] == "sim3" else ""
    print(
        f"{'ATE':<18}{s['ate_m']} m RMS, {s['ate_max_m']} m at most  "
        f"({s['alignment']} alignment{scale}, {s['matched']} pairs, path {s['path_m']} m)"
    )
    if not s["rpe_pairs"]:
        print(f"{'RPE':<18}not known: no motion over {s['rpe_delta_s']} s has a truth")
        return
    print(
        f"{'RPE':<18}{s['rpe_m']} m, {s['rpe_deg']} deg RMS over {s['rpe_delta_s']} s  "
        f"({s['rpe_pairs']} motions)"
    )


def _plain(value: object) -> object:
    """Numbers that JSON knows, rounded to a tenth of a millimetre."""
    if isinstance(value, float):
        return round(value, 4) if math.isfinite(value) else None
    return value
