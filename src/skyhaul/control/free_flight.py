# SPDX-License-Identifier: Apache-2.0
"""Position control of single vehicles: lift-off with slack cables, fly-in, after a release."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.control.attitude import attitude_moment_kernel, desired_attitude
from skyhaul.control.vectors import add, axpy, capped, put, row, scaled, sub
from skyhaul.control.vehicle_loop import limit_tilt
from skyhaul.geometry.kernels import Vec3Out, dot, norm, quat_to_R
from skyhaul.jit import njit
from skyhaul.model.mixer import saturate_rotors_kernel
from skyhaul.model.state import TeamState
from skyhaul.model.team import Team, TeamArrays
from skyhaul.params import Params
from skyhaul.types import Array


@dataclass(frozen=True, kw_only=True)
class FreeFlight(Params):
    """PD on the position, feed-forward of the acceleration, attitude control.

    The attitude gains place the poles of body and rotor lag (tau = 30 ms): s^3 tau + s^2 + k_w s +
    k_R has its roots at -15 and -9.2 +- 9.2 i for the defaults. Roll and pitch follow within 0.2 s,
    so the position loop stays below 2.5 rad/s.
    """

    kind: Literal["pd"] = "pd"
    position_stiffness: float = 4.0
    """Acceleration per position error [1/s^2]."""
    velocity_damping: float = 3.4
    """Acceleration per velocity error [1/s]."""
    accel_max_mps2: float = 3.0
    """Largest acceleration asked for by the errors [m/s^2]."""
    attitude_stiffness: float = 76.0
    """Roll and pitch, moment per inertia and error [1/s^2]."""
    attitude_damping: float = 13.4
    """Roll and pitch, moment per inertia and rate error [1/s]."""
    yaw_stiffness: float = 9.0
    """Yaw [1/s^2]."""
    yaw_damping: float = 5.0
    """Yaw [1/s]."""
    tilt_max_deg: float = 35.0
    """Largest tilt of the thrust [deg]."""

    def __post_init__(self) -> None:
        for name in ("position_stiffness", "velocity_damping", "accel_max_mps2"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        for name in ("attitude_stiffness", "attitude_damping", "yaw_stiffness", "yaw_damping"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not 0.0 < self.tilt_max_deg < 85.0:
            raise ValueError(f"tilt_max_deg must lie in (0, 85), got {self.tilt_max_deg}")

    def build(self, team: Team) -> "FreeFlyer":
        """The controller of a team's vehicles."""
        gains = FreeFlightGains(
            position=(self.position_stiffness, self.velocity_damping),
            attitude=(self.attitude_stiffness, self.attitude_damping),
            yaw=(self.yaw_stiffness, self.yaw_damping),
            accel_max=self.accel_max_mps2,
            tilt_max=math.radians(self.tilt_max_deg),
            drag=team.vehicle.drag_ns_per_m,
        )
        return FreeFlyer(arrays=team.arrays(), gains=gains)


class FreeFlightGains(NamedTuple):
    """Parameters of `fly_to`."""

    position: tuple[float, float]
    attitude: tuple[float, float]
    yaw: tuple[float, float]
    accel_max: float  # [m/s^2]
    tilt_max: float  # [rad]
    drag: float  # [N s/m]


@dataclass(frozen=True, eq=False)
class FreeFlyer:
    """`FreeFlight` for one team; a `FreeFlightController`."""

    arrays: TeamArrays
    gains: FreeFlightGains

    def step(
        self,
        team: TeamState,
        p_WD: Array,
        v_WD: Array,
        a_WD: Array,
        yaw_W: Array,
        pull_W: Array | None = None,
    ) -> tuple[Array, Array]:
        """Thrusts (n,) [N] and moments (n, 3) [N m] of all vehicles towards positions.

        Args:
            team: State of the team, of which the vehicles count.
            p_WD: Positions wanted, (n, 3) [m].
            v_WD: Velocities wanted, (n, 3) [m/s].
            a_WD: Accelerations wanted, (n, 3) [m/s^2].
            yaw_W: Headings wanted, (n,) [rad].
            pull_W: Known forces on the vehicles, such as cables that tauten, (n, 3) [N].
        """
        n = team.n
        x, goal = np.empty((n, 13)), np.empty((n, 4, 3))
        x[:, 0:3], x[:, 3:7], x[:, 7:10], x[:, 10:13] = team.p_WB, team.q_WB, team.v_WB, team.w_WB_B
        goal[:, 0], goal[:, 1], goal[:, 2] = p_WD, v_WD, a_WD
        goal[:, 3] = 0.0 if pull_W is None else pull_W
        thrust, moment = np.empty(n), np.empty((n, 3))
        headings = np.array(yaw_W, dtype=np.float64)
        fly_to(self.arrays, self.gains, x, goal, headings, thrust, moment)
        return thrust, moment

    def step_one(
        self, team: TeamState, i: int, goal_W: Array, yaw_rad: float
    ) -> tuple[Array, float, Array]:
        """Rotor thrusts (4,) [N], thrust [N] and moment (3,) [N m] of vehicle i alone.

        Args:
            team: State of the team, of which vehicle i counts.
            i: Which vehicle.
            goal_W: Position, velocity and acceleration wanted, (3, 3) [m, m/s, m/s^2].
            yaw_rad: Heading wanted [rad].
        """
        x, goal, wrench, rotors = np.empty(13), np.zeros((4, 3)), np.empty(4), np.empty(4)
        x[0:3], x[3:7], x[7:10] = team.p_WB[i], team.q_WB[i], team.v_WB[i]
        x[10:13] = team.w_WB_B[i]
        goal[:3] = goal_W
        fly_one(self.arrays, self.gains, i, x, goal, yaw_rad, wrench, rotors)
        return rotors, float(wrench[0]), wrench[1:]


