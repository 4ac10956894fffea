# SPDX-License-Identifier: Apache-2.0
"""`skyhaul events`: what moves by itself in a recording of an event camera."""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skyhaul.cli.event_picture import write_picture
from skyhaul.geometry.camera import RadTan
from skyhaul.perception.events.api import EventClassifier
from skyhaul.perception.events.classifier import NetworkParams
from skyhaul.perception.events.lens import EventLens, event_lens
from skyhaul.perception.events.noise_filter import FLASH, FLICKER, NOISE
from skyhaul.perception.events.recordings import (
    Recording,
    read_calibration,
    read_rate,
    read_recording,
)
from skyhaul.perception.events.rotation import TurnMemory, turn_at
from skyhaul.perception.events.timestamp import TimestampParams
from skyhaul.perception.obstacles.watch import CameraWatch, Watched, WatchMemory
from skyhaul.sensors.api import EventReading
from skyhaul.types import US_PER_S, Array, TimeUs

STEP_US = 10_000
ASSUMED_FOV_DEG = 60.0
Numbers = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Job:
    """A recording, its camera and how that turned."""

    recording: Recording
    lens: EventLens
    rate_C: Array  # (3,) [rad/s]
    about: dict[str, str]  # where lens and rate come from


def events(args: argparse.Namespace) -> int:
    """Watch a recording; print what moved and how fast it was found."""
    job = load(args)
    watch = CameraWatch(classifier_of(args))
    warm_up(watch, job)
    begin, steps = time.process_time(), []
    memory = watch.init(job.lens)
    for stamp_us, part, turn_C in readings(job):
        memory, watched = watch.step(memory, stamp_us, part, turn_C)
        steps.append(watched)
    found = numbers(job, watch, memory, steps, time.process_time() - begin)
    if args.out is not None:
        found["picture"] = str(write_picture(args.out, job.lens, steps))
    print(json.dumps(found, indent=2) if args.json else text(args.file, found))
    return 0


def load(args: argparse.Namespace) -> Job:
    """The recording, with calibration and rate from options or the files beside it."""
    recording = read_recording(args.file)
    size = recording.width, recording.height
    calib, motion = args.calib or args.file.parent / "calib.txt", args.file.parent / "motion.txt"
    model = RadTan.from_fov(size, ASSUMED_FOV_DEG)
    about = {"lens": f"assumed, {ASSUMED_FOV_DEG:g} deg", "rate": "assumed, the camera stands"}
    if args.calib is not None or calib.is_file():
        model, about["lens"] = read_calibration(calib, size), str(calib)
    rate_C = np.zeros(3)
    if args.rate is not None:
        rate_C, about["rate"] = np.array(args.rate), "--rate"
    elif motion.is_file():
        rate_C, about["rate"] = read_rate(motion), str(motion)
    return Job(recording, event_lens(model), rate_C, about)


def classifier_of(args: argparse.Namespace) -> EventClassifier[Any]:
    """The network, with the weights that ship or with those of a file, or the recipe."""
    if args.kind == "timestamp":
        return TimestampParams()
    return NetworkParams(weights=None if args.weights is None else str(args.weights)).build()


def readings(job: Job) -> Iterator[tuple[TimeUs, EventReading, Array]]:
    """The recording in steps: end of the step, its events, the camera's turn at each."""
    whole, turn = job.recording.events, TurnMemory()
    t_us = whole.t_us
    first = int(t_us[0])
    ends = np.arange(first + STEP_US, int(t_us[-1]) + STEP_US + 1, STEP_US)
    cuts = np.searchsorted(t_us, ends)
    for end, a, b in zip(ends, [0, *cuts[:-1]], cuts, strict=True):
        part = EventReading(whole.t_us[a:b], whole.x[a:b], whole.y[a:b], whole.p[a:b])
        stamp = np.array([end - STEP_US])
        turn, turn_C = turn_at(turn, stamp, job.rate_C[None], part.t_us)
        yield int(end), part, turn_C


def warm_up(watch: CameraWatch, job: Job) -> None:
    """Compile what is compiled, so that it is not timed."""
    stamp_us, part, turn_C = next(iter(readings(job)))
    few = EventReading(part.t_us[:9], part.x[:9], part.y[:9], part.p[:9])
    watch.step(watch.init(job.lens), stamp_us, few, turn_C[:9])


