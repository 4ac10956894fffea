# SPDX-License-Identifier: Apache-2.0
"""What the flight costs: rotor, computing and radio energy."""

import math
from dataclasses import dataclass

from skyhaul.params import Params

OFF_BOARD_STAGES = frozenset({"plant", "sensors", "logging"})
"""Stages that make up the simulated world or its log; the real team would not compute them."""


@dataclass(frozen=True, kw_only=True)
class EnergyModel(Params):
    """Constants behind the energies."""

    figure_of_merit: float = 0.6
    """Ideal over true power of a hovering rotor; small rotors reach 0.5 to 0.65."""
    air_density_kgpm3: float = 1.225
    """Density of the air [kg/m^3]."""
    compute_w: float = 5.0
    """Power of one busy core of an on-board computer [W], so J per CPU second."""
    radio_j_per_byte: float = 1.0e-6
    """Energy to send a byte [J]; about 2 W of Wi-Fi radio at 16 Mbit/s."""

    def __post_init__(self) -> None:
        if not 0.0 < self.figure_of_merit <= 1.0:
            raise ValueError(f"figure_of_merit must lie in (0, 1], got {self.figure_of_merit}")
        if not self.air_density_kgpm3 > 0.0:
            raise ValueError(f"air_density_kgpm3 must be > 0, got {self.air_density_kgpm3}")
        if self.compute_w < 0.0 or self.radio_j_per_byte < 0.0:
            raise ValueError("compute_w and radio_j_per_byte must be >= 0")


def rotor_power_factor(model: EnergyModel, rotor_radius_m: float) -> float:
    """Power of a rotor over its thrust to the power of 1.5 [W/N^1.5].

    P = T^1.5 / (FM sqrt(2 rho A)), per rotor, A its disc.

    Source:
        Momentum theory in hover; PAPER_NOTES 34.
    """
    disc = math.pi * rotor_radius_m**2
    return 1.0 / (model.figure_of_merit * math.sqrt(2.0 * model.air_density_kgpm3 * disc))


def compute_energy_j(model: EnergyModel, cpu_s: dict[str, float]) -> float:
    """Energy of the computing that the team itself would do [J]."""
    return model.compute_w * sum(s for k, s in cpu_s.items() if k not in OFF_BOARD_STAGES)
