# SPDX-License-Identifier: Apache-2.0
"""`skyhaul run`: fly a scenario, write its run folder, print the table."""

import argparse
import gc
import itertools
import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from skyhaul.cli.overrides import run_overrides
from skyhaul.cli.progress import FlightBar
from skyhaul.errors import FileError, SkyhaulError
from skyhaul.evaluation.folder import FolderTakenError
from skyhaul.evaluation.metrics import evaluate
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.evaluation.report import write_report
from skyhaul.evaluation.series import load_run
from skyhaul.evaluation.table import print_table
from skyhaul.jit import told_of_compiling
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import INTERRUPTED, fly
from skyhaul.mission.rehearsal import rehearse
from skyhaul.world.load import load_config


def run(args: argparse.Namespace) -> int:
    """Fly; 0 when the mission is done, 3 when it failed or was broken off.

    Raises:
        SkyhaulError: On bad input; then nothing stays written. What has begun to fly stays.
        KeyboardInterrupt: When it was interrupted; what was flown stays, its notes say where.
    """
    config = load_config(RunConfig, args.scenario, run_overrides(args))
    recorder = _recorder(args.out, config, args.seed)
    broken = _fly(config, args.seed, recorder)
    if isinstance(broken, SkyhaulError):
        print(f"skyhaul: broken off: {broken}", file=sys.stderr)
    try:
        done = _judge(recorder.folder)
    except KeyboardInterrupt as stop:
        stop.add_note(f"the flight is kept in {recorder.folder}, `skyhaul report` makes its report")
        raise
    except OSError as fault:
        why = f"{fault.filename or recorder.folder}: {fault.strerror or fault}"
        sentence = f"{why}; the flight is in {recorder.folder}, `skyhaul report` makes its report"
        if broken is None:
            raise FileError(sentence) from fault
        print(f"skyhaul: {sentence}", file=sys.stderr)
        done = False
    if isinstance(broken, KeyboardInterrupt):
        broken.add_note(f"what was flown is kept in {recorder.folder}, with its report")
        raise broken
    return 0 if done and broken is None else 3


def default_folders(name: str, seed: int) -> Iterator[Path]:
    """Folders under `runs/`, the first that is free is to be taken."""
    plain = re.sub(r"[^\w-]+", "-", name).strip("-")
    base = f"{plain}-seed{seed}-{time.strftime('%Y%m%d-%H%M%S')}"
    yield Path("runs") / base
    for i in itertools.count(2):
        yield Path("runs") / f"{base}-{i}"


def _recorder(out: Path | None, config: RunConfig, seed: int) -> RunRecorder:
    """A recorder in the folder asked for, or in one of its own; nobody else can take it."""
    if out is not None:
        return RunRecorder(out, config, seed)
    for folder in default_folders(config.name, seed):
        try:
            return RunRecorder(folder, config, seed)
        except FolderTakenError:
            continue
    raise AssertionError("there is always a next folder")


def _fly(
    config: RunConfig, seed: int, recorder: RunRecorder
) -> SkyhaulError | KeyboardInterrupt | None:
    """Rehearse, so that figures of time and energy are those of the flight alone; then fly.

    Returns:
        What broke off the flight after it had begun, such as a full disk or Ctrl-C.
    """
    try:
        with FlightBar(config.name, sys.stderr) as bar:
            with told_of_compiling(bar.compiling), TemporaryDirectory() as root:
                count = itertools.count()
                rehearse(
                    config,
                    lambda short: RunRecorder(Path(root) / f"{next(count)}", short, seed),
                    seed,
                )
            gc.freeze()  # modules and kernels stay: the collector need not look at them in flight
            outcome = fly(config, seed, recorder, bar.update)
    except BaseException as fault:
        if recorder.withdraw():
            raise
        if isinstance(fault, SkyhaulError):
            return fault
        fault.add_note(f"what was flown is kept in {recorder.folder}")
        raise
    if outcome.reason != INTERRUPTED:
        return None
    stop = KeyboardInterrupt()
    if recorder.withdraw():
        raise stop  # before its first step: nothing was flown
    return stop


def _judge(folder: Path) -> bool:
    """Write and print what a flight was like; whether its mission is done."""
    flown = load_run(folder)
    metrics = evaluate(flown)
    print_table(metrics)
    write_report(flown, video=False)
    print(f"run folder: {folder}  (open {folder / 'report.html'} in a browser)")
    return bool(metrics["mission_success"])
