# SPDX-License-Identifier: Apache-2.0
"""Vehicles that follow a `ForcePlan`: cable direction, attitude and rotors at 500 Hz."""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.control.allocation import AllocationLimits, pseudo_inverse, wrench_weights
from skyhaul.control.api import ForcePlan, VehicleCommand
from skyhaul.control.cable import CableGains
from skyhaul.control.force_plan import PlanArrays, plan_arrays
from skyhaul.control.load_loop import LoadLoop, Wanted, pack_estimate
from skyhaul.control.vehicle_loop import MEMORY_NX, Output, VehicleLoop, fly_from_python
from skyhaul.model.team import Team, TeamArrays
from skyhaul.params import Params
from skyhaul.perception.api import TeamEstimate
from skyhaul.plant.api import PLANT_STEP_US
from skyhaul.types import Array, TimeUs


@dataclass(frozen=True, kw_only=True)
class CableTracking(Params):
    """Cable direction control after Lee (2018), attitude control, tension distribution.

    The gains come from placing poles on the linear model at hover of the default team: load
    (-1.6 +- 1.2 i), cable (-3.4 +- 4.4 i), attitude with rotors (-11 +- 23 i, -75, -118) [1/s].
    """

    kind: Literal["cable"] = "cable"
    cable: CableGains = field(default_factory=CableGains)
    """Cable direction."""
    limits: AllocationLimits = field(default_factory=AllocationLimits)
    """Tension distribution."""
    attitude_stiffness: float = 450.0
    """Roll and pitch, moment per inertia and error [1/s^2]."""
    attitude_damping: float = 38.0
    """Roll and pitch, moment per inertia and rate error [1/s]."""
    yaw_stiffness: float = 30.0
    """Yaw, moment per inertia and error [1/s^2]."""
    yaw_damping: float = 10.0
    """Yaw, moment per inertia and rate error [1/s]."""
    station_stiffness: float = 6.0
    """Position of a vehicle whose cable is slack [1/s^2]."""
    station_damping: float = 4.0
    """Velocity of a vehicle whose cable is slack [1/s]."""
    rate_filter_s: float = 0.008
    """Time constant of the desired attitude's rate [s]."""
    accel_filter_s: float = 0.02
    """Time constant of the desired attitude's angular acceleration [s]."""
    tilt_accel_max: float = 5.0
    """Largest angular acceleration fed forward for the direction of the thrust [rad/s^2]."""
    lead_s: float = 0.008
    """Time constant that the rotors shall seem to have; their own lag or more: no lead [s]."""
    yaw_rate_dps: float = 90.0
    """Largest rate of the heading [deg/s]."""
    tilt_rate_dps: float = 90.0
    """Largest rate of the wanted direction of the thrust [deg/s]."""
    tilt_share: float = 0.5
    """Share of the rotors' range that roll and pitch moments may take from the thrust."""
    tilt_max_deg: float = 60.0
    """Largest tilt of a vehicle's thrust [deg]."""
    error_limit_m: float = 0.8
    """Position errors of the load count up to this [m]."""
    load_observer_rate: float = 1.5
    """Poles of the observer of disturbances of the load [1/s]; 0: none."""
    vehicle_observer_rate: float = 3.0
    """Poles of the observers of disturbances of the vehicles [1/s]; 0: none."""
    disturbance_max_mps2: float = 2.0
    """Largest disturbance made up for [m/s^2]."""
    slack_m: float = 0.005
    """A cable shorter than its length by this carries nothing [m]."""

    def __post_init__(self) -> None:
        attitude = ("attitude_stiffness", "attitude_damping", "yaw_stiffness", "yaw_damping")
        station = ("station_stiffness", "station_damping", "error_limit_m", "slack_m")
        rates = ("tilt_rate_dps", "tilt_accel_max", "yaw_rate_dps")
        filters = ("rate_filter_s", "accel_filter_s")
        for name in (*attitude, *station, *rates, *filters):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        for name in (
            "lead_s",
            "load_observer_rate",
            "vehicle_observer_rate",
            "disturbance_max_mps2",
        ):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")
        if not 0.0 < self.tilt_share <= 1.0:
            raise ValueError(f"tilt_share must lie in (0, 1], got {self.tilt_share}")
        if not 0.0 < self.tilt_max_deg < 85.0:
            raise ValueError(f"tilt_max_deg must lie in (0, 85), got {self.tilt_max_deg}")

    def build(self, team: Team) -> "CableTracker":
        """The controller of a team."""
        loop = VehicleLoop(
            stiffness=(self.attitude_stiffness, self.yaw_stiffness),
            damping=(self.attitude_damping, self.yaw_damping),
            cable=(self.cable.stiffness, self.cable.damping, self.cable.rate_max),
            turn=(self.cable.feed_rate_max, self.cable.damping * self.cable.feed_rate_max),
            station=(self.station_stiffness, self.station_damping),
            rate_filter=self.rate_filter_s,
            accel_filter=self.accel_filter_s,
            tilt_accel=self.tilt_accel_max,
            lead=self.lead_s,
            tilt_rate=math.radians(self.tilt_rate_dps),
            tilt_share=self.tilt_share,
            yaw_rate=math.radians(self.yaw_rate_dps),
            tilt_max=math.radians(self.tilt_max_deg),
            drag=team.vehicle.drag_ns_per_m,
            observer=self.vehicle_observer_rate,
            disturbance_max=self.disturbance_max_mps2,
        )
        return CableTracker(team=team, params=self, arrays=team.arrays(), loop=loop)


