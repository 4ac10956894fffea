# SPDX-License-Identifier: Apache-2.0
"""The bar that shows how far a flight is."""

import math
import time
from types import TracebackType
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

from skyhaul.mission.flight import FlightProgress
from skyhaul.types import US_PER_S


class FlightBar:
    """Phase, simulated time, speed against real time, distance to the goal.

    The bar fills with the way to the goal, or with time where there is no goal. Where the
    output is no terminal, it prints a line whenever the phase changes.
    """

    def __init__(self, title: str, file: TextIO) -> None:
        self._console = Console(file=file)
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=28),
            TextColumn("{task.fields[text]}"),
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )
        self._title = title
        self._began = time.perf_counter()
        self._phase, self._compiles = "", False
        self._farthest_m = 0.0

    def __enter__(self) -> "FlightBar":
        self._bar.start()
        self._task = self._bar.add_task(self._title, total=1.0, text="making ready")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()

    def compiling(self, function: str) -> None:
        """Show that a function is compiled, which happens once after an installation."""
        self._bar.update(self._task, text=f"compiling, once: {function}")
        if self._bar.disable and not self._compiles:
            self._console.print(f"{self._title}: compiling, once; this takes some minutes")
        self._compiles = True

    def update(self, now: FlightProgress) -> None:
        """Show one report of the flight."""
        t_s = now.t_us / US_PER_S
        if t_s <= 0.0:
            self._began = time.perf_counter()
        self._bar.update(self._task, completed=self._share(now), text=self._text(now, t_s))
        if now.phase.value != self._phase:
            self._phase = now.phase.value
            if self._bar.disable:
                self._console.print(f"{self._title}: t = {t_s:.1f} s, {self._phase}")

    def _share(self, now: FlightProgress) -> float:
        if math.isnan(now.goal_distance_m):
            return now.t_us / now.limit_us
        self._farthest_m = max(self._farthest_m, now.goal_distance_m)
        return 1.0 - now.goal_distance_m / max(self._farthest_m, 1e-9)

    def _text(self, now: FlightProgress, t_s: float) -> str:
        wall_s = max(time.perf_counter() - self._began, 1e-9)
        parts = [f"{now.phase.value}", f"{t_s:6.1f} s", f"{t_s / wall_s:4.1f}x real time"]
        parts.append(f"{now.speed_mps:4.2f} m/s")
        if not math.isnan(now.goal_distance_m):
            parts.append(f"{now.goal_distance_m:5.2f} m to go")
        return "  ".join(parts)
