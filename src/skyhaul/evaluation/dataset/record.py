# SPDX-License-Identifier: Apache-2.0
"""A data set from a scenario: fly, simulate the sensors of each body, join the logs.

Each part gets its name when it is whole: `flight/` (a run folder with the truth of every step),
`vehicle_<i>/`, `payload/`, `log.mcap`. What is there is not made again, so an interrupted
recording goes on where it was broken off.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from skyhaul.errors import FileError
from skyhaul.evaluation.dataset import calibration, layout
from skyhaul.evaluation.dataset.euroc import EurocWriter, imu_only
from skyhaul.evaluation.dataset.sensor_log import Body, write_sensor_log
from skyhaul.evaluation.dataset.workers import run_all
from skyhaul.evaluation.folder import LOG, origin, write_json
from skyhaul.evaluation.metrics import evaluate
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import INTERRUPTED, FlightProgress, ShowProgress, fly
from skyhaul.mission.replay import Replay, TrackRecorder, open_replay
from skyhaul.sensors.api import VehicleCalibration
from skyhaul.types import Array
from skyhaul.world.load import dump_config

_SHOW_EVERY = 50  # steps


@dataclass(frozen=True, eq=False)
class Recording:
    """What shall be recorded."""

    config: RunConfig
    seed: int
    folder: Path
    vehicles: tuple[int, ...]
    workers: int = 1

    @property
    def bodies(self) -> list[int | None]:
        """The vehicles, then the load, which is None."""
        return [*self.vehicles, None]


@dataclass(frozen=True, eq=False)
class Show:
    """Who is told how far a recording is."""

    flight: ShowProgress | None
    sensors: Callable[[float], None]  # share of the sensors' work that is done, 0..1
    say: Callable[[str], None]  # a line for people


@dataclass(frozen=True, eq=False)
class BodyJob:
    """The sensors of one body, for a worker process."""

    config: RunConfig
    seed: int
    folder: Path
    vehicle: int | None


def record(recording: Recording, show: Show) -> dict[str, Any]:
    """Make a data set, or what is missing of it.

    Returns:
        The metrics of the flight.

    Raises:
        FileError: When the folder holds something else, or the disk refuses.
        KeyboardInterrupt: When it was interrupted; what is whole stays.
    """
    folder = recording.folder
    with layout.locked(folder), _nothing_half(recording):
        known = _open(recording)
        metrics = _flight(recording, show)
        missing = [b for b in recording.bodies if not (folder / layout.body_name(b)).exists()]
        for body in recording.bodies:
            if body not in missing:
                show.say(f"{layout.body_name(body)} is there already")
        jobs = [BodyJob(recording.config, recording.seed, folder, b) for b in missing]
        run_all(simulate, jobs, recording.workers, show.sensors)
        if known != sorted({*known, *map(layout.body_name, recording.bodies)}):
            _log(recording, known, show)
    return metrics


def simulate(job: BodyJob, show: Callable[[float], None]) -> None:
    """Simulate the sensors of one body over the whole flight and write its folder.

    Raises:
        FileError: When the disk refuses.
    """
    folder = job.folder / layout.body_name(job.vehicle)
    part, config = _cleared(layout.partial(folder)), job.config
    replay = open_replay(config, job.seed, job.folder / layout.FLIGHT / layout.TRACK)
    labels = config.sensors.label_names(config.team, config.world)
    known = calibration_of(config, job.vehicle)
    with EurocWriter(part, known, folder.name, labels) as writer:
        bias = _simulate(replay, job.vehicle, writer, show)
        truth = replay.imu_truth(job.vehicle)
        states = np.column_stack([truth.p_WI, truth.q_WI, truth.v_WI])
        writer.add_truth(truth.t_us, states, bias)
    tag = config.sensors.tag(config.team) if job.vehicle is None else None
    with layout.writing(folder):
        if tag is not None:
            (part / layout.TAG).write_text(calibration.tag_yaml(tag), "utf-8")
        part.replace(folder)


def _cleared(part: Path) -> Path:
    """Remove what an interrupted recording left of a part."""
    with layout.writing(part):
        if part.is_dir():
            shutil.rmtree(part)
        part.unlink(missing_ok=True)
    return part


@contextmanager
def _nothing_half(recording: Recording) -> Iterator[None]:
    """Remove the part that was in the making when an interrupt came."""
    try:
        yield
    except KeyboardInterrupt:
        for name in (layout.FLIGHT, *map(layout.body_name, recording.bodies), layout.LOG):
            _cleared(layout.partial(recording.folder / name))
        raise


def _simulate(
    replay: Replay, vehicle: int | None, writer: EurocWriter, show: Callable[[float], None]
) -> Array:
    """Write all readings; the true biases of the IMU at every step, (m, 6)."""
    steps, bias = len(replay.track), np.empty((len(replay.track), 6))
    if vehicle is None:
        for k, (load, beside) in enumerate(replay.payload_readings()):
            writer.add_imu(load.imu)
            bias[k] = beside.imu_bias
        return bias
    for k, (reading, beside) in enumerate(replay.readings(vehicle)):
        writer.add(reading, beside)
        bias[k] = beside.imu_bias
        if k % _SHOW_EVERY == 0:
            show(k / steps)
    return bias


def calibration_of(config: RunConfig, vehicle: int | None) -> VehicleCalibration:
    """What an estimator may know of the sensors of a vehicle, or of the load."""
    if vehicle is None:
        return imu_only(config.sensors.payload_imu.calibration())
    return config.sensors.calibration()


def _open(recording: Recording) -> list[str]:
    """Begin in an empty folder, or recognise a recording; names of the bodies that its log holds.

    Raises:
        FileError: When it holds something else.
    """
    folder, path = recording.folder, recording.folder / layout.MANIFEST
    made = _origin(recording)
    if not path.is_file():
        if any(folder.iterdir()):
            raise FileError(f"--out {folder}: is not empty; give a new or an empty folder")
        with layout.writing(path):
            write_json(path, made | {"log": []})
        return []
    try:
        found = json.loads(path.read_text("utf-8"))
        log = [str(name) for name in found.pop("log")]
        by = {key: str(found.pop(key)) for key in ("version", "commit")}
    except (ValueError, KeyError, AttributeError) as fault:
        raise FileError(f"{path} is damaged; remove {folder} and record anew") from fault
    mine = {key: made.pop(key) for key in by}
    if found != made:
        raise FileError(
            f"--out {folder}: holds a recording of another scenario, seed or settings "
            f"({found.get('name')}, seed {found.get('seed')}); give another folder"
        )
    if any(by[key] != mine[key] and "unknown" not in (by[key], mine[key]) for key in by):
        raise FileError(
            f"--out {folder}: was begun by skyhaul {by['version']} at {by['commit']}, this is "
            f"{mine['version']} at {mine['commit']}; go on with that one or give another folder"
        )
    return log if (folder / layout.LOG).is_file() else []


def _origin(recording: Recording) -> dict[str, Any]:
    text, made_by = dump_config(recording.config).encode(), origin(recording.seed)
    return {
        "dataset": "euroc",
        "name": recording.config.name,
        "seed": recording.seed,
        "config_sha256": hashlib.sha256(text).hexdigest(),
        "version": made_by.versions["skyhaul"],
        "commit": made_by.commit,
    }


def _flight(recording: Recording, show: Show) -> dict[str, Any]:
    """Fly, unless the flight is there already; its metrics."""
    folder = recording.folder / layout.FLIGHT
    if folder.exists():
        show.say("the flight is there already")
        return evaluate(folder)
    part, config, seed = _cleared(layout.partial(folder)), recording.config, recording.seed
    report = _Report(show.flight)
    with report.apart(), layout.writing(part):  # its log, its tables, its metrics
        recorder = TrackRecorder(RunRecorder(part, config, seed))
        outcome = fly(config, seed, recorder, report)
        if outcome.reason == INTERRUPTED:
            raise KeyboardInterrupt
        recorder.save(part / layout.TRACK)
        metrics = evaluate(part)
        part.replace(folder)
    return metrics


class _Report:
    """Tells how far the flight is; faults of who is told are not taken for the disk's."""

    def __init__(self, show: ShowProgress | None) -> None:
        self._show = show

    def __call__(self, now: FlightProgress) -> None:
        try:
            if self._show is not None:
                self._show(now)
        except OSError as fault:
            raise _NotTold from fault

    @staticmethod
    @contextmanager
    def apart() -> Iterator[None]:
        """Let such a fault come out as what it was."""
        try:
            yield
        except _NotTold as fault:
            raise cast(OSError, fault.__cause__) from None


class _NotTold(Exception):  # noqa: N818  it never leaves this module
    """Carries a fault past those who look for the disk's."""


def _log(recording: Recording, known: list[str], show: Show) -> None:
    """Join the flight's log and the sensors' of all bodies that are there."""
    show.say("joining the logs")
    config, folder = recording.config, recording.folder
    names = {layout.body_name(i): i for i in range(config.team.count)} | {layout.PAYLOAD: None}
    wanted = sorted({*known, *map(layout.body_name, recording.bodies)})
    bodies = [Body(name, calibration_of(config, names[name])) for name in wanted]
    with layout.writing(folder / layout.LOG):
        write_sensor_log(folder / layout.LOG, folder / layout.FLIGHT / LOG, folder, bodies)
        write_json(folder / layout.MANIFEST, _origin(recording) | {"log": wanted})
