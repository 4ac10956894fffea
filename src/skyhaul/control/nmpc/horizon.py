# SPDX-License-Identifier: Apache-2.0
"""What the stages aim at, and the guess that a solve starts from."""

import numpy as np

from skyhaul.control.nmpc.allocation import Controlled, WrenchShares
from skyhaul.control.nmpc.forces import StageParams
from skyhaul.control.nmpc.rollout import LEAD, roll_out
from skyhaul.control.nmpc.stage import Iterate, StageRefs
from skyhaul.geometry import kernels
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.jit import njit
from skyhaul.model.flatness import flat_outputs
from skyhaul.model.formation import formation_forces
from skyhaul.model.team import Team
from skyhaul.planning.api import Reference
from skyhaul.types import LOAD_Q, Array, Mask


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
    rigid = team.payload.kind == "rigid"
    R_WD = sample.R_WD[:, 0] if rigid else np.tile(np.eye(3), (len(t_us), 1, 1))
    flat = flat_outputs(team, sample.p_WD, sample.R_WD, np.zeros((team.count, 3)), active)
    force = np.ascontiguousarray(flat.force_W[:, 0])
    x = np.zeros((len(t_us), 13))
    _reference_states(np.array(sample.p_WD), np.array(sample.R_WD), flat.w_WL_L, rigid, x)
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
    now = (x0.copy(), start)  # a copy may be written to: the kernel is compiled for that
    roll_out(params.load, LEAD, (ref.x, target), now, node, (x, wrench))
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
    x, z = ref.x.copy(), ref.z.copy()
    _interpolate((last.x, last.z), node, age_s, (x, z))
    return _closed(x, z * moves, node, x0, z0)


@njit
def _interpolate(
    last: tuple[Array, Array], node: Array, age_s: float, out: tuple[Array, Array]
) -> None:
    """States and forces `age_s` later where the last iterate reaches, linear, attitude by slerp."""
    x, z = last
    k, end = 0, node.shape[0] - 1
    for j in range(end + 1):
        t = age_s + node[j]
        if not 0.0 <= t <= node[end]:
            continue
        while k < end - 1 and t >= node[k + 1]:
            k += 1
        s = (t - node[k]) / (node[k + 1] - node[k])
        for c in range(13):
            out[0][j, c] = x[k, c] + s * (x[k + 1, c] - x[k, c])
        for c in range(z.shape[1]):
            out[1][j, c] = z[k, c] + s * (z[k + 1, c] - z[k, c])
        q = (x[k, 3], x[k, 4], x[k, 5], x[k, 6])
        turn = kernels.quat_log(kernels.quat_mul(kernels.quat_conj(q), x[k + 1, 3:7]))
        q = kernels.quat_mul(q, kernels.quat_exp((s * turn[0], s * turn[1], s * turn[2])))
        out[0][j, 3], out[0][j, 4], out[0][j, 5], out[0][j, 6] = q


@njit
def _reference_states(p_WD: Array, R_WD: Array, w: Array, rigid: bool, x: Array) -> None:
    """Load states (k, 13) of derivatives 0..6 of a motion; the attitude of a point mass is 1."""
    for k in range(x.shape[0]):
        for c in range(3):
            x[k, c], x[k, 7 + c] = p_WD[k, 0, c], p_WD[k, 1, c]
        if rigid:
            q = kernels.R_to_quat(R_WD[k, 0])
            x[k, 3], x[k, 4], x[k, 5], x[k, 6] = q
            for c in range(3):
                x[k, 10 + c] = w[k, c]
        else:
            x[k, 3] = 1.0


def _closed(x: Array, z: Array, node: Array, x0: Array, z0: Array) -> Iterate:
    """A guess with its start set to what is measured, and rates that join its forces."""
    x[0], z[0] = x0, z0
    return Iterate(np.ascontiguousarray(x), z, np.diff(z, axis=0) / np.diff(node)[:, None])
