# SPDX-License-Identifier: Apache-2.0
"""Results that take effect only after the time it took to compute them."""

from typing import Generic, Literal, TypeVar

from skyhaul.types import TimeUs

Item = TypeVar("Item")

Latency = Literal["none", "measured"]
"""`none`: results take effect at once, so that runs repeat; `measured`: after their wall time."""


class Pending(Generic[Item]):
    """Holds the newest result until it is due; an older one that is still waiting is dropped."""

    def __init__(self, latency: Latency) -> None:
        self._measured = latency == "measured"
        self._waiting: tuple[TimeUs, Item] | None = None

    @property
    def busy(self) -> bool:
        """Whether a result is on its way."""
        return self._waiting is not None

    def put(self, t_us: TimeUs, wall_ms: float, item: Item) -> None:
        """A result begun at t that took this long."""
        self._waiting = (t_us + (round(1e3 * wall_ms) if self._measured else 0), item)

    def drop(self) -> None:
        """Forget what is on its way: something else has come into force."""
        self._waiting = None

    def take(self, t_us: TimeUs) -> Item | None:
        """The result, once it is due."""
        if self._waiting is None or self._waiting[0] > t_us:
            return None
        _, item = self._waiting
        self._waiting = None
        return item
