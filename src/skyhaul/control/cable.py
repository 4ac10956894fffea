# SPDX-License-Identifier: Apache-2.0
"""Cable direction control: the thrust vector that makes a vehicle pull its cable as wanted."""

from dataclasses import dataclass
from typing import NamedTuple

from skyhaul.control.vectors import across, add, axpy, capped, scaled
from skyhaul.geometry.kernels import Vec3Out, cross, dot, norm
from skyhaul.jit import njit
from skyhaul.params import Params
from skyhaul.types import Array


@dataclass(frozen=True, kw_only=True)
class CableGains(Params):
    """Gains of `cable_thrust_vector`."""

    stiffness: float = 36.0
    """K_xi, on the direction error [1/s^2]."""
    damping: float = 10.0
    """K_w, on the rate error [1/s]."""
    rate_max: float = 0.4
    """Rate at which large direction errors are closed [rad/s]."""
    feed_rate_max: float = 3.0
    """Largest angular velocity fed forward [rad/s]; the acceleration likewise, times K_w."""

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping", "rate_max", "feed_rate_max"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")


class CableGoal(NamedTuple):
    """Wanted direction of a cable, vehicle to load, its angular velocity and acceleration."""

    dir_W: Vec3Out
    w_W: Vec3Out  # [rad/s]
    dw_W: Vec3Out  # [rad/s^2]


@njit
def cable_goal(force: Vec3Out, dforce: Vec3Out, ddforce: Vec3Out) -> CableGoal:
    """Direction and its motion for a cable that shall pull the load with a force (not zero).

    xi_d = -f / |f|, w_d = xi_d x dxi_d, dw_d = xi_d x ddxi_d

    Args:
        force: Force of the cable on the load, W axes [N].
        dforce: Its rate [N/s].
        ddforce: Its second derivative [N/s^2].

    Source: Paper eq. (27); PAPER_NOTES 18: the paper leaves the derivative of xi_d open.
    """
    size = norm(force)
    xi = scaled(-1.0 / size, force)
    dxi = scaled(-1.0 / size, across(dforce, xi))
    dsize = -dot(xi, dforce)
    ddxi = scaled(-1.0 / size, axpy(2.0 * dsize, dxi, across(ddforce, xi)))
    return CableGoal(xi, cross(xi, dxi), cross(xi, ddxi))


@njit
def cable_thrust_vector(
    force: Vec3Out,
    goal: CableGoal,
    cable: tuple[Vec3Out, Vec3Out],
    hook_accel: Vec3Out,
    inertia: tuple[float, float],
    gains: tuple[float, float, float],
) -> Vec3Out:
    """Thrust vector u of a vehicle that pulls its taut cable, W axes [N].

    u_par  = xi xi^T f + m l |w|^2 xi + m xi xi^T a
    u_perp = -m l xi x (K_xi e_xi + K_w e_w + (xi . w_d) dxi + xi x (xi x dw_d)) - m xi x (xi x a)
    e_xi = xi_d x xi,  e_w = w + xi x (xi x w_d)

    Args:
        force: Wanted force f of the cable on the load, W axes [N].
        goal: Wanted direction and its motion, from `cable_goal`.
        cable: Direction xi, vehicle to load, and angular velocity w of the cable [rad/s].
        hook_accel: Acceleration of the hook, plus g e_3: a, from the model under the commanded
            forces, never from differentiated measurements [m/s^2].
        inertia: Mass of the vehicle m [kg], length of the cable l [m].
        gains: K_xi [1/s^2], K_w [1/s], and the rate at which large errors are closed [rad/s].

    Source:
        Paper eq. (28); Lee, Geometric control of quadrotor UAVs transporting a cable-suspended
        rigid body, IEEE TCST 26 (2018).

    Deviation:
        The paper never gives u_k. The term with dw_d matters on fast swings: see
        `test_swing_is_followed_within_a_tenth_of_a_degree`.
    """
    xi, w = cable
    m, length = inertia
    along = dot(xi, force) + m * length * dot(w, w) + m * dot(xi, hook_accel)
    e_xi = cross(goal.dir_W, xi)
    e_w = add(w, cross(xi, cross(xi, goal.w_W)))
    x = axpy(gains[1], e_w, capped(scaled(gains[0], e_xi), gains[1] * gains[2]))
    x = axpy(dot(xi, goal.w_W), cross(w, xi), x)
    x = add(x, cross(xi, cross(xi, goal.dw_W)))
    turn = scaled(-m * length, cross(xi, x))
    hold = scaled(m, across(hook_accel, xi))
    return axpy(along, xi, add(turn, hold))


@njit
def tension_wanted(force: Vec3Out, xi: Vec3Out) -> float:
    """Tension that a taut cable along xi takes when its vehicle pulls for `force` [N]; >= 0."""
    return max(0.0, -dot(force, xi))


@njit
def model_motion(
    load: Array,
    total: tuple[Vec3Out, Vec3Out],
    body: tuple[float, Vec3Out],
    gravity: float,
    out: Array,
) -> None:
    """Acceleration of the load under known forces into `out`, (6,): W axes, then L axes.

    m dv = F - m g e_3,  J dw = M - w x J w

    Args:
        load: Load state, (13,).
        total: Force F, W axes [N], and moment M about the centre of mass, L axes [N m].
        body: Mass [kg] and principal inertia, L axes [kg m^2].
        gravity: g [m/s^2].
        out: (6,) [m/s^2, rad/s^2].
    """
    force, moment = total
    mass, J = body
    w = (load[10], load[11], load[12])
    gyroscopic = cross(w, (J[0] * w[0], J[1] * w[1], J[2] * w[2]))
    for j in range(3):
        out[j] = force[j] / mass
        out[3 + j] = (moment[j] - gyroscopic[j]) / J[j]
    out[2] -= gravity