def numbers(
    job: Job, watch: CameraWatch, memory: WatchMemory, steps: list[Watched], cpu_s: float
) -> Numbers:
    """What is printed: counts, shares, rates, tracks."""
    t_us, work = job.recording.events.t_us, watch.work(memory)
    duration_us = int(t_us[-1] - t_us[0])
    why = np.concatenate([s.why for s in steps])
    movers = sum(int(s.scores.mover.sum()) for s in steps)
    tracks = track_table(job.lens, steps)
    longest = max((t["to_s"] - t["from_s"] for t in tracks), default=0.0)
    kept = sum(len(s.kept.t_us) for s in steps)
    return {
        "events": len(t_us),
        "duration_s": duration_us / US_PER_S,
        "image_px": [job.recording.width, job.recording.height],
        "lens": job.about["lens"],
        "rate": job.about["rate"],
        "classifier": getattr(watch.classifier, "kind", "network"),
        "noise_fraction": float(np.mean(why == NOISE)),
        "flicker_fraction": float(np.mean(why == FLICKER)),
        "flash_fraction": float(np.mean(why == FLASH)),
        "kept_events": kept,
        "mover_fraction": movers / kept if kept else 0.0,
        "confirmed_tracks": len(tracks),
        "longest_track_fraction": min(1.0, longest * US_PER_S / max(duration_us, 1)),
        "events_per_s": work.evaluated / cpu_s,
        "skipped_fraction": work.skipped_fraction,
        "tracks": tracks,
    }


def track_table(lens: EventLens, steps: list[Watched]) -> list[Numbers]:
    """One row per confirmed track of the image, in order of its beginning."""
    rows: dict[int, Numbers] = {}
    held: dict[int, list[tuple[int, int]]] = {}
    for step in steps:
        tracks, end_s = step.tracks, step.clusters.stamp_us / US_PER_S
        place = np.column_stack([step.kept.x, step.kept.y])
        contact_s = tracks.time_to_contact_s()
        for i in np.flatnonzero(tracks.confirmed & (tracks.row >= 0)):
            name, half = int(tracks.name[i]), tracks.half_size[i]
            row = rows.setdefault(name, {
                "name": name, "from_s": (int(tracks.born_us[i]) - STEP_US) / US_PER_S,
                "largest_box_fraction": 0.0, "shortest_contact_s": None,
            })  # fmt: skip
            row["to_s"] = end_s
            area = float(4.0 * half[0] * half[1] / (lens.width * lens.height))
            row["largest_box_fraction"] = max(row["largest_box_fraction"], area)
            if np.isfinite(contact_s[i]):
                shortest = row["shortest_contact_s"]
                now = float(contact_s[i])
                row["shortest_contact_s"] = now if shortest is None else min(shortest, now)
            inside = np.all(np.abs(place - tracks.middle[i]) <= half, axis=1)
            held.setdefault(name, []).append((int(inside.sum()), len(inside)))
    for name, row in rows.items():
        inside_count, all_count = np.sum(held[name], axis=0)
        row["held_fraction"] = float(inside_count / max(all_count, 1))
    return list(rows.values())


def text(path: Path, found: Numbers) -> str:
    """The numbers as lines to read."""
    w, h = found["image_px"]
    lines = [
        f"{path}: {found['events']:,} events in {found['duration_s']:.3f} s, {w} x {h} pixels",
        f"  lens                 {found['lens']}",
        f"  angular rate         {found['rate']}",
        f"  dropped              {found['noise_fraction']:.1%} noise, "
        f"{found['flicker_fraction']:.1%} flicker, {found['flash_fraction']:.1%} image of start",
        f"  classifier           {found['classifier']}, {found['skipped_fraction']:.1%} skipped, "
        f"{found['events_per_s']:,.0f} events/s",
        f"  movers               {found['mover_fraction']:.1%} of what was kept",
        f"  confirmed tracks     {found['confirmed_tracks']}, the longest through "
        f"{found['longest_track_fraction']:.1%} of the recording",
    ]
    for t in found["tracks"]:
        lines.append(
            f"    track {t['name']:<3} {t['from_s']:.2f} to {t['to_s']:.2f} s, box at most "
            f"{t['largest_box_fraction']:.1%} of the image, {t['held_fraction']:.0%} of the events"
        )
    if "picture" in found:
        lines.append(f"  picture              {found['picture']}")
    return "\n".join(lines)
