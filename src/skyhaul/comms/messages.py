# SPDX-License-Identifier: Apache-2.0
"""What agents tell each other."""

from dataclasses import dataclass

import numpy as np

from skyhaul.control.api import ForcePlan
from skyhaul.planning.api import Headings, Reference
from skyhaul.types import Array, Mask, TimeUs

STATUS, FAULT, PLAN, ORDER = "status", "fault", "plan", "order"
"""Topics."""


@dataclass(frozen=True, eq=False)
class Status:
    """Heartbeat of a vehicle with what the leader needs of it; 50 Hz."""

    stamp_us: TimeUs
    vehicle: int
    p_WB: Array  # (3,) [m]
    v_WB: Array  # (3,) [m/s]
    tension: float  # of its cable [N]
    taut: bool  # the tension has been held for a while
    attached: bool
    at_station: bool  # it has reached the place that the phase asks for
    station_in_s: float  # time until then; inf while it stands at its parking place [s]
    on_way_s: float  # how far it is on its way there [s]
    faulty: Mask  # (n,) vehicles that it knows to carry no longer
    hears: Mask  # (n,) vehicles that it has heard a moment ago, itself included
    order_us: TimeUs  # stamp of the order that it has; -1: none yet
    plan_us: TimeUs  # stamp of the plan that it has; -1: none yet


@dataclass(frozen=True, eq=False)
class Fault:
    """A vehicle can carry no longer."""

    stamp_us: TimeUs
    vehicle: int
    reason: str


@dataclass(frozen=True, eq=False)
class PlanMessage:
    """The leader's plan: enough for every follower to fly on through a silence."""

    stamp_us: TimeUs
    plan: ForcePlan
    reference: Reference
    heading: Headings  # of all vehicles


@dataclass(frozen=True, eq=False)
class Order:
    """The leader's phase, and which cables carry."""

    stamp_us: TimeUs
    phase: str  # value of mission.api.Phase
    active: Mask  # (n,)
    retreat: bool  # TAUTEN backwards: return to the parking place
    since_us: TimeUs  # when the phase began


_SIZES = {bool: 1, np.bool_: 1, int: 8, float: 8, np.float64: 8, np.int64: 8}
"""Bytes of the usual kinds, looked up before anything is tried."""
_FLAGS = (bool, np.bool_)
_NUMBERS = (int, float, np.integer)  # tuples: a union is made anew, and slower, at every check


def encoded_bytes(message: object) -> int:
    """Size of a message's arrays and numbers, in the order of their CDR encoding [bytes].

    A float takes 8 bytes, a flag 1, a string its UTF-8 plus 5, an array its data plus 4.
    """
    size = _SIZES.get(type(message))
    if size is not None:
        return size
    if isinstance(message, np.ndarray):
        return int(message.nbytes) + 4
    if isinstance(message, _FLAGS):
        return 1
    if isinstance(message, _NUMBERS):
        return 8
    if isinstance(message, str):
        return len(message.encode()) + 5
    if isinstance(message, (tuple, list)):
        return 4 + sum(encoded_bytes(m) for m in message)
    fields = getattr(message, "__dataclass_fields__", {})
    return sum(encoded_bytes(getattr(message, name)) for name in fields)
