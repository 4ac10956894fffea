# SPDX-License-Identifier: Apache-2.0
"""The control stage's configuration."""

from dataclasses import dataclass, field

from skyhaul.control.failure import ThrustMonitor
from skyhaul.control.free_flight import FreeFlight
from skyhaul.control.geometric import Geometric
from skyhaul.control.nmpc import Nmpc, WrenchNmpc
from skyhaul.control.vehicle import CableTracking
from skyhaul.params import Params

PayloadKind = Nmpc | WrenchNmpc | Geometric


@dataclass(frozen=True, kw_only=True)
class ControlConfig(Params):
    """Which controllers fly."""

    payload: PayloadKind = field(default_factory=Nmpc)
    """Reference -> cable forces."""
    vehicle: CableTracking = field(default_factory=CableTracking)
    """Cable forces -> rotors."""
    free_flight: FreeFlight = field(default_factory=FreeFlight)
    """Vehicles without load."""
    fault: ThrustMonitor = field(default_factory=ThrustMonitor)
    """When a vehicle counts as lost."""
