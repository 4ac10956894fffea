# SPDX-License-Identifier: Apache-2.0
"""What the stages aim at, and the guess that a solve starts from."""

import numpy as np

from skyhaul.control.nmpc.allocation import Controlled, WrenchShares
from skyhaul.control.nmpc.forces import StageParams
from skyhaul.control.nmpc.rollout import LEAD, roll_out
from skyhaul.control.nmpc.stage import Iterate, StageRefs
from skyhaul.geometry.quaternion import (
    R_to_quat,
    quat_conj,
    quat_exp,
    quat_log,
    quat_mul,
    quat_to_R,
)
from skyhaul.model.flatness import flat_outputs
from skyhaul.model.formation import formation_forces
from skyhaul.model.team import Team
from skyhaul.planning.api import Reference
from skyhaul.types import LOAD_P, LOAD_Q, LOAD_V, LOAD_W, Array, Mask


def stage_refs(
    team: Team,
    controlled: Controlled,
    reference: Reference,
    times: tuple[Array, Array],
    u_now: Array,
    active: Mask,
) -> StageRefs:
    """The reference at the stages, with the cable forces that it takes.

    Args:
        team: The team.
        controlled: What z is.
        reference: Desired motion of the load.
        times: Of the nodes (N+1,) [us] and lengths of the intervals (N,) [s].
        u_now: Rate of z that is commanded now, (nz,).
        active: Cables that carry, (n,).
    """
    t_us, dt = times
    sample = reference.sample(t_us)
    R_WD = (
        sample.R_WD[:, 0] if team.payload.kind == "rigid" else np.tile(np.eye(3), (len(t_us), 1, 1))
    )
    flat = flat_outputs(team, sample.p_WD, sample.R_WD, np.zeros((team.count, 3)), active)
    force = flat.force_W[:, 0]
    x = np.empty((len(t_us), 13))
    x[:, LOAD_P], x[:, LOAD_V] = sample.p_WD[:, 0], sample.p_WD[:, 1]
    x[:, LOAD_Q] = R_to_quat(R_WD)
    x[:, LOAD_W] = flat.w_WL_L if team.payload.kind == "rigid" else 0.0
    z = controlled.values(team, R_WD, force)
    return StageRefs(
        x=x,
        z=z,
        force_W=force,
        u=np.diff(z, axis=0) / dt[:, None],
        u_now=u_now,
        dir_W=np.nan_to_num(-flat.cable_dir_W[:, 0]),
        bend_W=np.nan_to_num(-flat.cable_dir_W[:, 2]),
        active=active.astype(np.float64),
    )


def first_guess(
    team: Team,
    controlled: Controlled,
    params: StageParams,
    refs: tuple[StageRefs, Array],
    x0: Array,
    present: tuple[Array, Array, Mask],
) -> Iterate:
    """The load led to its reference by feedback, its wrench shared like the reference's.

    Args:
        team: The team.
        controlled: What z is.
        params: The load is read.
        refs: Reference at the stages and times of the nodes, (N+1,) [s].
        x0: Measured state, (13,).
        present: Cable forces on the load (n, 3) [N] and z (nz,) of now, cables that carry (n,).
    """
    ref, node = refs
    force_W, z0, active = present
    wrench_of = WrenchShares().values
    R_WL = quat_to_R(ref.x[:, LOAD_Q])
    start = wrench_of(team, quat_to_R(x0[None, LOAD_Q]), force_W[None])[0]
    x, wrench = np.empty_like(ref.x), np.empty((len(node), 6))
    target = wrench_of(team, R_WL, ref.force_W)
    roll_out(params.load, LEAD, (ref.x, target), (x0, start), node, (x, wrench))
    R_WL = quat_to_R(x[:, LOAD_Q])
    wrench_L = wrench.copy()
    wrench_L[:, :3] = np.einsum("kba,kb->ka", R_WL, wrench[:, :3])
    force = np.einsum("kab,knb->kna", R_WL, formation_forces(team, wrench_L, active))
    return _closed(x, controlled.values(team, R_WL, force), node, x0, z0)


def shifted_guess(
    last: Iterate,
    age_s: float,
    refs: tuple[StageRefs, Array],
    x0: Array,
    z0: Array,
    moves: Array,
) -> Iterate:
    """The last iterate, `age_s` later; beyond its end the reference.

    Args:
        last: The last iterate.
        age_s: Time since it was made, any [s].
        refs: Reference at the new stages and times of the nodes, (N+1,) [s].
        x0: Measured state, (13,).
        z0: Present forces, (nz,).
        moves: 0 for entries of z that must be 0, (nz,).
    """
    ref, node = refs
    t = age_s + node
    inside = t <= node[-1]
    x, z = np.empty_like(last.x), np.empty_like(last.z)
    k = np.clip(np.searchsorted(node, t, side="right") - 1, 0, len(node) - 2)
    s = np.clip((t - node[k]) / (node[k + 1] - node[k]), 0.0, 1.0)[:, None]
    x[:] = (1.0 - s) * last.x[k] + s * last.x[k + 1]
    turn = quat_log(quat_mul(quat_conj(last.x[k, LOAD_Q]), last.x[k + 1, LOAD_Q]))
    x[:, LOAD_Q] = quat_mul(last.x[k, LOAD_Q], quat_exp(s * turn))
    z[:] = (1.0 - s) * last.z[k] + s * last.z[k + 1]
    out = ~inside
    x[out], z[out] = ref.x[out], ref.z[out]
    return _closed(x, z * moves, node, x0, z0)


def _closed(x: Array, z: Array, node: Array, x0: Array, z0: Array) -> Iterate:
    """A guess with its start set to what is measured, and rates that join its forces."""
    x[0], z[0] = x0, z0
    return Iterate(np.ascontiguousarray(x), z, np.diff(z, axis=0) / np.diff(node)[:, None])
