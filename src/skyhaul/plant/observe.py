# SPDX-License-Identifier: Apache-2.0
"""One kernel that reads everything out of MuJoCo's arrays: state, cables, bodies for clearance."""

import math
from typing import NamedTuple

import mujoco
import numpy as np

from skyhaul.geometry.kernels import cross, mat_vec, quat_to_R
from skyhaul.geometry.shapes import BOX, CAPSULE, CYLINDER, SPHERE, ShapeArrays
from skyhaul.jit import njit
from skyhaul.model.team import Team, TeamArrays
from skyhaul.types import Array, IntArray, Mask

# mypy: disable-error-code="no-any-return"

TENDON_LIMIT = int(mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON)


class Observation(NamedTuple):
    """Fields of `TeamState`, `CableState`, `Truth`, same names."""

    p_WL: Array
    q_WL: Array
    v_WL: Array
    w_WL_L: Array
    p_WB: Array
    q_WB: Array
    v_WB: Array
    w_WB_B: Array
    dir_W: Array
    w_W: Array
    tension: Array
    length: Array
    accel_W: Array


def observation(n: int) -> Observation:
    """Memory for what is read out of n vehicles."""
    load = (np.empty(3), np.empty(4), np.empty(3), np.empty(3))
    vehicles = (np.empty((n, 3)), np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3)))
    cables = (np.empty((n, 3)), np.empty((n, 3)), np.empty(n), np.empty(n))
    return Observation(*load, *vehicles, *cables, np.empty((1 + n, 3)))


class Constraints(NamedTuple):
    """MuJoCo's active constraints, k rows."""

    kind: IntArray
    which: IntArray
    force: Array


def team_bodies(team: Team) -> ShapeArrays:
    """Shapes of payload, vehicles and cables (capsules), 1 + 2 n rows, not yet posed."""
    n, payload, vehicle = team.count, team.payload, team.vehicle
    size = np.zeros((1 + 2 * n, 3))
    if payload.kind == "rigid":
        first, size[0] = BOX, 0.5 * np.array(payload.size_m)
    else:
        first, size[0, 0] = SPHERE, payload.radius_m
    size[1 : 1 + n, :2] = vehicle.radius_m, vehicle.half_height_m
    size[1 + n :, 0] = team.cable_radius_m
    kind = np.array([first] + n * [CYLINDER] + n * [CAPSULE], dtype=np.int64)
    return ShapeArrays(kind, size, np.zeros((1 + 2 * n, 3)), np.zeros((1 + 2 * n, 3, 3)))


@njit
def observe(
    team: TeamArrays,
    qpos: Array,
    qvel: Array,
    qacc: Array,
    constraints: Constraints,
    bodies: ShapeArrays,
    out: Observation,
) -> bool:
    """Read the state out, and pose the team's `bodies` in place.

    Args:
        team: The team.
        qpos: Load (7; point mass 3), then 7 for every vehicle.
        qvel: Load (6; point mass 3), then 6 for every vehicle: W velocity, body-axes rates.
        qacc: Its derivative.
        constraints: Those of the forward pass at this state; a cable's tension is the force of
            its tendon's limit.
        bodies: As `team_bodies` makes them.
        out: Written.

    Returns:
        Whether the accelerations are finite.
    """
    n = team.m_B.shape[0]
    nq, nv = (7, 6) if team.rigid else (3, 3)
    for c in range(3):
        out.p_WL[c], out.v_WL[c], out.accel_W[0, c] = qpos[c], qvel[c], qacc[c]
        out.w_WL_L[c] = qvel[3 + c] if team.rigid else 0.0
    for c in range(4):
        out.q_WL[c] = qpos[3 + c] if team.rigid else (1.0 if c == 0 else 0.0)
    _pose(bodies, 0, out.p_WL, out.q_WL)
    for i in range(n):
        q, v = nq + 7 * i, nv + 6 * i
        for c in range(3):
            out.p_WB[i, c], out.v_WB[i, c] = qpos[q + c], qvel[v + c]
            out.w_WB_B[i, c], out.accel_W[1 + i, c] = qvel[v + 3 + c], qacc[v + c]
        for c in range(4):
            out.q_WB[i, c] = qpos[q + 3 + c]
        _pose(bodies, 1 + i, out.p_WB[i], out.q_WB[i])
        _read_cable(team, out, bodies, i)
        out.tension[i] = 0.0
    for k in range(constraints.kind.shape[0]):
        if constraints.kind[k] == TENDON_LIMIT:
            out.tension[constraints.which[k]] = constraints.force[k]
    finite = True
    for a in qacc:
        finite = finite and math.isfinite(a)
    return finite


