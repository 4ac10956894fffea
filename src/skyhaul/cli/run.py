# SPDX-License-Identifier: Apache-2.0
"""`skyhaul run`: fly a scenario, write its run folder, print the table."""

import argparse
import gc
import itertools
import re
import shutil
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from skyhaul.cli.overrides import run_overrides
from skyhaul.cli.progress import FlightBar
from skyhaul.errors import FileError, SkyhaulError
from skyhaul.evaluation.metrics import evaluate
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.evaluation.report import write_report
from skyhaul.evaluation.series import load_run
from skyhaul.evaluation.table import print_table
from skyhaul.jit import told_of_compiling
from skyhaul.mission.api import Outcome
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.mission.rehearsal import rehearse
from skyhaul.world.load import load_config


def run(args: argparse.Namespace) -> int:
    """Fly; 0 when the mission is done, 3 when it failed or was interrupted.

    Raises:
        SkyhaulError: On bad input; then nothing stays written.
    """
    config = load_config(RunConfig, args.scenario, run_overrides(args))
    folder = args.out or default_folder(config.name, args.seed)
    fresh = not folder.exists()
    _refuse_used(folder)
    try:
        _fly(config, args.seed, folder)
    except SkyhaulError:
        _clear(folder, remove=fresh)
        raise
    flown = load_run(folder)
    metrics = evaluate(flown)
    print_table(metrics)
    write_report(flown, video=False)
    print(f"run folder: {folder}  (open {folder / 'report.html'} in a browser)")
    return 0 if metrics["mission_success"] else 3


def default_folder(name: str, seed: int) -> Path:
    """A folder under `runs/` that is not taken yet."""
    plain = re.sub(r"[^\w-]+", "-", name).strip("-")
    base = f"{plain}-seed{seed}-{time.strftime('%Y%m%d-%H%M%S')}"
    folder, i = Path("runs") / base, 2
    while folder.exists():
        folder, i = Path("runs") / f"{base}-{i}", i + 1
    return folder


def _fly(config: RunConfig, seed: int, folder: Path) -> Outcome:
    """Rehearse, so that figures of time and energy are those of the flight alone; then fly."""
    with FlightBar(config.name, sys.stderr) as bar:
        with told_of_compiling(bar.compiling), TemporaryDirectory() as root:
            count = itertools.count()
            rehearse(config, lambda short: RunRecorder(Path(root) / f"{next(count)}", short, 0))
        gc.freeze()  # modules and kernels stay: the collector need not look at them in flight
        return fly(config, seed, RunRecorder(folder, config, seed), bar.update)


def _refuse_used(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise FileError(f"--out {folder}: is a file; give a folder")
    if folder.is_dir() and any(folder.iterdir()):
        raise FileError(f"--out {folder}: is not empty; give a new or an empty folder")


def _clear(folder: Path, *, remove: bool) -> None:
    """Undo what a refused flight wrote; the folder held nothing before."""
    if not folder.is_dir():
        return
    shutil.rmtree(folder)
    if not remove:
        folder.mkdir()
