# SPDX-License-Identifier: Apache-2.0
"""The control loop of one vehicle: cable force wanted -> thrust vector -> attitude -> rotors."""

import math
from typing import Any, NamedTuple

import numpy as np

from skyhaul.control.attitude import attitude_moment_kernel, desired_attitude
from skyhaul.control.cable import CableGoal, cable_goal, cable_thrust_vector
from skyhaul.control.force_plan import PlanArrays
from skyhaul.control.load_loop import (
    LoadLoop,
    Wanted,
    observe_disturbance,
    tautness,
    wanted_forces,
)
from skyhaul.control.vectors import across, add, axpy, capped, decay, put, row, scaled, sub
from skyhaul.geometry.kernels import (
    Vec3Out,
    cross,
    dot,
    mat_t_vec,
    norm,
    quat_rotate,
    quat_to_R,
)
from skyhaul.jit import njit
from skyhaul.model.mixer import saturate_rotors_kernel
from skyhaul.model.team import TeamArrays
from skyhaul.types import Array

MEMORY_NX = 21
"""Columns of a vehicle's memory: 0 started, 1:4 filtered thrust direction, 4 heading [rad],
5:9 rotor thrusts as modelled [N], 9:15 disturbance observer (velocity, acceleration),
15:18 wanted thrust direction, limited in rate, 18:21 its filtered angular velocity [rad/s]."""


class VehicleLoop(NamedTuple):
    """Parameters of `fly_vehicles`."""

    stiffness: tuple[float, float]  # attitude: roll and pitch, yaw [1/s^2]
    damping: tuple[float, float]  # [1/s]
    cable: tuple[float, float, float]  # K_xi [1/s^2], K_w [1/s], closing rate [rad/s]
    turn: tuple[float, float]  # largest rate [rad/s], acceleration [rad/s^2] fed forward to cables
    station: tuple[float, float]  # stiffness [1/s^2] and damping [1/s] while the cable is slack
    rate_filter: float  # time constant of the desired attitude's rate [s]
    accel_filter: float  # time constant of the desired attitude's angular acceleration [s]
    tilt_accel: float  # largest angular acceleration fed forward [rad/s^2]
    lead: float  # time constant that the rotors shall seem to have [s]
    yaw_rate: float  # largest [rad/s]
    tilt_rate: float  # largest rate of the wanted thrust direction [rad/s]
    tilt_share: float  # share of the rotors' range that roll and pitch may take from the thrust
    tilt_max: float  # largest angle of the thrust from the vertical [rad]
    drag: float  # linear drag of a vehicle [N s/m]
    observer: float  # rate of the disturbance observer [1/s]; 0: none
    disturbance_max: float  # [m/s^2]


class Output(NamedTuple):
    """What `fly_vehicles` fills in, for every vehicle."""

    thrust: Array  # (n,) [N]
    moment: Array  # (n, 3) [N m]
    rotor_cmd: Array  # (n, 4) [N]
    memory: Array  # (n, MEMORY_NX), advanced


Params = tuple[TeamArrays, LoadLoop, VehicleLoop]
Leaves = tuple[Any, ...]
"""Fields of a NamedTuple as a plain tuple, which enters compiled code in a third of the time."""


@njit
def fly_from_python(
    params: tuple[Leaves, Leaves, Leaves],
    x: Array,
    plan: Leaves,
    clock: tuple[float, float, float],
    yaw: Array,
    which: tuple[int, int],
    wanted: Leaves,
    out: Leaves,
) -> int:
    """`fly_vehicles` for callers that are not compiled; NamedTuples come as their fields."""
    team, load, loop = params
    params_in = (TeamArrays(*team), LoadLoop(*load), VehicleLoop(*loop))
    plan_in, wanted_in = PlanArrays(*plan), Wanted(*wanted)
    return fly_vehicles(params_in, x, plan_in, clock, yaw, which, wanted_in, Output(*out))


