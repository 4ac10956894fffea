# SPDX-License-Identifier: Apache-2.0
"""The team: parameters, states, taut dynamics, formation and flatness.

`skyhaul.model.casadi_model` is imported only where it is used.
"""

from skyhaul.model.convert import cable_state, taut_state, team_state
from skyhaul.model.dynamics import (
    accelerations,
    energy,
    load_acceleration,
    load_derivative,
    momentum,
    slack_cables,
    tensions,
)
from skyhaul.model.flatness import FlatOutputs, flat_outputs
from skyhaul.model.formation import (
    formation_forces,
    hover_attitude,
    hover_forces,
    hover_state,
    hover_wrenches,
)
from skyhaul.model.mixer import rotors_to_wrench, saturate_rotors, wrench_to_rotors
from skyhaul.model.state import CableState, TautState, TeamState
from skyhaul.model.step import step
from skyhaul.model.team import PointPayload, RigidPayload, Team, TeamArrays, Vehicle

__all__ = [
    "CableState",
    "FlatOutputs",
    "PointPayload",
    "RigidPayload",
    "TautState",
    "Team",
    "TeamArrays",
    "TeamState",
    "Vehicle",
    "accelerations",
    "cable_state",
    "energy",
    "flat_outputs",
    "formation_forces",
    "hover_attitude",
    "hover_forces",
    "hover_state",
    "hover_wrenches",
    "load_acceleration",
    "load_derivative",
    "momentum",
    "rotors_to_wrench",
    "saturate_rotors",
    "slack_cables",
    "step",
    "taut_state",
    "team_state",
    "tensions",
    "wrench_to_rotors",
]
