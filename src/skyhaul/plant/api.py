# SPDX-License-Identifier: Apache-2.0
"""What the plant takes and gives: the only place where truth is made."""

from dataclasses import dataclass
from typing import Protocol

from skyhaul.geometry.shapes import ShapeArrays
from skyhaul.model.state import CableState, TeamState
from skyhaul.types import Array, Mask, TimeUs, frozen

PLANT_STEP_US = 2_000
"""Step of the plant, of the control loop and of the IMU [us]."""


@dataclass(frozen=True, eq=False)
class Contact:
    """Two bodies touch; logged once when it begins."""

    stamp_us: TimeUs
    body_a: str
    """`payload`, `vehicle 0` .., `cable 0` ..; cables "touch" when their clearance is <= 0."""
    body_b: str
    """One of the same, an obstacle's name, or `room`."""


@dataclass(frozen=True, eq=False)
class Truth:
    """True state of everything at one time. Only `plant`, `sensors` and `evaluation` read it."""

    stamp_us: TimeUs
    team: TeamState
    cables: CableState
    attached: Mask  # (n,) the cable still joins vehicle and load
    alive: Mask  # (n,) the rotors still turn
    rotor_thrust: Array  # (n, 4) [N]
    accel_W: Array  # (1 + n, 3) acceleration of load and vehicles, W axes [m/s^2]
    obstacles: ShapeArrays  # all obstacles of the scenario
    v_WO: Array  # (m, 3) their velocities [m/s]
    present: Mask  # (m,) which of them exist by now
    wind_W: Array  # (3,) at the load [m/s]
    clearance_m: float  # smallest distance of payload, vehicles, attached cables to any obstacle
    contacts: tuple[Contact, ...]  # that began since the step before

    def __post_init__(self) -> None:
        frozen(self.attached, self.alive, self.rotor_thrust, self.accel_W, self.v_WO)
        frozen(self.present, self.wind_W)


class Plant(Protocol):
    """The world that flies. Stateful: there is one of it."""

    def truth(self) -> Truth:
        """State now."""
        ...

    def step(self, rotor_cmd: Array) -> Truth:
        """Advance `PLANT_STEP_US` under commanded rotor thrusts, (n, 4) [N]; clipped per rotor."""
        ...

    def release_hook(self, i: int) -> None:
        """Open the quick-release hook of cable i."""
        ...

    def attach_hook(self, i: int) -> bool:
        """Close hook i on the load; False when the cable's end is too far from it (fly-in)."""
        ...
