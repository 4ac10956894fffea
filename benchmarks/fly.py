# SPDX-License-Identifier: Apache-2.0
"""Flies scenarios for the benchmarks: several at once, each in a temporary run folder."""

import json
import multiprocessing
import os
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from calibration import calibration_s
from provenance import commit

from skyhaul.evaluation.energy import EnergyModel
from skyhaul.evaluation.metrics import Metrics, run_metrics
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.evaluation.series import Run, load_run
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.world.load import load_config

Measure = Callable[[Run], dict[str, Any]]
"""Takes more from a run than its metrics; a function of a module, so that it can be sent."""

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Job:
    """One flight to fly."""

    scenario: str
    seed: int = 0
    overrides: tuple[str, ...] = ()
    case: str = ""
    """Name of the case in the table."""
    movers: bool = True
    """False: only the obstacles that stand from the start on."""
    measures: tuple[Measure, ...] = ()
    """What to take besides the metrics."""


@dataclass(frozen=True)
class Flown:
    """A flight that was flown, or that a fault of the program broke off."""

    job: Job
    metrics: dict[str, Any] = field(default_factory=dict)
    calibration_s: float = 0.0
    """CPU time of the calibration loop, right after the flight [s]."""
    commit: str = ""
    """What was checked out."""

    @property
    def success(self) -> bool:
        """Whether the mission counts as done."""
        return bool(self.metrics.get("mission_success"))


def fly_all(jobs: Sequence[Job], workers: int = 2, kept: Path | None = None) -> list[Flown]:
    """Fly the jobs in processes of one thread each; results in the order of the jobs.

    Args:
        jobs: What to fly.
        workers: Number of processes.
        kept: File to which each flight is added once it is over, and from which those are taken
            that it holds already; so a benchmark that was broken off goes on where it was.
    """
    os.environ.update(dict.fromkeys(THREADS, "1"))
    done = {} if kept is None else read_kept(kept, jobs)
    todo = [job for job in jobs if job not in done]
    context = multiprocessing.get_context("spawn")
    began = time.perf_counter()
    with context.Pool(min(workers, max(1, len(todo)))) as pool:
        for k, one in enumerate(pool.imap(fly_one, todo)):
            done[one.job] = one
            if kept is not None:
                keep(kept, one)
            print(
                f"{time.perf_counter() - began:6.0f} s  {k + 1}/{len(todo)}  {_line(one)}",
                flush=True,
            )
    return [done[job] for job in jobs]


def keep(path: Path, flown: Flown) -> None:
    """Add a flight to a file, one line of JSON each."""
    line = {"job": _key(flown.job), "metrics": flown.metrics}
    line |= {"calibration_s": flown.calibration_s, "commit": flown.commit}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line, default=float) + "\n")


def read_kept(path: Path, jobs: Iterable[Job]) -> dict[Job, Flown]:
    """Those of the jobs whose flights a file holds, at whatever commit they were flown."""
    if not path.exists():
        return {}
    lines = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    by_key = {line.pop("job"): line for line in lines}
    return {job: Flown(job, **by_key[_key(job)]) for job in jobs if _key(job) in by_key}


def _key(job: Job) -> str:
    return " ".join((job.scenario, str(job.seed), str(job.movers), *job.overrides))


def fly_one(job: Job) -> Flown:
    """Fly one job; a fault of the program counts as a flight that failed."""
    try:
        metrics: dict[str, Any] = _fly(job)
    except Exception as fault:
        traceback.print_exc()
        reason = f"fault: {type(fault).__name__}: {fault}"
        metrics = {"mission_success": False, "outcome": reason, "program_faults": 1}
    return Flown(job, metrics, calibration_s(), commit())


def chosen(flown: Iterable[Flown], **wanted: object) -> list[Flown]:
    """The flights whose jobs have these values."""
    return [f for f in flown if all(getattr(f.job, k) == v for k, v in wanted.items())]


def _fly(job: Job) -> Metrics | dict[str, Any]:
    config = load_config(RunConfig, job.scenario, job.overrides)
    if not job.movers:
        config = without_movers(config)
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root) / "run"
        fly(config, job.seed, RunRecorder(folder, config, job.seed))
        run = load_run(folder)
        metrics: dict[str, Any] = dict(run_metrics(run, EnergyModel()))
        for measure in job.measures:
            metrics |= measure(run)
    stages = [v for k, v in metrics.items() if k.startswith("compute_cpu_s_") and v is not None]
    solves, nmpc_s = metrics["nmpc_solves"], metrics.get("compute_cpu_s_nmpc")
    metrics |= {"program_faults": 0, "compute_cpu_s": sum(stages)}
    metrics["nmpc_cpu_ms_mean"] = 1e3 * nmpc_s / solves if solves and nmpc_s else None
    return metrics


def without_movers(config: RunConfig) -> RunConfig:
    """The same flight among only those obstacles that stand from the start on."""
    world = config.world
    still = tuple(o for o in world.obstacles if o.motion.kind == "static" and o.appears is None)
    return replace(config, world=replace(world, obstacles=still))


def _line(flown: Flown) -> str:
    job, m = flown.job, flown.metrics
    name = job.case or job.scenario
    parts = [f"{name}, seed {job.seed}: {'done' if flown.success else 'FAILED'}"]
    if not flown.success:
        parts.append(f"({m.get('outcome')})")
    for key, form in _SHOWN.items():
        if m.get(key) is not None:
            parts.append(form.format(m[key]))
    return "  ".join(parts)


_SHOWN = {
    "mission_time_s": "{:.1f} s",
    "collisions": "{} contacts",
    "min_clearance_m": "clear {:.3f} m",
    "min_tension_n": "tension {:.2f} N",
    "tracking_rmse_m": "rmse {:.4f} m",
    "nmpc_solves": "{} solves",
    "compute_cpu_s": "{:.1f} CPU s",
}
