# SPDX-License-Identifier: Apache-2.0
"""`skyhaul record`: fly a scenario and write what the sensors saw as a data set."""

import argparse
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn

from skyhaul.cli.overrides import overrides_of
from skyhaul.cli.progress import FlightBar
from skyhaul.errors import ConfigError
from skyhaul.evaluation.dataset import layout
from skyhaul.evaluation.dataset.record import Recording, Show
from skyhaul.evaluation.dataset.record import record as make
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import FlightProgress
from skyhaul.world.load import load_config


def record(args: argparse.Namespace) -> int:
    """Fly and write the data set; 0 when it is whole.

    Raises:
        SkyhaulError: On bad input, or when the disk refuses.
    """
    if args.dataset != "euroc":
        raise ConfigError(f"--dataset {args.dataset}: unknown; allowed: euroc")
    config = load_config(RunConfig, args.scenario, overrides_of(args))
    vehicles = _vehicles(args.vehicles, config.team.count)
    recording = Recording(config, args.seed, args.out, vehicles, args.workers)
    with RecordBars(config.name) as bars:
        metrics = make(recording, Show(bars.flight, bars.sensors, bars.say))
    outcome = "done" if metrics["mission_success"] else "failed"
    print(f"mission {outcome}, {metrics['mission_time_s']:.1f} s of flight")
    print(f"data set: {_list(args.out, vehicles)}; all topics: {args.out / layout.LOG}")
    return 0


class RecordBars:
    """The flight's bar, then one for the sensors."""

    def __init__(self, title: str) -> None:
        self._console = Console(file=sys.stderr)
        self._flight: FlightBar | None = None
        self._title = title
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("[bold]sensors"),
            BarColumn(bar_width=28),
            TaskProgressColumn(),
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("sensors", total=1.0)

    def __enter__(self) -> "RecordBars":
        return self

    def __exit__(self, *_: object) -> None:
        self._end_flight()
        self._bar.stop()

    def flight(self, now: FlightProgress) -> None:
        """Show how far the flight is."""
        if self._flight is None:
            self._flight = FlightBar(self._title, sys.stderr)
            self._flight.__enter__()
        self._flight.update(now)

    def sensors(self, share: float) -> None:
        """Show how far the sensors are."""
        self._end_flight()
        self._bar.start()
        self._bar.update(self._task, completed=share)

    def say(self, line: str) -> None:
        """Print a line."""
        self._end_flight()
        self._console.print(f"{self._title}: {line}")

    def _end_flight(self) -> None:
        if self._flight is not None:
            self._flight.__exit__(None, None, None)
            self._flight = None


def _vehicles(text: str | None, n: int) -> tuple[int, ...]:
    """The vehicles of --vehicles, in order, each once; default: all."""
    if text is None:
        return tuple(range(n))
    try:
        wanted = sorted({int(word) for word in text.split(",")})
    except ValueError:
        raise ConfigError(f"--vehicles {text}: write numbers with commas, as in 0,2") from None
    for i in wanted:
        if not 0 <= i < n:
            raise ConfigError(f"--vehicles {text}: there is no vehicle {i}; allowed: 0 to {n - 1}")
    return tuple(wanted)


def _list(folder: Path, vehicles: tuple[int, ...]) -> str:
    return ", ".join(str(folder / layout.body_name(i)) for i in (*vehicles, None))
