# SPDX-License-Identifier: Apache-2.0
"""Claim: our pixels fire as evlib's ESIM simulator does, faster, with times inside the frame.

Both see the same 87 frames of a DAVIS240 (slider_depth), the same black level and equal
thresholds, without noise, low-pass or reset. They differ only where a grey value returns exactly
to a threshold: levels of 8 bit do, and rounding decides. Stamps are whole microseconds, of which a
frame has 38 765. Needs `evlib` and `torch==2.13.0`, which no other benchmark does.
"""

import json
import logging
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from calibration import calibration_s
from event_camera import QUIET
from provenance import commit
from slider_frames import BLACK_LEVEL, Recording, data_folder, load_recording, view_of

from skyhaul.types import Array

RESULT = Path(__file__).parent / "results" / "event_simulators.json"
THRESHOLDS = (0.2, 0.4, 0.6)
REPEATS = 5

Events = list[tuple[Array, Array, Array, Array]]
"""x, y, t, p of each frame."""


def ours(recording: Recording, threshold: float) -> Events:
    """Our events of the recording's frames."""
    params = replace(QUIET, threshold_on=threshold, threshold_off=threshold, threshold_spread=0.0)
    t, frames = recording.frame_us.tolist(), recording.frames
    memory = params.init(view_of(frames[0]), frames.shape[2], t[0], np.random.default_rng(0))
    memory.pixels.state.reference[:] = memory.log_light
    out = []
    for t_us, frame in zip(t[1:], frames[1:], strict=True):
        memory, r, _ = params.step(memory, view_of(frame), t_us)
        out.append((r.x, r.y, 1e-6 * r.t_us, r.p))
    return out


def evlibs(recording: Recording, threshold: float) -> Events:
    """Events of evlib from the same frames; it adds no black level, so we do."""
    from evlib.simulation import ESIMConfig, ESIMSimulator

    config = ESIMConfig(
        positive_threshold=threshold,
        negative_threshold=threshold,
        refractory_period_ms=0.0,
        device="cpu",
    )
    simulator = ESIMSimulator(config)
    black = np.float32(BLACK_LEVEL)
    t = (1e-6 * recording.frame_us).tolist()
    frames = zip(recording.frames, t, strict=True)
    return [simulator.process_frame(frame + black, s) for frame, s in frames][1:]


def net_counts(events: Events, shape: tuple[int, int]) -> Array:
    """ON minus OFF of each pixel in each frame."""
    out = np.zeros((len(events), *shape))
    for net, (x, y, _, p) in zip(out, events, strict=True):
        np.add.at(net, (y.astype(int), x.astype(int)), p)
    return out


def distinct_share(events: Events) -> float:
    """Distinct stamps over events, mean of the frames."""
    return float(np.mean([len(np.unique(t)) / len(t) for _, _, t, _ in events if len(t)]))


def best_s(calls: list[Callable[[], Events]]) -> list[float]:
    """CPU time of each call, the best of several turns [s]."""
    times = np.full((REPEATS, len(calls)), np.inf)
    for row in times:
        for k, call in enumerate(calls):
            begin = time.process_time()
            call()
            row[k] = time.process_time() - begin
    return times.min(axis=0).tolist()


def compare(recording: Recording, threshold: float) -> dict[str, Any]:
    """Counts, correlation and times at one threshold."""
    mine, theirs = ours(recording, threshold), evlibs(recording, threshold)
    shape = recording.frames.shape[1:]
    nets = [net_counts(e, shape) for e in (mine, theirs)]
    counts = [sum(len(e[0]) for e in events) for events in (mine, theirs)]
    seconds = best_s([lambda: ours(recording, threshold), lambda: evlibs(recording, threshold)])
    return {
        "threshold": threshold,
        "events": counts[0],
        "events_evlib": counts[1],
        "count_difference": counts[0] / counts[1] - 1.0,
        "correlation": float(np.corrcoef(nets[0].ravel(), nets[1].ravel())[0, 1]),
        "cpu_ms_per_frame": 1e3 * seconds[0] / len(mine),
        "cpu_ms_per_frame_evlib": 1e3 * seconds[1] / len(mine),
        "times_faster": seconds[1] / seconds[0],
        "distinct_stamps": distinct_share(mine),
        "distinct_stamps_evlib": distinct_share(theirs),
    }


def main() -> None:
    """Compare and write the result."""
    logging.disable(logging.WARNING)
    import torch

    torch.set_num_threads(1)
    recording = load_recording(data_folder())
    calibration = calibration_s()
    cases = [compare(recording, c) for c in THRESHOLDS]
    worst = {
        "difference": max(abs(c["count_difference"]) for c in cases),
        "correlation": min(c["correlation"] for c in cases),
        "faster": min(c["times_faster"] for c in cases),
        "distinct": min(c["distinct_stamps"] for c in cases),
        "distinct_evlib": max(c["distinct_stamps_evlib"] for c in cases),
    }
    rows = [
        ("events against evlib", worst["difference"], "share", "<= 0.02"),
        ("net count of each pixel and frame", worst["correlation"], "correlation", ">= 0.99"),
        ("faster than evlib, least of the thresholds", worst["faster"], "times", "> 1"),
        ("distinct stamps inside a frame", worst["distinct"], "share of events", ""),
        ("the same of evlib", worst["distinct_evlib"], "share of events", ""),
    ]
    report = {
        "claim": "our pixels fire as evlib's, faster, and with times inside the frame",
        "rows": [dict(zip(("measure", "value", "unit", "bar"), r, strict=True)) for r in rows],
        "cases": cases,
        "evlib": version("evlib"),
        "torch": version("torch"),
        "calibration_5e6_python_iterations_s": calibration,
        "machine": platform.platform(),
        "python": sys.version.split()[0],
        "commit": commit(),
    }
    RESULT.write_text(json.dumps(report, indent=2) + "\n", "utf-8")
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
