# SPDX-License-Identifier: Apache-2.0
"""What the recorder is told at every step."""

import numpy as np

from skyhaul.control.api import VehicleCommand
from skyhaul.control.force_plan import sample_plan
from skyhaul.geometry.kernels import R_to_quat
from skyhaul.geometry.so3 import vee
from skyhaul.mission.api import AIRBORNE, Tick
from skyhaul.mission.leader import Leader
from skyhaul.mission.vehicle import Actuation
from skyhaul.model.flatness import flat_outputs
from skyhaul.model.team import Team
from skyhaul.perception.api import TeamEstimate
from skyhaul.planning.api import RefSample
from skyhaul.plant.api import Truth
from skyhaul.types import LOAD_NX, LOAD_P, LOAD_Q, LOAD_V, LOAD_W, Array, Mask

PLAN_PERIOD_US = 10_000
"""Plans, references and commands are sampled this often for the record [us]."""


class TickMaker:
    """Makes the record of each step; all but truth and estimate are sampled at 100 Hz."""

    def __init__(self, team: Team) -> None:
        self._team, n = team, team.count
        self._reference = np.full(LOAD_NX, np.nan)
        self._force, self._thrust = np.full((n, 3), np.nan), np.full(n, np.nan)
        self._flat_dir = np.full((n, 3), np.nan)
        self._command = _command_of([])

    def make(
        self, truth: Truth, estimate: TeamEstimate, leader: Leader, actuations: list[Actuation]
    ) -> Tick:
        """The record of one step."""
        if truth.stamp_us % PLAN_PERIOD_US == 0:
            self._sample(truth.stamp_us, leader)
            self._command = _command_of(actuations)
        return Tick(
            truth=truth,
            estimate=estimate,
            phase=leader.phase,
            reference=self._reference,
            command=self._command,
            rotor_cmd=self._command.rotor_cmd,
            planned_force_W=self._force,
            planned_thrust=self._thrust,
            flat_cable_dir_W=self._flat_dir,
        )

    def _sample(self, t_us: int, leader: Leader) -> None:
        message = leader.forces.message
        if message is not None:
            planned = sample_plan(message.plan, t_us)
            self._force, self._thrust = planned.force_W, planned.thrust
        if leader.reference is not None and leader.phase in AIRBORNE:
            sample = leader.reference.sample(np.array([t_us]))
            self._reference = load_of(sample)
            self._flat_dir = self._flat_cables(sample, leader.active)

    def _flat_cables(self, sample: RefSample, active: Mask) -> Array:
        yaw = np.zeros((self._team.count, 3))
        flat = flat_outputs(self._team, sample.p_WD[0], sample.R_WD[0], yaw, active)
        return np.asarray(flat.cable_dir_W[0])


def _command_of(actuations: list[Actuation]) -> VehicleCommand:
    """What the agents ask of their hardware, one row each."""
    return VehicleCommand(
        thrust=np.array([a.thrust for a in actuations]),
        moment_B=np.array([a.moment_B for a in actuations]),
        force_W=np.array([a.force_W for a in actuations]),
        dforce_W=np.array([a.dforce_W for a in actuations]),
        rotor_cmd=np.array([a.rotor_cmd for a in actuations]),
    )


def load_of(sample: RefSample) -> Array:
    """The first reference of a sample as a load state, (13,)."""
    x = np.empty(LOAD_NX)
    R, dR = sample.R_WD[0, 0], sample.R_WD[0, 1]
    x[LOAD_P], x[LOAD_V] = sample.p_WD[0, 0], sample.p_WD[0, 1]
    x[LOAD_Q], x[LOAD_W] = R_to_quat(R), vee(R.T @ dR)
    return x
