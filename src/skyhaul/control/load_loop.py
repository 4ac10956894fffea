# SPDX-License-Identifier: Apache-2.0
"""From plan and load to the cable forces wanted now: feedback, disturbance, limits."""

from typing import NamedTuple

import numpy as np

from skyhaul.control.allocation import ForceLimits, distribute
from skyhaul.control.cable import model_motion, tension_wanted
from skyhaul.control.force_plan import (
    PLANNED_NX,
    PlanArrays,
    load_error,
    load_error_rates,
    sample_forces,
    sample_gain,
    sample_motion,
)
from skyhaul.control.tension import make_up_for_direction
from skyhaul.control.vectors import add, axpy, put, row, scaled
from skyhaul.geometry.kernels import Vec3Out, cross, quat_inv_rotate, quat_rotate
from skyhaul.jit import njit
from skyhaul.model.team import TeamArrays
from skyhaul.perception.api import TeamEstimate
from skyhaul.types import Array, Mask

ESTIMATE_NX = 23
"""Columns of a packed estimate (1 + n, 23): row 0 is the load, row 1 + i vehicle i. Pose and motion
(13,) as in a load state, then direction (3,), rate (3,), tension, length of cable i, thrust of
vehicle i, and 1 where the cable joins it to the load."""


class LoadLoop(NamedTuple):
    """Parameters of `wanted_forces`."""

    share: Array  # (3n, 6) P^+ of the carrying cables, L axes
    axis_L: Array  # (n, 3) directions hook -> vehicle in the formation, L axes
    weight: Array  # (6,) see `allocation.wrench_weights`
    cone_tan: float
    separation: float  # [m]
    tolerance: float  # [N]
    max_cuts: int
    error_limit: float  # position errors of the load are shortened to this [m]
    drag: float  # linear drag of the load [N s/m]
    observer: float  # rate of the disturbance observer [1/s]; 0: none
    disturbance_max: float  # [m/s^2]
    slack: float  # a cable this much shorter than its length carries nothing [m]
    hook_radius: float  # [m], 0 for a point mass


class Wanted(NamedTuple):
    """What `wanted_forces` fills in."""

    force: Array  # (3, n, 3) cable forces on the load and two derivatives, W axes
    motion: Array  # (6,) modelled acceleration of the load (W axes), of its rate (L axes)
    boost: Array  # (n,) tension besides that of `force`, see `tension.make_up_for_direction` [N]
    slack: Array  # (6,) wrench given up, W axes
    disturbance: Array  # (6,) observer: velocity, disturbance acceleration of the load, W axes


def pack_estimate(estimate: TeamEstimate) -> Array:
    """An estimate as one array for the kernels, (1 + n, `ESTIMATE_NX`)."""
    team, cables = estimate.team, estimate.cables
    out = np.zeros((team.n + 1, ESTIMATE_NX))
    load = (team.p_WL, team.q_WL, team.v_WL, team.w_WL_L)
    vehicles = (team.p_WB, team.q_WB, team.v_WB, team.w_WB_B)
    lines = (cables.dir_W, cables.w_W, cables.tension, cables.length)
    _pack(load, vehicles, lines, estimate.thrust, estimate.attached, out)
    return out


_Four = tuple[Array, Array, Array, Array]


@njit
def _pack(
    load: _Four, vehicles: _Four, cables: _Four, thrust: Array, attached: Mask, out: Array
) -> None:
    for c in range(3):
        out[0, c], out[0, 7 + c], out[0, 10 + c] = load[0][c], load[2][c], load[3][c]
    for c in range(4):
        out[0, 3 + c] = load[1][c]
    for i in range(thrust.shape[0]):
        x = out[1 + i]
        for c in range(3):
            x[c], x[7 + c], x[10 + c] = vehicles[0][i, c], vehicles[2][i, c], vehicles[3][i, c]
            x[13 + c], x[16 + c] = cables[0][i, c], cables[1][i, c]
        for c in range(4):
            x[3 + c] = vehicles[1][i, c]
        x[19], x[20], x[21] = cables[2][i], cables[3][i], thrust[i]
        x[22] = 1.0 if attached[i] else 0.0


