# SPDX-License-Identifier: Apache-2.0
"""What the recorder is told at every step."""

from dataclasses import dataclass

import numpy as np

from skyhaul.control.api import VehicleCommand
from skyhaul.geometry.kernels import R_to_quat
from skyhaul.geometry.so3 import vee
from skyhaul.mission.api import PULLING, Tick
from skyhaul.mission.leader import Leader
from skyhaul.model.flatness import flat_outputs
from skyhaul.model.team import Team
from skyhaul.perception.api import TeamEstimate
from skyhaul.planning.api import Reference, RefSample
from skyhaul.plant.api import Truth
from skyhaul.types import LOAD_NX, LOAD_P, LOAD_Q, LOAD_V, LOAD_W, Array, Mask, TimeUs

PLAN_PERIOD_US: TimeUs = 10_000
"""Plans, references and commands are sampled this often for the record [us]."""
AHEAD = 50
"""Samples of a reference that are taken at once, since one costs little less than many."""


@dataclass(frozen=True, eq=False)
class ReferenceRows:
    """A reference and the cables' flat directions along it, at `PLAN_PERIOD_US` from `start_us`."""

    reference: Reference
    active: Mask  # (n,) the cables that carry
    start_us: TimeUs
    load: Array  # (AHEAD, 13)
    cable_dir_W: Array  # (AHEAD, n, 3)

    def row(self, t_us: TimeUs, reference: Reference, active: Mask) -> int | None:
        """Row of a time for this reference and these cables; None where it is not in here."""
        k = (t_us - self.start_us) // PLAN_PERIOD_US
        known = self.reference is reference and self.active is active
        return k if known and 0 <= k < AHEAD else None


class TickMaker:
    """Makes the record of each step; all but truth and estimate are sampled at 100 Hz."""

    def __init__(self, team: Team) -> None:
        self._team, n = team, team.count
        self._reference = np.full(LOAD_NX, np.nan)
        self._force, self._thrust = np.full((n, 3), np.nan), np.full(n, np.nan)
        self._flat_dir = np.full((n, 3), np.nan)
        self._rows: ReferenceRows | None = None
        self._command: VehicleCommand | None = None

    def make(
        self, truth: Truth, estimate: TeamEstimate, leader: Leader, command: VehicleCommand
    ) -> Tick:
        """The record of one step."""
        if truth.stamp_us % PLAN_PERIOD_US == 0 or self._command is None:
            self._sample(truth.stamp_us, leader)
            self._command = command
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

    def _sample(self, t_us: TimeUs, leader: Leader) -> None:
        planned = leader.forces.planned(t_us)
        if planned is not None:
            self._force, self._thrust = planned.force_W, planned.thrust
        if leader.reference is not None and leader.phase in PULLING:
            reference, active = leader.reference, leader.active
            k = None if self._rows is None else self._rows.row(t_us, reference, active)
            if self._rows is None or k is None:
                self._rows, k = rows_ahead(self._team, reference, active, t_us), 0
            self._reference = self._rows.load[k]
            self._flat_dir = self._rows.cable_dir_W[k]


def rows_ahead(team: Team, reference: Reference, active: Mask, t_us: TimeUs) -> ReferenceRows:
    """A reference from a time on."""
    sample = reference.sample(t_us + PLAN_PERIOD_US * np.arange(AHEAD, dtype=np.float64))
    yaw = np.zeros((team.count, 3))
    flat = flat_outputs(team, sample.p_WD, sample.R_WD, yaw, active)
    cable_dir_W = np.ascontiguousarray(flat.cable_dir_W[:, 0])
    return ReferenceRows(reference, active, t_us, loads_of(sample), cable_dir_W)


def loads_of(sample: RefSample) -> Array:
    """References of a sample as load states, (k, 13)."""
    x = np.empty((len(sample.p_WD), LOAD_NX))
    x[:, LOAD_P], x[:, LOAD_V] = sample.p_WD[:, 0], sample.p_WD[:, 1]
    for row, (R, dR) in zip(x, sample.R_WD[:, :2], strict=True):
        row[LOAD_Q], row[LOAD_W] = R_to_quat(R), vee(R.T @ dR)
    return x
