# SPDX-License-Identifier: Apache-2.0
"""What the payload controllers take, and the plan that every vehicle follows."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol, TypeVar

import numpy as np

from skyhaul.mapping.api import WorldMap
from skyhaul.model.state import TeamState
from skyhaul.perception.api import TeamEstimate
from skyhaul.planning.api import Reference
from skyhaul.types import Array, Mask, TimeUs, frozen

Memory = TypeVar("Memory")


class SolveStatus(Enum):
    """Outcome of one solve."""

    OK = "ok"
    NOT_CONVERGED = "not converged"
    """The solver ran out of iterations; the plan is its last iterate and passed the checks."""
    FAILED = "failed"
    """No usable iterate: the plan is the last one, shifted; after its end a safe hover."""


@dataclass(frozen=True, eq=False)
class ForcePlan:
    """Planned load motion, cable forces and feedback along it: what the leader broadcasts.

    Between nodes the load state and the forces are cubic Hermite (attitude: slerp). The force on
    the load wanted from cable i at time t is force_W[i](t) + gain[i](t) e, e the load error
    (layout of `types.ERR_P`) of the measured state against the planned one. After the last node
    the plan rests at it.
    """

    stamp_us: TimeUs  # time of node 0
    node_s: Array  # (K,) times of the nodes after the stamp, rising from 0 [s]
    load: Array  # (K, 13) planned load states
    accel_W: Array  # (K, 3) planned acceleration of the load's centre of mass [m/s^2]
    force_W: Array  # (K, n, 3) force of cable i on the load [N]
    dforce_W: Array  # (K, n, 3) its rate [N/s]
    gain: Array  # (K, n, 3, 12) feedback gain, [N] per unit of error
    thrust: Array  # (K, n) thrust that the plan predicts for each vehicle [N]
    active: Mask  # (n,) cables that carry

    def __post_init__(self) -> None:
        frozen(self.node_s, self.load, self.accel_W, self.force_W, self.dforce_W)
        frozen(self.gain, self.thrust, self.active)

    @property
    def end_us(self) -> TimeUs:
        """Time of the last node."""
        return self.stamp_us + round(1e6 * float(self.node_s[-1]))


@dataclass(frozen=True, eq=False)
class Solution:
    """A plan and the evidence for it."""

    status: SolveStatus
    plan: ForcePlan
    kkt_residual: float  # of the last QP, infinity norm
    iterations: int  # interior-point iterations, all SQP steps together
    slack_m: float  # how far the plan cuts into the clearance of obstacles, at most [m]
    wall_ms: float


@dataclass(frozen=True, eq=False)
class ControlRequest:
    """What a payload controller needs for one solve."""

    stamp_us: TimeUs
    load: Array  # (13,) measured load state
    force_W: Array  # (n, 3) cable forces on the load as commanded now [N]
    dforce_W: Array  # (n, 3) their rates as commanded now [N/s]
    active: Mask  # (n,) cables that carry
    reference: Reference
    world_map: WorldMap
    sqp_iterations: int = 3  # at most; controllers that do not iterate ignore it


class PayloadController(Protocol[Memory]):
    """Load state and reference -> plan of cable forces. Warm starts live in the memory."""

    def init(self) -> Memory:
        """Memory before the first solve."""
        ...

    def solve(self, memory: Memory, request: ControlRequest) -> tuple[Memory, Solution]:
        """One solve. Never raises on a hard problem: the status tells."""
        ...


@dataclass(frozen=True, eq=False)
class VehicleCommand:
    """What the low-level control of one or all vehicles gives."""

    thrust: Array  # (n,) [N]
    moment_B: Array  # (n, 3) [N m]
    force_W: Array  # (n, 3) cable force on the load that was aimed at [N]
    dforce_W: Array  # (n, 3) [N/s]
    rotor_cmd: Array = field(default_factory=lambda: np.empty((0, 4)))
    """Rotor thrusts to ask for, (n, 4) [N], motor lag made up for; empty: mix thrust, moment."""
    wrench_slack_W: Array = field(default_factory=lambda: np.zeros(6))
    """Force [N] and moment [N m] on the load that the limits made us give up, (6,)."""


class VehicleController(Protocol[Memory]):
    """Follows a `ForcePlan` at 500 Hz."""

    def init(self, n: int) -> Memory:
        """Memory before the first tick."""
        ...

    def step(
        self, memory: Memory, estimate: TeamEstimate, plan: ForcePlan, yaw_W: Array
    ) -> tuple[Memory, VehicleCommand]:
        """One tick for all vehicles; `yaw_W` is the heading wanted of each, (n,) [rad]."""
        ...


class FreeFlightController(Protocol):
    """Flies single vehicles to points, cables slack: lift-off, fly-in, after a release."""

    def step(
        self, team: TeamState, p_WD: Array, v_WD: Array, a_WD: Array, yaw_W: Array
    ) -> tuple[Array, Array]:
        """Thrusts (n,) [N] and moments (n, 3) [N m] towards positions (n, 3), W axes."""
        ...