@njit
def tautness(team: TeamArrays, loop: LoadLoop, x: Array, i: int) -> float:
    """1 for a taut cable, 0 for one that is slack by `slack` or more, linear between."""
    taut: float = min(1.0, max(0.0, 1.0 + (x[1 + i, 20] - team.length[i]) / loop.slack))
    return taut


@njit
def wanted_forces(
    team: TeamArrays,
    loop: LoadLoop,
    x: Array,
    plan: PlanArrays,
    clock: tuple[float, float, float],
    out: Wanted,
) -> int:
    """Cable forces wanted now: plan + feedback + disturbance, within the limits.

    f_i = scale (f_i,plan + K_i e + P^+_i R^T (c v - m d)),  then `allocation.distribute`.
    Their derivatives follow the modelled motion of the error: df_i = df_i,plan + K_i de. Roll and
    pitch moment of the feedback go to the tensions alone, into `out.boost`.

    Args:
        team: The team.
        loop: Parameters.
        x: Packed estimate, (1 + n, 23).
        plan: The plan.
        clock: Time after the plan's stamp [s], time since the last call [s], and the scale
            of the forces, 0..1: below 1 the load is taken to rest on the floor.
        out: Filled in; `out.disturbance` is advanced.

    Returns:
        Steps of the tension distribution.
    """
    t, dt, scale = clock
    n = team.m_B.shape[0]
    planned, e, rates = np.empty(PLANNED_NX), np.empty(12), np.empty((2, 12))
    gain = np.empty((n, 3, 12))
    sample_motion(plan, t, planned)
    sample_forces(plan, t, out.force)
    sample_gain(plan, t, gain)
    load_error(x[0], planned, e)
    shrink = _shorten(e, loop.error_limit)
    q = x[0, 3:7]
    tilt = _add_feedback(team, loop, q, gain, e, out.force[0])
    _add_disturbance(team, loop, x, out)
    out.force[0] *= scale
    weight = loop.weight if scale == 1.0 else np.full(6, 1e-9)  # the floor gives the rest
    steps = _limit(team, loop, x, (plan.active, planned, weight), out)
    _boost(team, loop, x, plan, (scale, tilt), out)
    _model(team, loop, x, plan, scale, out)
    load_error_rates(x[0], planned, out.motion, e, rates)
    for j in range(3):
        rates[0, j] *= shrink
    before = out.force[1].copy()
    _add_feedback(team, loop, q, gain, rates[0], out.force[1])
    _accelerations_from_rates(team, x, before, out.force[1], rates[1])
    _add_feedback(team, loop, q, gain, rates[1], out.force[2])
    out.force[1:] *= scale
    _observe(team, loop, x, (dt, scale), out)
    return steps


@njit
def _shorten(e: Array, limit: float) -> float:
    """Shorten the position error to `limit`; returns the factor."""
    size = np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    factor = limit / size if size > limit else 1.0
    for j in range(3):
        e[j] *= factor
    return factor


@njit
def _add_feedback(
    team: TeamArrays, loop: LoadLoop, q: Array, gain: Array, e: Array, force: Array
) -> Vec3Out:
    """Add K_i e, less its roll and pitch moment, to `force`, (n, 3); returns the moment taken out.

    Tensions give that moment, which are quick; cables need not turn for it:
    f_i += K_i e - R P^+_i (0, M_xy), M = sum_i p_LA x R^T K_i e; W axes [N m].
    """
    n = force.shape[0]
    change = np.empty((n, 3))
    moment = (0.0, 0.0, 0.0)
    for i in range(n):
        for j in range(3):
            s = 0.0
            for m in range(12):
                s += gain[i, j, m] * e[m]
            change[i, j] = s
        moment = add(moment, cross(row(team.p_LA, i), quat_inv_rotate(q, row(change, i))))
    tilt = (moment[0], moment[1], 0.0) if team.rigid else (0.0, 0.0, 0.0)
    for i in range(n):
        part = quat_rotate(q, _share(loop.share, i, 3, tilt))
        for j in range(3):
            force[i, j] += change[i, j] - part[j]
    return quat_rotate(q, tilt)