@njit
def fly_to(
    team: TeamArrays,
    gains: FreeFlightGains,
    x: Array,
    goal: Array,
    yaw: Array,
    thrust: Array,
    moment: Array,
) -> None:
    """Thrusts and moments that bring every vehicle to its goal.

    u = m (g e_3 + a_d - sat(k_p (p - p_d) + k_v (v - v_d))) + c v - f_pull

    Args:
        team: The team.
        gains: Gains and limits.
        x: Pose and motion of the vehicles, (n, 13).
        goal: Position, velocity, acceleration wanted and known pull, (n, 4, 3), W axes.
        yaw: Headings wanted, (n,) [rad].
        thrust: (n,) [N], written.
        moment: Body axes, (n, 3) [N m], written.
    """
    for i in range(x.shape[0]):
        thrust[i], torque = _wrench(team, gains, i, x[i], goal[i], yaw[i])
        put(moment, i, torque)


@njit
def fly_one(
    team: TeamArrays,
    gains: FreeFlightGains,
    i: int,
    x: Array,
    goal: Array,
    yaw: float,
    wrench: Array,
    rotors: Array,
) -> None:
    """`fly_to` for vehicle i alone: x (13,), goal (4, 3); writes wrench and rotors, (4,) each."""
    n = team.m_B.shape[0]
    asked, given = np.zeros((n, 4)), np.empty((n, 4))
    thrust, torque = _wrench(team, gains, i, x, goal, yaw)
    asked[i, 0], asked[i, 1], asked[i, 2], asked[i, 3] = thrust, torque[0], torque[1], torque[2]
    saturate_rotors_kernel(team, asked, given)
    wrench[:], rotors[:] = asked[i], given[i]


@njit
def _wrench(
    team: TeamArrays, gains: FreeFlightGains, i: int, x: Array, goal: Array, yaw: float
) -> tuple[float, Vec3Out]:
    """Thrust and moment of vehicle i, see `fly_to`: x (13,), goal (4, 3)."""
    R_WB, R_WD = np.empty((3, 3)), np.empty((3, 3))
    zero = (0.0, 0.0, 0.0)
    v: Vec3Out = (x[7], x[8], x[9])
    e_p, e_v = sub((x[0], x[1], x[2]), row(goal, 0)), sub(v, row(goal, 1))
    back = axpy(gains.position[0], e_p, scaled(gains.position[1], e_v))
    a = sub(row(goal, 2), capped(back, gains.accel_max))
    m = team.m_B[i]
    u = axpy(m, add(a, (0.0, 0.0, team.g)), axpy(gains.drag, v, scaled(-1.0, row(goal, 3))))
    u = limit_tilt(u, 0.2 * m * team.g, gains.tilt_max)
    quat_to_R(x[3:7], R_WB)
    b3 = scaled(1.0 / norm(u), u)
    desired_attitude(b3, _heading(R_WB, yaw), R_WD)
    J = row(team.J_B, i)
    k_R = (gains.attitude[0] * J[0], gains.attitude[0] * J[1], gains.yaw[0] * J[2])
    k_w = (gains.attitude[1] * J[0], gains.attitude[1] * J[1], gains.yaw[1] * J[2])
    w = (x[10], x[11], x[12])
    torque = attitude_moment_kernel(R_WB, w, (R_WD, zero, zero), J, (k_R, k_w))
    lift = dot(u, (R_WB[0, 2], R_WB[1, 2], R_WB[2, 2]))
    return min(max(lift, team.thrust_min[i]), team.thrust_max[i]), torque


@njit
def _heading(R_WB: Array, yaw: float) -> float:
    """A heading at most half a radian from where the body points, towards the one wanted [rad]."""
    now = math.atan2(-R_WB[0, 1], R_WB[1, 1])
    gap = yaw - now
    gap -= 2.0 * math.pi * math.floor(gap / (2.0 * math.pi) + 0.5)
    return now + min(max(gap, -0.5), 0.5)


def creep_speed(tension: Array, tension_max_n: float, speed_mps: float) -> Array:
    """Upward speed of vehicles that take up the slack of their cables, (n,) [m/s].

    v = speed (1 - T / T_max), so that a vehicle stops, and sinks back, as its cable pulls: T stays
    near T_max without a snap.

    Args:
        tension: Tensions, (n,) [N].
        tension_max_n: Tension at which the vehicle stands still [N].
        speed_mps: Speed while the cable is slack [m/s].
    """
    speed: Array = speed_mps * np.clip(1.0 - tension / tension_max_n, -1.0, 1.0)
    return speed
