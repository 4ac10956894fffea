# SPDX-License-Identifier: Apache-2.0
"""Messages that must arrive: sent again until every receiver has told that it has the newest."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from skyhaul.comms.api import Bus, Envelope
from skyhaul.types import TimeUs

PAUSE_US: TimeUs = 60_000
"""Time that a confirmation may take before a message is sent again: twice a delay of 20 ms and
the period of the heartbeats [us]."""


@dataclass(eq=False)
class _Newest:
    """The newest message of a topic, and who has it."""

    payload: object
    stamp_us: TimeUs
    sent_us: TimeUs
    has: set[int] = field(default_factory=set)


class RepeatingBus:
    """Implements `comms.api.Bus`; what is published here is state: the newest message counts.

    Receivers confirm by telling the stamp of what they have, as vehicles do in their heartbeats.
    A stamp rises with every message of a topic, whoever sends it, so that a late copy of an old
    message does no harm.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._newest: dict[str, _Newest] = {}

    def publish(self, topic: str, sender: int, t_us: TimeUs, payload: object) -> None:
        """See `Bus.publish`; remembered until a newer one of the topic replaces it."""
        self._newest[topic] = _Newest(payload, t_us, t_us)
        self._bus.publish(topic, sender, t_us, payload)

    def forget(self) -> None:
        """Repeat nothing of what was published so far, as when another vehicle sends from now."""
        self._newest.clear()

    def receive(self, receiver: int, t_us: TimeUs) -> list[Envelope[object]]:
        """See `Bus.receive`."""
        return self._bus.receive(receiver, t_us)

    def confirm(self, receiver: int, stamps_us: Mapping[str, TimeUs]) -> None:
        """A receiver tells the stamps of the newest messages that it has, by topic."""
        for topic, newest in self._newest.items():
            if stamps_us.get(topic, -1) >= newest.stamp_us:
                newest.has.add(receiver)

    def repeat(self, t_us: TimeUs, sender: int, receivers: Iterable[int]) -> None:
        """Send again what one of the receivers has not confirmed in time."""
        for topic, newest in self._newest.items():
            late = t_us - newest.sent_us >= PAUSE_US
            if late and any(r != sender and r not in newest.has for r in receivers):
                newest.sent_us = t_us
                self._bus.publish(topic, sender, t_us, newest.payload)