@njit
def _share(P: Array, i: int, column: int, v: Vec3Out) -> Vec3Out:
    """Cable i's part of a force (column 0) or moment (column 3) on the load, L axes: P^+_i v."""
    r, c = 3 * i, column
    return (
        P[r, c] * v[0] + P[r, c + 1] * v[1] + P[r, c + 2] * v[2],
        P[r + 1, c] * v[0] + P[r + 1, c + 1] * v[1] + P[r + 1, c + 2] * v[2],
        P[r + 2, c] * v[0] + P[r + 2, c + 1] * v[1] + P[r + 2, c + 2] * v[2],
    )


@njit
def _add_disturbance(team: TeamArrays, loop: LoadLoop, x: Array, out: Wanted) -> None:
    """Make up for drag and disturbance: R P^+ [R^T (c v - m d); 0]."""
    q = x[0, 3:7]
    c, m, d = loop.drag, team.m_L, out.disturbance
    want = (c * x[0, 7] - m * d[3], c * x[0, 8] - m * d[4], c * x[0, 9] - m * d[5])
    g = quat_inv_rotate(q, want)
    for i in range(team.m_B.shape[0]):
        part = _share(loop.share, i, 0, g)
        put(out.force[0], i, add(row(out.force[0], i), quat_rotate(q, part)))


@njit
def _limit(
    team: TeamArrays, loop: LoadLoop, x: Array, now: tuple[Array, Array, Array], out: Wanted
) -> int:
    """Keep the limits on the cable forces, see `allocation.distribute`.

    `now` is which cables carry, the planned motion (19,) and the weights of the wrench (6,).
    """
    active, planned, weight = now
    n = team.m_B.shape[0]
    q = x[0, 3:7]
    axis, arm, offset = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        put(axis, i, quat_rotate(q, row(loop.axis_L, i)))
        put(arm, i, quat_rotate(q, row(team.p_LA, i)))
        for j in range(3):
            offset[i, j] = team.m_B[i] * (planned[13 + j] + (team.g if j == 2 else 0.0))
    limits = ForceLimits(
        axis,
        arm,
        offset,
        team.thrust_max,
        team.length,
        active,
        team.tension_min,
        loop.cone_tan,
        loop.separation,
        weight,
        loop.tolerance,
    )
    return distribute(out.force[0], limits, loop.max_cuts, out.slack).steps


@njit
def _boost(
    team: TeamArrays,
    loop: LoadLoop,
    x: Array,
    plan: PlanArrays,
    extra: tuple[float, Vec3Out],
    out: Wanted,
) -> None:
    """Tensions that give the moment `extra[1]`, and make up for cables that point wrongly yet."""
    n = team.m_B.shape[0]
    arm, free = np.zeros((n, 3)), np.zeros(n)
    out.boost[:] = 0.0
    if extra[0] < 1.0:
        return
    top = np.inf
    for i in range(n):
        taut = plan.active[i] != 0.0 and x[1 + i, 22] != 0.0 and tautness(team, loop, x, i) > 0.5
        free[i] = 1.0 if taut else 0.0
        put(arm, i, quat_rotate(x[0, 3:7], row(team.p_LA, i)))
        top = min(top, 0.95 * team.thrust_max[i] - team.m_B[i] * team.g)
    reach = (team.tension_min, max(top, team.tension_min), loop.hook_radius)
    make_up_for_direction((out.force[0], extra[1]), x[1:, 13:16], arm, free, reach, out.boost)