@njit
def fly_vehicles(
    params: Params,
    x: Array,
    plan: PlanArrays,
    clock: tuple[float, float, float],
    yaw: Array,
    which: tuple[int, int],
    wanted: Wanted,
    out: Output,
) -> int:
    """One tick of vehicles `which[0]` .. `which[1] - 1`.

    Args:
        params: Team, parameters of the load's and of the vehicles' loop.
        x: Packed estimate, (1 + n, 23).
        plan: The force plan.
        clock: Time after the plan's stamp [s], since the last tick [s], scale of the forces.
        yaw: Headings wanted, (n,) [rad].
        which: First vehicle, and one after the last.
        wanted: Cable forces, filled in for all cables.
        out: Filled in for the chosen vehicles.

    Returns:
        Steps of the tension distribution.
    """
    team, load, loop = params
    steps = wanted_forces(team, load, x, plan, clock, wanted)
    wrench = np.zeros((team.m_B.shape[0], 4))
    for i in range(which[0], which[1]):
        _observe(team, loop, x, clock[1], out.memory[i], i)
        u = _thrust_vector(team, load, loop, x, plan, wanted, i)
        d = (out.memory[i, 12], out.memory[i, 13], out.memory[i, 14])
        u = axpy(-team.m_B[i], d, u)
        xi = (x[1 + i, 13], x[1 + i, 14], x[1 + i, 15])
        pulls = plan.active[i] != 0.0 and tautness(team, load, x, i) > 0.5
        pull = dot(u, xi) if pulls and x[1 + i, 22] != 0.0 else 0.0
        _attitude(team, loop, x, u, yaw[i], clock[1], out, i)
        out.thrust[i] = _thrust(team, x, u, pull, i)
        _make_up_for_lag(team, loop, x, clock[1], wrench, out, i)
    saturate_rotors_kernel(team, wrench, out.rotor_cmd)
    share = decay(clock[1], team.motor_lag)
    for i in range(which[0], which[1]):
        for k in range(4):
            out.memory[i, 5 + k] += share * (out.rotor_cmd[i, k] - out.memory[i, 5 + k])
    return steps


@njit
def _thrust_vector(
    team: TeamArrays,
    load: LoadLoop,
    loop: VehicleLoop,
    x: Array,
    plan: PlanArrays,
    wanted: Wanted,
    i: int,
) -> Vec3Out:
    """Thrust vector of vehicle i, W axes [N], drag of the airframe made up for."""
    v: Vec3Out = (x[1 + i, 7], x[1 + i, 8], x[1 + i, 9])
    m, g = team.m_B[i], team.g
    force = row(wanted.force[0], i)
    if plan.active[i] == 0.0 or x[1 + i, 22] == 0.0 or norm(force) < 1e-6:
        brake = capped(scaled(-m * loop.station[1], v), 0.3 * m * g)
        return add(brake, (0.0, 0.0, m * g))
    goal = cable_goal(force, row(wanted.force[1], i), row(wanted.force[2], i))
    w_D, dw_D = capped(goal.w_W, loop.turn[0]), capped(goal.dw_W, loop.turn[1])
    goal = CableGoal(goal.dir_W, w_D, dw_D)
    taut = tautness(team, load, x, i)
    hook = hook_accel(team, x, wanted.motion, i)
    if x[1 + i, 20] < team.length[i] - 20.0 * load.slack:
        u = _keep_station(team, loop, x, goal, hook, i)
    else:
        xi = (x[1 + i, 13], x[1 + i, 14], x[1 + i, 15])
        w = (x[1 + i, 16], x[1 + i, 17], x[1 + i, 18])
        pull = scaled(max(taut, 0.4), axpy(-wanted.boost[i], xi, force))
        u = cable_thrust_vector(pull, goal, (xi, w), hook, (m, team.length[i]), loop.cable)
    return axpy(loop.drag, v, u)


@njit
def _observe(
    team: TeamArrays, loop: VehicleLoop, x: Array, dt: float, memory: Array, i: int
) -> None:
    """Advance the observer of vehicle i's disturbance, from measured thrust and tension."""
    v: Vec3Out = (x[1 + i, 7], x[1 + i, 8], x[1 + i, 9])
    if memory[0] == 0.0:
        memory[9], memory[10], memory[11] = v
    m = team.m_B[i]
    a = scaled(x[1 + i, 21] / m, quat_rotate(x[1 + i, 3:7], (0.0, 0.0, 1.0)))
    if x[1 + i, 22] != 0.0:
        a = axpy(x[1 + i, 19] / m, (x[1 + i, 13], x[1 + i, 14], x[1 + i, 15]), a)
    a = axpy(-loop.drag / m, v, a)
    a = (a[0], a[1], a[2] - team.g)
    observe_disturbance(memory[9:15], v, a, (dt, loop.observer), loop.disturbance_max)


