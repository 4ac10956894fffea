# SPDX-License-Identifier: Apache-2.0
"""What the classifiers of events take and give."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from skyhaul.perception.events.lens import EventLens
from skyhaul.sensors.api import EventReading
from skyhaul.types import Array, TimeUs, frozen

Memory = TypeVar("Memory")

Float32 = NDArray[np.float32]

MOVER_AT = 0.5
"""An event is called a mover's from this probability on."""


@dataclass(frozen=True, eq=False)
class EventScores:
    """How likely each event, and each cell of the image, belongs to a mover."""

    stamp_us: TimeUs
    p_mover: Float32  # (k,) in the order of the reading
    objectness: Float32  # (rows, cols) of the cells, row 0 on top, at the stamp
    cell_px: int  # edge of a cell

    def __post_init__(self) -> None:
        frozen(self.p_mover, self.objectness)

    @property
    def mover(self) -> NDArray[np.bool_]:
        """Which events are called a mover's, (k,)."""
        return self.p_mover >= MOVER_AT


class Work(NamedTuple):
    """What a classifier has done since its memory began, counted where it was done."""

    events: int = 0
    lonely: int = 0
    """Not evaluated: too few neighbours in the graph."""
    refractory: int = 0
    """Not inserted: the pixel fired with the same polarity just before."""
    edges: int = 0
    multiply_adds: int = 0
    pool_updates: int = 0
    """Events after which a cell's maximum had changed."""
    pool_prunes: int = 0
    """Events after which it had not, so that the cell's layers were not evaluated again."""

    @property
    def evaluated(self) -> int:
        """Events that went through every layer."""
        return self.events - self.lonely - self.refractory

    @property
    def skipped_fraction(self) -> float:
        """Share of the events that were not evaluated."""
        return 1.0 - self.evaluated / self.events if self.events else 0.0


class EventClassifier(Protocol[Memory]):
    """Events of one camera -> scores. Stateful through an explicit memory.

    `step` may move its memory on in place: use the one it returns, never one from before.
    """

    def init(self, lens: EventLens) -> Memory:
        """Memory before the first event of a camera."""
        ...

    def step(
        self,
        memory: Memory,
        events: EventReading,
        turn_C: Array,
        v_WC_C: Array | None = None,
    ) -> tuple[Memory, EventScores]:
        """Score events of a camera whose motion is known.

        Args:
            memory: From the call before.
            events: k events after those of the call before.
            turn_C: How far the camera had turned at each, (k, 3) [rad].
            v_WC_C: Its velocity at each, in its own axes, (k, 3) [m/s]; None: it only turns.
        """
        ...

    def work(self, memory: Memory) -> Work:
        """What has been done so far."""
        ...
