# SPDX-License-Identifier: Apache-2.0
"""The bus between agents that live in one process."""

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skyhaul.comms.api import Envelope
from skyhaul.comms.messages import encoded_bytes
from skyhaul.params import Params
from skyhaul.types import TimeUs


@dataclass(frozen=True, kw_only=True)
class InProcess(Params):
    """Hands messages over in memory, after a delay, and loses some if asked to."""

    kind: Literal["in-process"] = "in-process"
    delay_ms: float = 0.0
    """Time from sending to arrival [ms]."""
    loss: float = 0.0
    """Share of messages that get lost on the way to one receiver, 0..1."""

    def __post_init__(self) -> None:
        if self.delay_ms < 0.0:
            raise ValueError(f"delay_ms must be >= 0, got {self.delay_ms}")
        if not 0.0 <= self.loss < 1.0:
            raise ValueError(f"loss must lie in [0, 1), got {self.loss}")

    def build(self, n: int, seed: int, tap: Callable[[Envelope[object]], None]) -> "InProcessBus":
        """A bus between n agents; `tap` sees every message once, when it is sent."""
        return InProcessBus(self, n, seed, tap)


class InProcessBus:
    """Implements `comms.api.Bus`."""

    def __init__(
        self, params: InProcess, n: int, seed: int, tap: Callable[[Envelope[object]], None]
    ) -> None:
        self._params, self._tap = params, tap
        self._queues: list[list[tuple[TimeUs, int, Envelope[object]]]] = [[] for _ in range(n)]
        self._sequence: dict[tuple[int, str], int] = {}
        self._sent = 0
        self._rng = np.random.default_rng([seed, 0xB05])

    def publish(self, topic: str, sender: int, t_us: TimeUs, payload: object) -> None:
        """See `Bus.publish`."""
        sequence = self._sequence.get((sender, topic), 0)
        self._sequence[sender, topic] = sequence + 1
        size = encoded_bytes(payload)
        envelope = Envelope(topic, sender, sequence, t_us, size, payload)
        self._tap(envelope)
        arrival = t_us + round(1e3 * self._params.delay_ms)
        for receiver, queue in enumerate(self._queues):
            if receiver == sender:
                continue
            if self._params.loss > 0.0 and self._rng.random() < self._params.loss:
                continue
            heapq.heappush(queue, (arrival, self._sent, envelope))
        self._sent += 1

    def receive(self, receiver: int, t_us: TimeUs) -> list[Envelope[object]]:
        """See `Bus.receive`."""
        queue, out = self._queues[receiver], []
        while queue and queue[0][0] <= t_us:
            out.append(heapq.heappop(queue)[2])
        return out