@njit
def hook_accel(team: TeamArrays, x: Array, motion: Array, i: int) -> Vec3Out:
    """Acceleration of hook i plus g e_3, W axes [m/s^2]: dv + g e_3 + R (dw x r + w x (w x r)).

    At least g / 2 upwards, so that no vehicle dives after a load that falls.
    """
    w = (x[0, 10], x[0, 11], x[0, 12])
    r = row(team.p_LA, i)
    turn = add(cross((motion[3], motion[4], motion[5]), r), cross(w, cross(w, r)))
    turn = quat_rotate(x[0, 3:7], turn)
    up = max(turn[2] + motion[2] + team.g, 0.5 * team.g)
    return turn[0] + motion[0], turn[1] + motion[1], up


@njit
def _keep_station(
    team: TeamArrays, loop: VehicleLoop, x: Array, goal: CableGoal, hook: Vec3Out, i: int
) -> Vec3Out:
    """Thrust vector that makes a slack cable taut where it points, and turns it to its goal.

    The vehicle moves with its hook, whose acceleration (plus g e_3) is `hook`.
    """
    r = row(team.p_LA, i)
    xi = (x[1 + i, 13], x[1 + i, 14], x[1 + i, 15])
    swing = quat_rotate(x[0, 3:7], cross((x[0, 10], x[0, 11], x[0, 12]), r))
    slip = sub(add((x[0, 7], x[0, 8], x[0, 9]), swing), (x[1 + i, 7], x[1 + i, 8], x[1 + i, 9]))
    out = team.length[i] + 0.05 - x[1 + i, 20]
    turn = capped(scaled(-team.length[i], across(goal.dir_W, xi)), 0.2)
    gap = axpy(-min(out, 0.3), xi, turn)
    a = axpy(loop.station[1], slip, scaled(loop.station[0], gap))
    return scaled(team.m_B[i], add(hook, capped(a, 4.0)))


@njit
def limit_tilt(u: Vec3Out, lowest: float, tilt_max: float) -> Vec3Out:
    """A thrust vector with at least `lowest` upwards and at most `tilt_max` off the vertical."""
    up = max(u[2], lowest)
    flat = math.hypot(u[0], u[1])
    shrink = min(1.0, math.tan(tilt_max) * up / max(flat, 1e-9))
    return shrink * u[0], shrink * u[1], up


@njit
def _attitude(
    team: TeamArrays,
    loop: VehicleLoop,
    x: Array,
    u: Vec3Out,
    yaw: float,
    dt: float,
    out: Output,
    i: int,
) -> None:
    """Moment of vehicle i into `out`."""
    R_WB, R_WD = np.empty((3, 3)), np.empty((3, 3))
    quat_to_R(x[1 + i, 3:7], R_WB)
    u_safe = limit_tilt(u, 0.2 * team.m_B[i] * team.g, loop.tilt_max)
    b3 = scaled(1.0 / norm(u_safe), u_safe)
    memory = out.memory[i]
    if memory[0] == 0.0:
        memory[0] = 1.0
        memory[1], memory[2], memory[3] = b3
        memory[4] = math.atan2(-R_WB[0, 1], R_WB[1, 1])
        memory[5:9] = 0.25 * x[1 + i, 21]
        memory[15], memory[16], memory[17] = b3
    b3 = _turn_towards((memory[15], memory[16], memory[17]), b3, loop.tilt_rate * dt)
    memory[15], memory[16], memory[17] = b3
    db3 = scaled(1.0 / loop.rate_filter, sub(b3, (memory[1], memory[2], memory[3])))
    share = decay(dt, loop.rate_filter)
    memory[1] += share * loop.rate_filter * db3[0]
    memory[2] += share * loop.rate_filter * db3[1]
    memory[3] += share * loop.rate_filter * db3[2]
    yaw_step = _heading_step(yaw - memory[4], loop.yaw_rate * dt)
    memory[4] += yaw_step
    desired_attitude(b3, memory[4], R_WD)
    rate = cross(b3, db3)
    change = scaled(1.0 / loop.accel_filter, sub(rate, (memory[18], memory[19], memory[20])))
    memory[18] += dt * change[0]
    memory[19] += dt * change[1]
    memory[20] += dt * change[2]
    w_D = mat_t_vec(R_WD, add(rate, (0.0, 0.0, yaw_step / dt)))
    dw_D = mat_t_vec(R_WD, capped(change, loop.tilt_accel))
    J = row(team.J_B, i)
    k_R = (loop.stiffness[0] * J[0], loop.stiffness[0] * J[1], loop.stiffness[1] * J[2])
    k_w = (loop.damping[0] * J[0], loop.damping[0] * J[1], loop.damping[1] * J[2])
    w = (x[1 + i, 10], x[1 + i, 11], x[1 + i, 12])
    goal = (R_WD, w_D, dw_D)
    put(out.moment, i, attitude_moment_kernel(R_WB, w, goal, J, (k_R, k_w)))


