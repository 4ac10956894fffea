# SPDX-License-Identifier: Apache-2.0
"""How the cables share the load: the one nominal allocation of the project, and hover.

Cable forces are the forces on the load, one row per cable, all from the same wrench: in load axes
f_L = internal + P^+ (F_L, M_L), linear in the wrench. The internal forces, which give no wrench,
lean the cables outward to the formation's angle.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from skyhaul.errors import SkyhaulError
from skyhaul.geometry.quaternion import R_to_quat, quat_exp, quat_mul
from skyhaul.geometry.so3 import hat, rotation_z
from skyhaul.model.dynamics import AnyTeam, arrays_of
from skyhaul.model.state import TautState
from skyhaul.model.team import Team
from skyhaul.types import Array, Mask

FAIR_SHARE = 0.5
"""In hover every cable carries at least this part of an even share, by tilting the load."""
TILT_MAX_RAD = math.radians(25.0)
"""Largest tilt of the load that hover looks for."""


class Formation(NamedTuple):
    """The allocation as the kernels need it."""

    pinv_L: Array  # (n, 3, 6) force and moment on the load to its smallest cable forces
    internal_L: Array  # (n, 3) cable forces without wrench [N]
    active: Mask  # (n,) cables that carry; the rows of the others are zero


def formation(team: Team, active: Mask | None = None) -> Formation:
    """The allocation of a team, made once; its arrays must not be written to.

    The formation's forces pull along `Team.formation_dirs_L` with equal tension and lift the
    weight together; their part in the null space of P is the internal force.

    Args:
        team: The team.
        active: Cables that carry, (n,); default all.

    Raises:
        SkyhaulError: when no cable carries, or `active` has another length than the team.
    """
    carrying = (True,) * team.count if active is None else tuple(bool(a) for a in active)
    if len(carrying) != team.count or not any(carrying):
        raise SkyhaulError(
            f"active needs one entry for each of the {team.count} cables and at least one that "
            f"carries, got {carrying}"
        )
    return _formation(team, carrying)


def formation_forces(team: Team, wrench_L: Array, active: Mask | None = None) -> Array:
    """Cable forces that give a wrench, with the cables leaning outward.

    f_L = internal_L + P^+ wrench_L

    Args:
        team: The team.
        wrench_L: Force and moment on the load, L axes, (..., 6) [N, N m]; the weight is not in
            it, so hover asks for the force m_L g upward. A point mass ignores the moment.
        active: Cables that carry, (n,); default all.

    Returns:
        Force of each cable on the load, L axes, (..., n, 3) [N]; 0 for the others.

    Source:    Paper eq. (26).
    Deviation: P and the internal forces are not defined there (PAPER_NOTES 15, 16); see
        `test_forces_give_the_wrench`.
    Limits:    Linear, so tensions can come out negative under large moments. Two hooks, or hooks
        on one line, cannot give every moment: then the nearest wrench comes out.
    """
    form = formation(team, active)
    forces: Array = form.internal_L + np.einsum("nij,...j->...ni", form.pinv_L, wrench_L)
    return forces


def hover_attitude(team: Team, active: Mask | None = None) -> Array:
    """Attitude R_WL of the load in hover at yaw 0, (3, 3).

    Level where that leaves every cable `FAIR_SHARE` of an even share along its direction in the
    formation. Else the smallest tilt that does, up to `TILT_MAX_RAD`: a square plate that lost
    one of four cables (PAPER_NOTES 33). With hooks on one line, the hooks come over the centre
    of mass.
    """
    up_L = _up_L(team, formation(team, active))
    axis = np.array([up_L[1], -up_L[0], 0.0])  # up_L x e_3, turns up_L into W's z
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.eye(3) if up_L[2] > 0.0 else np.diag([1.0, -1.0, -1.0])
    S = hat(axis / sine)
    R_WL: Array = np.eye(3) + sine * S + (1.0 - up_L[2]) * S @ S
    return R_WL


def hover_forces(team: Team, active: Mask | None = None) -> Array:
    """Cable forces on the load in hover at yaw 0, W axes, (n, 3) [N]."""
    R_WL, arrays = hover_attitude(team, active), arrays_of(team)
    weight = np.append(arrays.m_L * arrays.g * R_WL[2], np.zeros(3))
    forces: Array = formation_forces(team, weight, active) @ R_WL.T
    return forces


def hover_wrenches(team: Team) -> Array:
    """Thrusts and (zero) moments that hold `hover_state`, (n, 4) [N, N m]."""
    thrust = np.linalg.norm(_hover_thrust_W(team), axis=1)
    return np.column_stack([thrust, np.zeros((team.count, 3))])


def hover_state(
    team: Team, p_WL: Array, yaw: float = 0.0, headings: Array | None = None
) -> TautState:
    """The team at rest in equilibrium, all cables taut.

    Args:
        team: The team.
        p_WL: Centre of mass of the load, (3,) [m].
        yaw: Heading of the load [rad]; a point mass keeps q = identity, its formation does not
            turn.
        headings: Those of the vehicles, (n,) [rad]; default: that of the load.
    """
    n, rigid = team.count, arrays_of(team).rigid
    turn = rotation_z(yaw if rigid else 0.0)
    f_W = hover_forces(team) @ turn.T
    b3 = _hover_thrust_W(team) @ turn.T
    b3 = b3 / np.linalg.norm(b3, axis=1, keepdims=True)
    ahead = np.full(n, yaw) if headings is None else headings
    b2 = np.cross(b3, np.column_stack([np.cos(ahead), np.sin(ahead), np.zeros(n)]))
    b2 = b2 / np.linalg.norm(b2, axis=1, keepdims=True)
    q_WL = R_to_quat(hover_attitude(team))
    return TautState(
        p_WL=np.array(p_WL, dtype=np.float64),
        q_WL=quat_mul(quat_exp(np.array([0.0, 0.0, yaw])), q_WL) if rigid else q_WL,
        v_WL=np.zeros(3),
        w_WL_L=np.zeros(3),
        cable_dir_W=-f_W / np.linalg.norm(f_W, axis=1, keepdims=True),
        cable_w_W=np.zeros((n, 3)),
        q_WB=R_to_quat(np.stack([np.cross(b2, b3), b2, b3], axis=-1)),
        w_WB_B=np.zeros((n, 3)),
    )


def _hover_thrust_W(team: Team) -> Array:
    arrays = arrays_of(team)
    thrust: Array = hover_forces(team) + arrays.m_B[:, None] * [0.0, 0.0, arrays.g]
    return thrust


@lru_cache(maxsize=256)
def _formation(team: Team, active: tuple[bool, ...]) -> Formation:
    arrays, carries = arrays_of(team), np.array(active)
    n = len(carries)
    P = _wrench_map(arrays, carries)
    pinv = np.linalg.pinv(P, rcond=1e-9)
    toward = team.formation_dirs_L() * carries[:, None]
    tension = arrays.m_L * arrays.g / max(float(np.sum(toward[:, 2])), 1e-12)
    f = (tension * toward).ravel()
    internal = f - pinv @ (P @ f)
    idle = ~carries
    pinv_L, internal_L = np.ascontiguousarray(pinv.reshape(n, 3, 6)), internal.reshape(n, 3)
    pinv_L[idle], internal_L[idle] = 0.0, 0.0  # rounding
    return Formation(pinv_L, internal_L, carries)


def _wrench_map(team: AnyTeam, active: Mask) -> Array:
    """P, (6, 3n): cable forces, L axes, to force and moment on the load."""
    arrays = arrays_of(team)
    force = np.tile(np.eye(3), (len(active), 1, 1))
    moment = hat(arrays.p_LA) if arrays.rigid else 0.0 * force
    rows = np.concatenate([force, moment], axis=1) * active[:, None, None]
    return np.concatenate(list(rows), axis=1)


def _up_L(team: Team, form: Formation) -> Array:
    """W's vertical in L axes in hover, unit, (3,)."""
    arrays, up = arrays_of(team), np.array([0.0, 0.0, 1.0])
    if not arrays.rigid:
        return up
    P, weight = _wrench_map(arrays, form.active), arrays.m_L * arrays.g
    reached = P @ np.einsum("nij,j->ni", form.pinv_L[:, :, :3], weight * up).ravel()
    level = bool(np.linalg.norm(reached - np.append(weight * up, np.zeros(3))) < 1e-9 * weight)
    hooks = arrays.p_LA[form.active]
    if np.linalg.matrix_rank(hooks - hooks[0], tol=1e-9) < 2:
        return up if level else _up_over_line(hooks)
    tilt, heading = np.meshgrid(
        np.linspace(0.0, TILT_MAX_RAD, 51), np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    )
    s = np.sin(tilt)
    ups = np.stack([s * np.cos(heading), s * np.sin(heading), np.cos(tilt)], axis=-1)
    forces = form.internal_L + np.einsum("nij,abj->abni", form.pinv_L[:, :, :3], weight * ups)
    share = np.sum(forces * team.formation_dirs_L(), axis=-1)[..., form.active].min(axis=-1)
    best = share.max(axis=0)  # over the headings, for each tilt
    fair = best >= FAIR_SHARE * weight / np.sum(form.active)
    column = int(np.argmax(fair)) if fair.any() else int(np.argmax(best))
    up = ups[int(np.argmax(share[:, column])), column]
    return np.asarray(up)


def _up_over_line(hooks: Array) -> Array:
    """The least tilted direction from the centre of mass to the middle half of a line of hooks."""
    along = hooks[-1] - hooks[0] if len(hooks) > 1 else np.zeros(3)
    at = (hooks - hooks[0]) @ along
    ends = hooks[[int(np.argmin(at)), int(np.argmax(at))]]
    points = ends[0] + np.linspace(0.25, 0.75, 101)[:, None] * (ends[1] - ends[0])
    lengths = np.linalg.norm(points, axis=1, keepdims=True)
    directions = points / np.maximum(lengths, 1e-12)
    return np.asarray(directions[int(np.argmax(directions[:, 2]))])