@njit
def _model(
    team: TeamArrays, loop: LoadLoop, x: Array, plan: PlanArrays, scale: float, out: Wanted
) -> None:
    """Motion of the load under the wanted forces along the cables as they are."""
    out.motion[:] = 0.0
    if scale < 1.0:
        return
    c, m, d = loop.drag, team.m_L, out.disturbance
    force = (m * d[3] - c * x[0, 7], m * d[4] - c * x[0, 8], m * d[5] - c * x[0, 9])
    moment = (0.0, 0.0, 0.0)
    q = x[0, 3:7]
    for i in range(team.m_B.shape[0]):
        if plan.active[i] != 0.0 and x[1 + i, 22] != 0.0:
            xi = (x[1 + i, 13], x[1 + i, 14], x[1 + i, 15])
            pull = out.boost[i] + tension_wanted(row(out.force[0], i), xi)
            pull *= tautness(team, loop, x, i)
            force = axpy(-pull, xi, force)
            arm = row(team.p_LA, i)
            moment = add(moment, cross(arm, quat_inv_rotate(q, scaled(-pull, xi))))
    body = (m, (team.J_L[0], team.J_L[1], team.J_L[2]))
    model_motion(x[0], (force, moment), body, team.g, out.motion)
    if not team.rigid:
        out.motion[3:] = 0.0


@njit
def _accelerations_from_rates(
    team: TeamArrays, x: Array, before: Array, after: Array, dde: Array
) -> None:
    """Second derivative of velocity and rate errors: what the feedback adds to the force rates."""
    q = x[0, 3:7]
    jerk, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in range(before.shape[0]):
        change = (
            after[i, 0] - before[i, 0],
            after[i, 1] - before[i, 1],
            after[i, 2] - before[i, 2],
        )
        jerk = add(jerk, change)
        turn = add(turn, cross(row(team.p_LA, i), quat_inv_rotate(q, change)))
    for j in range(3):
        dde[6 + j] = jerk[j] / team.m_L
        dde[9 + j] = turn[j] / team.J_L[j] if team.rigid else 0.0


@njit
def _observe(
    team: TeamArrays, loop: LoadLoop, x: Array, clock: tuple[float, float], out: Wanted
) -> None:
    """Advance the observer of the load's disturbance, from the measured tensions."""
    dt, scale = clock
    v: Vec3Out = (x[0, 7], x[0, 8], x[0, 9])
    c, m = loop.drag, team.m_L
    a = scaled(-c / m, v)
    for i in range(team.m_B.shape[0]):
        if x[1 + i, 22] != 0.0:
            a = axpy(-x[1 + i, 19] / m, (x[1 + i, 13], x[1 + i, 14], x[1 + i, 15]), a)
    a = (a[0], a[1], a[2] - team.g)
    observe_disturbance(out.disturbance, v, a, (dt, loop.observer * scale), loop.disturbance_max)
    if scale < 1.0:
        out.disturbance[0], out.disturbance[1], out.disturbance[2] = v


@njit
def observe_disturbance(
    o: Array, v: Vec3Out, accel: Vec3Out, clock: tuple[float, float], largest: float
) -> None:
    """Advance a disturbance observer: a velocity model corrected by the measured velocity.

    dv^ = a + d^ + 2 k (v - v^),  dd^ = k^2 (v - v^): both poles at -k

    Args:
        o: Velocity v^ [m/s] and disturbance d^ [m/s^2], (6,); changed.
        v: Measured velocity [m/s].
        accel: Acceleration a that the known forces give [m/s^2].
        clock: Time step [s] and rate k [1/s]; k = 0 leaves d^ as it is.
        largest: Largest |d^| [m/s^2].
    """
    dt, k = clock
    for j in range(3):
        gap = v[j] - o[j]
        o[j] += dt * (accel[j] + o[3 + j] + 2.0 * k * gap)
        o[3 + j] += dt * k * k * gap
    size = np.sqrt(o[3] * o[3] + o[4] * o[4] + o[5] * o[5])
    if size > largest:
        o[3:6] *= largest / size
