# SPDX-License-Identifier: Apache-2.0
"""The run folder: its files, and the configuration with its origin."""

import json
import os
import platform
import subprocess
from contextlib import suppress
from dataclasses import dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import yaml

from skyhaul.errors import ConfigError, FileError
from skyhaul.whole import whole
from skyhaul.world.load import dump_config
from skyhaul.world.scenario import Scenario
from skyhaul.world.schema import build

CONFIG, LOG, STATES = "config.yaml", "log.mcap", "states.parquet"
METRICS, REPORT = "metrics.json", "report.html"
FIGURE, VIDEO = "flight.png", "flight.mp4"
"""Names of the files in a run folder."""

_PACKAGES = ("skyhaul", "numpy", "scipy", "numba", "casadi", "mujoco", "pyarrow", "mcap")
_HEAD = (
    "# A flight of skyhaul. This file can be flown again: skyhaul run config.yaml --seed {seed}\n"
)
_ORIGIN = "# origin: "


@dataclass(frozen=True)
class Origin:
    """What made a run, besides its configuration."""

    seed: int
    commit: str
    """`git describe` of the source tree, or `unknown`."""
    versions: dict[str, str]
    """Python and packages."""
    machine: str


def origin(seed: int) -> Origin:
    """The origin of a run that is started now."""
    versions = {"python": platform.python_version()} | {p: _version(p) for p in _PACKAGES}
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    return Origin(seed, _commit(), versions, machine)


class FolderTakenError(FileError):
    """The folder is not empty: it holds another run, or something else."""


def create(folder: Path, config: Scenario, source: Origin) -> tuple[Path, ...]:
    """Take a new or empty folder for a run; its `config.yaml` is the lock.

    Returns:
        The folders that were made, the deepest first; none when it was there.

    Raises:
        FolderTakenError: when it is not empty, or another process is faster.
        FileError: when it cannot be made or written.
    """
    taken = FolderTakenError(f"{folder}: is not empty; give a new or an empty folder")
    try:
        made = _make(folder)
        if not made and any(folder.iterdir()):
            raise taken
        lock = (folder / CONFIG).open("x", encoding="utf-8")
    except FileExistsError:
        raise taken from None
    except OSError as fault:
        raise FileError(f"{folder} cannot be made: {fault.strerror}") from fault
    text = _HEAD.format(seed=source.seed) + _ORIGIN + json.dumps(vars(source)) + "\n"
    try:
        with lock:
            lock.write(text + dump_config(config))
    except OSError as fault:
        remove(folder, made)
        raise FileError(f"{folder / CONFIG} cannot be written: {fault.strerror}") from fault
    return made


def remove(folder: Path, made: tuple[Path, ...]) -> None:
    """Undo `create`, and what a flight wrote that has not begun; nothing else is touched."""
    for name in (LOG, STATES, CONFIG):
        (folder / name).unlink(missing_ok=True)
    with suppress(OSError):  # somebody else may have put something there
        for path in made:
            path.rmdir()


def _make(folder: Path) -> tuple[Path, ...]:
    """Make a folder unless it is there; what was made, the deepest first."""
    missing = tuple(p for p in (folder, *folder.parents) if not p.exists())
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        if not folder.is_dir():
            raise FileError(f"{folder}: is a file; give a folder") from None
        return ()
    return missing


def read_config(folder: Path) -> tuple[Scenario, Origin]:
    """Scenario part of the configuration, and the origin of a run.

    Raises:
        FileError: when the folder holds no run, or its configuration is damaged.
    """
    path = folder / CONFIG
    if not path.is_file():
        raise FileError(f"{folder} is no run folder: it has no {CONFIG}")
    damaged = f"{path} is damaged"
    try:
        text = path.read_text(encoding="utf-8")
        whole = yaml.safe_load(text)
    except (yaml.YAMLError, UnicodeDecodeError, ValueError, RecursionError):
        raise FileError(f"{damaged}: it is no YAML") from None
    if not isinstance(whole, dict):
        raise FileError(f"{damaged}: it is no mapping")
    known = {f.name for f in fields(Scenario)}
    tree: dict[str, Any] = {k: v for k, v in whole.items() if k in known}
    try:
        return build(Scenario, tree), _read_origin(path, text)
    except ConfigError as error:
        raise FileError(f"{damaged}: {error}") from None


def write_json(path: Path, data: object) -> None:
    """Write JSON so that a reader finds the old file or the new one, never half of one."""
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a text whole or not at all."""
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")


def read_metrics(folder: Path) -> dict[str, Any]:
    """The metrics of a run.

    Raises:
        FileError: when they have not been written, or are damaged.
    """
    path = folder / METRICS
    if not path.is_file():
        raise FileError(f"{path} does not exist; `skyhaul report {folder}` makes it")
    try:
        metrics = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        metrics = None
    if not isinstance(metrics, dict):
        raise FileError(f"{path} is damaged: no JSON object; `skyhaul report {folder}` makes it")
    return metrics


def _read_origin(path: Path, text: str) -> Origin:
    for line in text.splitlines():
        if line.startswith(_ORIGIN):
            try:
                return Origin(**json.loads(line[len(_ORIGIN) :]))
            except (ValueError, TypeError):
                raise FileError(f"{path} is damaged: its line {_ORIGIN.strip()!r}") from None
    raise FileError(f"{path} has no line {_ORIGIN.strip()!r}: it was not written by a run")


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _commit() -> str:
    """State of the source tree; an installed wheel has none."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"
    return result.stdout.strip() or "unknown"