class VehicleMemory(NamedTuple):
    """What the controller keeps between ticks."""

    stamp_us: TimeUs | None  # of the last tick
    vehicles: Array  # (n, MEMORY_NX)
    disturbance: Array  # (6,) see `load_loop.Wanted`
    plan: ForcePlan | None  # that `arrays` and `load` were made for
    arrays: PlanArrays | None
    load: LoadLoop | None


@dataclass(frozen=True, eq=False)
class CableTracker:
    """`CableTracking` for one team; a `VehicleController`."""

    team: Team
    params: CableTracking
    arrays: TeamArrays
    loop: VehicleLoop

    def init(self, n: int) -> VehicleMemory:
        """Memory before the first tick, n vehicles."""
        return VehicleMemory(None, np.zeros((n, MEMORY_NX)), np.zeros(6), None, None, None)

    def step(
        self,
        memory: VehicleMemory,
        estimate: TeamEstimate,
        plan: ForcePlan,
        yaw_W: Array,
        scale: float = 1.0,
    ) -> tuple[VehicleMemory, VehicleCommand]:
        """One tick for all vehicles.

        Args:
            memory: From `init` or the tick before.
            estimate: The team now.
            plan: The plan in force; packing a new one takes some 20 us more.
            yaw_W: Headings wanted, (n,) [rad].
            scale: Share of the planned forces to pull with, 0..1, for the lift; below 1 the load
                is taken to rest on the floor.
        """
        return self._fly(memory, estimate, plan, yaw_W, scale, (0, len(yaw_W)))

    def step_one(
        self,
        memory: VehicleMemory,
        estimate: TeamEstimate,
        plan: ForcePlan,
        yaw_W: Array,
        i: int,
        scale: float = 1.0,
    ) -> tuple[VehicleMemory, VehicleCommand]:
        """One tick for vehicle i alone: what an agent runs; the other rows stay zero."""
        return self._fly(memory, estimate, plan, yaw_W, scale, (i, i + 1))

    def _fly(
        self,
        memory: VehicleMemory,
        estimate: TeamEstimate,
        plan: ForcePlan,
        yaw_W: Array,
        scale: float,
        which: tuple[int, int],
    ) -> tuple[VehicleMemory, VehicleCommand]:
        arrays, load = memory.arrays, memory.load
        if memory.plan is not plan or arrays is None or load is None:
            arrays, load = plan_arrays(plan), self._load_loop(plan, memory)
        n, last = len(yaw_W), memory.stamp_us
        elapsed = PLANT_STEP_US if last is None else max(1, estimate.stamp_us - last)
        x = pack_estimate(estimate)
        disturbance = memory.disturbance.copy()
        if last is None:
            disturbance[:3] = x[0, 7:10]
        wanted = Wanted(np.empty((3, n, 3)), np.empty(6), np.empty(n), np.empty(6), disturbance)
        out = Output(np.zeros(n), np.zeros((n, 3)), np.zeros((n, 4)), memory.vehicles.copy())
        clock = (1e-6 * (estimate.stamp_us - plan.stamp_us), 1e-6 * elapsed, float(scale))
        params = (tuple(self.arrays), tuple(load), tuple(self.loop))
        headings = np.array(yaw_W, dtype=np.float64)
        fly_from_python(params, x, tuple(arrays), clock, headings, which, tuple(wanted), tuple(out))
        if which != (0, n):
            out.rotor_cmd[: which[0]] = out.rotor_cmd[which[1] :] = 0.0
        memory = VehicleMemory(estimate.stamp_us, out.memory, disturbance, plan, arrays, load)
        command = VehicleCommand(
            thrust=out.thrust,
            moment_B=out.moment,
            force_W=wanted.force[0],
            dforce_W=wanted.force[1],
            rotor_cmd=out.rotor_cmd,
            wrench_slack_W=wanted.slack,
        )
        return memory, command

    def _load_loop(self, plan: ForcePlan, memory: VehicleMemory) -> LoadLoop:
        """Parameters of the load's loop for the cables that carry in a plan."""
        p, team = self.params, self.team
        same = memory.plan is not None and np.array_equal(memory.plan.active, plan.active)
        if memory.load is not None and same:
            return memory.load
        return LoadLoop(
            share=np.ascontiguousarray(pseudo_inverse(self.arrays.p_LA, plan.active)),
            axis_L=np.ascontiguousarray(team.formation_dirs_L()),
            weight=wrench_weights(p.limits, team.hook_ring_m),
            cone_tan=math.tan(math.radians(p.limits.cone_deg)),
            separation=0.9 * team.separation_m,
            tolerance=p.limits.tolerance_n,
            max_cuts=p.limits.max_cuts,
            error_limit=p.error_limit_m,
            drag=team.payload.drag_ns_per_m,
            observer=p.load_observer_rate,
            disturbance_max=p.disturbance_max_mps2,
            slack=p.slack_m,
            hook_radius=team.hook_ring_m if self.arrays.rigid else 0.0,
        )
