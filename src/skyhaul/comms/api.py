# SPDX-License-Identifier: Apache-2.0
"""Messages between agents, and the bus that carries them."""

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from skyhaul.types import TimeUs

M = TypeVar("M", covariant=True)


@dataclass(frozen=True, eq=False)
class Envelope(Generic[M]):
    """One message on its way."""

    topic: str
    sender: int  # index of the agent
    sequence: int  # rises by one per sender and topic
    sent_us: TimeUs
    size_bytes: int  # of the encoded message
    payload: M


class Bus(Protocol):
    """Carries messages between agents; may delay or lose them."""

    def publish(self, topic: str, sender: int, t_us: TimeUs, payload: object) -> None:
        """Send to every other agent and to the recorder."""
        ...

    def receive(self, receiver: int, t_us: TimeUs) -> list[Envelope[object]]:
        """What has arrived for an agent by now, in order of sending; each is given once."""
        ...