@njit
def _pose(bodies: ShapeArrays, row: int, p: Array, q: Array) -> None:
    bodies.p_WO[row, 0], bodies.p_WO[row, 1], bodies.p_WO[row, 2] = p[0], p[1], p[2]
    quat_to_R(q, bodies.R_WO[row])


@njit
def _read_cable(team: TeamArrays, out: Observation, bodies: ShapeArrays, i: int) -> None:
    """Direction, rate and length of cable i, and its capsule (row 1 + n + i)."""
    R, r, row = bodies.R_WO[0], team.p_LA[i], 1 + team.m_B.shape[0] + i
    arm = mat_vec(R, r)
    turn = mat_vec(R, cross(out.w_WL_L, r))
    square = 0.0
    for c in range(3):
        hook = out.p_WL[c] + arm[c]
        out.dir_W[i, c] = hook - out.p_WB[i, c]
        bodies.p_WO[row, c] = 0.5 * (hook + out.p_WB[i, c])
        square += out.dir_W[i, c] * out.dir_W[i, c]
    length = math.sqrt(square)
    out.length[i] = length
    inverse = 1.0 / max(length, 1e-12)
    for c in range(3):
        out.dir_W[i, c] *= inverse
        bodies.R_WO[row, c, 2] = out.dir_W[i, c]
    bodies.size[row, 1] = 0.5 * length
    swing = cross(
        out.dir_W[i],
        (
            (out.v_WL[0] + turn[0] - out.v_WB[i, 0]) * inverse,
            (out.v_WL[1] + turn[1] - out.v_WB[i, 1]) * inverse,
            (out.v_WL[2] + turn[2] - out.v_WB[i, 2]) * inverse,
        ),
    )
    out.w_W[i, 0], out.w_W[i, 1], out.w_W[i, 2] = swing


@njit
def write_forces(
    ctrl: Array, qfrc: Array, mixer: Array, rotor_mean: Array, wind: Array, drag: Array
) -> None:
    """Put thrusts, moments and the force of the moving air into MuJoCo.

    Moments turn with their body as the thrusts do: a free joint's last three forces are moments
    in body axes.

    Args:
        ctrl: MuJoCo's controls, the thrusts along z_B, (n,) [N], written.
        qfrc: MuJoCo's forces on the joints, laid out as qvel, written.
        mixer: (4, 4), rotor thrusts to wrench.
        rotor_mean: (n, 4) [N].
        wind: (3,), W axes [m/s].
        drag: Of load and vehicles, (1 + n,) [N s/m].
    """
    n = rotor_mean.shape[0]
    first = qfrc.shape[0] - 6 * n
    for c in range(3):
        qfrc[c] = drag[0] * wind[c]
    for i in range(n):
        at = first + 6 * i
        for a in range(4):
            s = 0.0
            for k in range(4):
                s += mixer[a, k] * rotor_mean[i, k]
            if a == 0:
                ctrl[i] = s
            else:
                qfrc[at + 2 + a] = s
        for c in range(3):
            qfrc[at + c] = drag[1 + i] * wind[c]


@njit
def place_obstacles(mocap: Array, p_WO: Array, present: Mask) -> float:
    """Put the obstacles' centres, (m, 3) [m], into MuJoCo; those not `present` far away.

    Returns:
        The longest way, along one axis, that any of them goes by that [m].
    """
    longest = 0.0
    for j in range(present.shape[0]):
        for c in range(3):
            place = p_WO[j, c] if present[j] else (-1e3 if c == 2 else 0.0)
            longest = max(longest, abs(place - mocap[j, c]))
            mocap[j, c] = place
    return longest


@njit
def fastest(qvel: Array, rigid: bool) -> float:
    """Largest component of velocity of load and vehicles [m/s]."""
    largest = max(abs(qvel[0]), abs(qvel[1]), abs(qvel[2]))
    for k in range(6 if rigid else 3, qvel.shape[0], 6):
        largest = max(largest, abs(qvel[k]), abs(qvel[k + 1]), abs(qvel[k + 2]))
    return largest
