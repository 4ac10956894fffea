# SPDX-License-Identifier: Apache-2.0
"""Who is heard by whom, and who leads by it, as one vehicle knows from heartbeats."""

from collections.abc import Set

import numpy as np

from skyhaul.comms.messages import Status
from skyhaul.types import Mask, TimeUs

SILENT_US: TimeUs = 500_000
"""A vehicle that was not heard for this long is silent: 25 heartbeats, so that a bus that loses
every other message makes nobody silent, and less than a plan lasts [us]."""


class Hearing:
    """When one vehicle last heard each of the others, and whether they hear it."""

    def __init__(self, index: int, n: int) -> None:
        self._index = index
        self._heard_us = np.zeros(n, dtype=np.int64)  # a flight begins at 0: nobody is silent yet
        self._hears_me = np.ones(n, dtype=np.bool_)

    def note(self, t_us: TimeUs, status: Status) -> None:
        """A heartbeat has arrived."""
        self._heard_us[status.vehicle] = t_us
        self._hears_me[status.vehicle] = bool(status.hears[self._index])

    def heard(self, t_us: TimeUs) -> Mask:
        """Which vehicles are not silent, (n,); the own one always is among them."""
        heard = t_us - self._heard_us <= SILENT_US
        heard[self._index] = True
        return np.asarray(heard)

    def alone(self, t_us: TimeUs) -> bool:
        """Whether every other vehicle is silent."""
        return int(self.heard(t_us).sum()) == 1

    def chief(self, t_us: TimeUs, faulty: Set[int]) -> int | None:
        """The lowest vehicle that is not faulty and hears the others; None: nobody can lead.

        Another one counts while it and this one hear each other, this one while that holds with
        any other. One that is cut off, in either direction, thus yields by its own account, and
        in the same moment counts no longer with the others.
        """
        linked = self.heard(t_us) & self._hears_me
        linked[self._index] = False
        linked[self._index] = bool(linked.any())
        able = [j for j in np.flatnonzero(linked).tolist() if j not in faulty]
        return able[0] if able else None