@njit
def _thrust(team: TeamArrays, x: Array, u: Vec3Out, pull: float, i: int) -> float:
    """Thrust of vehicle i for its thrust vector u [N].

    On a taut cable (pull = u . xi < 0) the part along the cable is kept, (u . xi) / (b_3 . xi),
    since the tension follows at once and the direction does not; else u . b_3.
    """
    b3 = quat_rotate(x[1 + i, 3:7], (0.0, 0.0, 1.0))
    thrust = dot(u, b3)
    along = dot(b3, (x[1 + i, 13], x[1 + i, 14], x[1 + i, 15]))
    if pull < 0.0 and along < -0.4:
        thrust = pull / along
    limited: float = min(max(thrust, team.thrust_min[i]), team.thrust_max[i])
    return limited


@njit
def _turn_towards(a: Vec3Out, b: Vec3Out, largest: float) -> Vec3Out:
    """Unit vector from a towards b, by a chord of at most `largest`."""
    c = add(a, capped(sub(b, a), largest))
    return scaled(1.0 / max(norm(c), 1e-6), c)


@njit
def _heading_step(gap: float, largest: float) -> float:
    """Step of the heading towards its goal, the shorter way round [rad]."""
    gap -= 2.0 * math.pi * math.floor(gap / (2.0 * math.pi) + 0.5)
    return min(max(gap, -largest), largest)


@njit
def _make_up_for_lag(
    team: TeamArrays, loop: VehicleLoop, x: Array, dt: float, wrench: Array, out: Output, i: int
) -> None:
    """Wrench to ask for, so that the rotors follow as if their lag were `lead`, into `wrench`.

    In one tick a rotor goes the share s = 1 - exp(-dt / tau) of the way to its command; asking
    for y + (s_lead / s) (y_wanted - y), y what it gives now, makes it go s_lead of the way.
    """
    gain = decay(dt, loop.lead) / decay(dt, team.motor_lag) if team.motor_lag > loop.lead else 1.0
    r = out.memory[i, 5:9]
    lever = team.arm * math.sqrt(0.5)
    roll = lever * (r[0] + r[1] - r[2] - r[3])
    pitch = lever * (r[1] + r[2] - r[0] - r[3])
    now = x[1 + i, 21]
    if gain == 1.0:
        now, roll, pitch = out.thrust[i], out.moment[i, 0], out.moment[i, 1]
    wrench[i, 0] = now + gain * (out.thrust[i] - now)
    roll += gain * (out.moment[i, 0] - roll)
    pitch += gain * (out.moment[i, 1] - pitch)
    shrink = _tilt_authority(team, loop, wrench[i, 0], (abs(roll) + abs(pitch)) / (4.0 * lever), i)
    wrench[i, 1], wrench[i, 2] = shrink * roll, shrink * pitch
    yaw_max = 0.1 * team.torque_per_thrust * team.thrust_max[i]
    wrench[i, 3] = min(max(out.moment[i, 2], -yaw_max), yaw_max)


@njit
def _tilt_authority(
    team: TeamArrays, loop: VehicleLoop, thrust: float, peak: float, i: int
) -> float:
    """Factor on roll and pitch moment that leaves the rotors their thrust.

    Rotors above the mean by `peak` [N] fit where the thrust leaves room; a share of the whole
    range is theirs anyway.
    """
    low, high = 0.25 * team.thrust_min[i], 0.25 * team.thrust_max[i]
    mean = min(max(0.25 * thrust, low), high)
    room = max(min(high - mean, mean - low), 0.5 * loop.tilt_share * (high - low))
    factor: float = min(1.0, room / max(peak, 1e-9))
    return factor
