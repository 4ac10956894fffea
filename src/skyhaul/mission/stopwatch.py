# SPDX-License-Identifier: Apache-2.0
"""CPU time by stage: wall time by stage, scaled to the CPU time of the whole flight."""

import time
from collections import defaultdict
from types import TracebackType


class Stopwatch:
    """Adds up time by stage; a stage inside another counts only once.

    The system's CPU clock costs microseconds to read, the wall clock nanoseconds; so the wall
    clock is read at every stage and the CPU clock only at the ends.
    """

    def __init__(self) -> None:
        self._wall_s: dict[str, float] = defaultdict(float)
        self._began = (time.perf_counter(), time.process_time())
        self._stages: dict[str, _Stage] = {}
        self._open: list[str] = []
        self._since = 0.0

    def stage(self, name: str) -> "_Stage":
        """Count what runs inside under a stage."""
        if name not in self._stages:
            self._stages[name] = _Stage(self, name)
        return self._stages[name]

    def cpu_s(self) -> dict[str, float]:
        """CPU time by stage so far [s]."""
        wall = max(time.perf_counter() - self._began[0], 1e-9)
        share = (time.process_time() - self._began[1]) / wall
        return {name: share * spent for name, spent in self._wall_s.items()}

    def _enter(self, name: str) -> None:
        now = time.perf_counter()
        if self._open:
            self._wall_s[self._open[-1]] += now - self._since
        self._open.append(name)
        self._since = now

    def _leave(self) -> None:
        now = time.perf_counter()
        self._wall_s[self._open.pop()] += now - self._since
        self._since = now


class _Stage:
    def __init__(self, watch: Stopwatch, name: str) -> None:
        self._watch, self._name = watch, name

    def __enter__(self) -> None:
        self._watch._enter(self._name)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._watch._leave()
