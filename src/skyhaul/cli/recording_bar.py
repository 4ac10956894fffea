# SPDX-License-Identifier: Apache-2.0
"""How far a recording has been played, on the terminal; elsewhere nothing."""

import time
from types import TracebackType
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

EVERY_S = 0.25
"""Time between two pictures of the bar [s]."""


class RecordingBar:
    """Time of the recording, speed against real time, what the estimator says."""

    def __init__(self, title: str, duration_s: float, file: TextIO) -> None:
        console = Console(file=file)
        # Drawn by the one who plays: a thread of its own would count as the estimator's time.
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=28),
            TextColumn("{task.fields[text]}", markup=False),
            console=console,
            transient=True,
            auto_refresh=False,
            disable=not console.is_terminal,
        )
        self._title, self._duration_s = title, duration_s
        self._began = self._drawn = time.perf_counter()

    def __enter__(self) -> "RecordingBar":
        self._bar.start()
        self._task = self._bar.add_task(self._title, total=1.0, text="making ready")
        self._bar.refresh()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()

    def begin(self) -> None:
        """Start the clock: what came before was preparation."""
        self._began = time.perf_counter()

    def update(self, done_s: float, status: str) -> None:
        """Show how much of the recording is done, a few times a second at most."""
        now = time.perf_counter()
        if self._bar.disable or now - self._drawn < EVERY_S:
            return
        self._drawn = now
        speed = done_s / max(now - self._began, 1e-9)
        text = f"{done_s:.1f} of {self._duration_s:.1f} s  {speed:.1f}x real time  {status}"
        self._bar.update(self._task, completed=done_s / max(self._duration_s, 1e-9), text=text)
        self._bar.refresh()
