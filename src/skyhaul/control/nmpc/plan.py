# SPDX-License-Identifier: Apache-2.0
"""From an iterate of the optimal control problem to the plan that the vehicles follow."""

from dataclasses import dataclass

import numpy as np

from skyhaul.control.api import ForcePlan
from skyhaul.control.nmpc.forces import (
    InputMap,
    Scratch,
    StageParams,
    cable_forces,
    load_accelerations,
    thrust_vector,
)
from skyhaul.control.nmpc.riccati import rotation_gains, translation_gains
from skyhaul.control.nmpc.stage import Iterate
from skyhaul.geometry.kernels import quat_to_R
from skyhaul.jit import njit
from skyhaul.types import Array, Mask, TimeUs


@dataclass(frozen=True, eq=False)
class Feedback:
    """What the feedback along a plan is made of."""

    stiffness: Array  # (3,) of the position, W axes [N/m]
    damping: Array  # (3,) of the velocity, W axes [N s/m]
    w_R: Array  # (3,) weight of the attitude error [1/s^4]
    w_w: Array  # (3,) weight of the rate error [1/s^2]


def make_feedback(position: Array, attitude: Array, damping: float, mass: float) -> Feedback:
    """Feedback from bandwidths, (3,) each [rad/s]: along W's axes and about L's axes."""
    stiffness, rate = translation_gains(position, damping, mass)
    return Feedback(stiffness, rate, attitude**4, (4.0 * damping**2 - 2.0) * attitude**2)


def force_plan(
    stamp_us: TimeUs,
    params: tuple[StageParams, InputMap, Feedback],
    it: Iterate,
    du_now: Array,
    shares: tuple[Array, Mask],
    mem: Scratch,
) -> ForcePlan:
    """The plan of an iterate.

    Args:
        stamp_us: Time of its first node.
        params: Stages, how z acts, feedback.
        it: The iterate.
        du_now: Rate of z at the first node, (nz,), for a plan without a kink.
        shares: P^+ of the formation, (n, 3, 6), which shares the feedback's wrench between the
            cables, and which cables carry, (n,).
        mem: Memory of the kernels.
    """
    s, im, feedback = params
    pinv_L, active = shares
    nodes, n = len(it.x), len(s.m_B)
    node = np.append(0.0, np.cumsum(s.dt))
    accel, force = np.empty((nodes, 3)), np.empty((nodes, n, 3))
    dforce, thrust = np.empty((nodes, n, 3)), np.empty((nodes, n))
    _node_values(s, im, it, node, du_now, (accel, force, dforce, thrust), mem)
    gain = np.zeros((nodes, n, 3, 12))
    turning = np.zeros((nodes, 3, 6))
    if s.load.rigid:
        rotation_gains(s, im, it.x, it.z, node, (feedback.w_R, feedback.w_w), turning)
    _share_gains(it.x, turning, (feedback.stiffness, feedback.damping), pinv_L, gain)
    return ForcePlan(
        stamp_us=stamp_us,
        node_s=node,
        load=it.x.copy(),
        accel_W=accel,
        force_W=force,
        dforce_W=dforce,
        gain=gain,
        thrust=thrust * active,
        active=active.copy(),
    )


@njit
def _node_values(
    s: StageParams,
    im: InputMap,
    it: Iterate,
    node: Array,
    du_now: Array,
    out: tuple[Array, Array, Array, Array],
    mem: Scratch,
) -> None:
    """Accelerations, forces, their rates and the thrusts at every node."""
    accel, force, dforce, thrust = out
    last, n, nz = node.shape[0] - 1, force.shape[1], it.z.shape[1]
    both, slope, R = np.empty((last + 1, 6)), np.empty(nz), np.empty((3, 3))
    turn = np.empty((last + 1, n, 3))
    for k in range(last + 1):
        quat_to_R(it.x[k, 3:7], R)
        cable_forces(im, R, it.z[k], mem)
        load_accelerations(s, im, it.x[k], it.z[k], R, both[k])
        for c in range(nz):
            if k == 0:
                slope[c] = du_now[c] * im.moves[c]
            elif k == last:
                share = s.dt[k - 1] / (s.dt[k - 1] + s.dt[k - 2]) if k > 1 else 0.0
                slope[c] = it.u[k - 1, c] + share * (it.u[k - 1, c] - it.u[k - 2, c])
            else:
                h0, h1 = s.dt[k - 1], s.dt[k]
                slope[c] = (h1 * it.u[k - 1, c] + h0 * it.u[k, c]) / (h0 + h1)
        for i in range(n):
            for a in range(3):
                rate = 0.0
                for c in range(nz):
                    rate += mem.by_z[3 * i + a, c] * slope[c]
                for c in range(3):
                    rate += mem.by_phi[3 * i + a, c] * it.x[k, 10 + c]
                force[k, i, a], dforce[k, i, a] = mem.f[i, a], rate
            _direction_rate(mem.f[i], dforce[k, i], turn[k, i])
        accel[k] = both[k, :3]
    pull = np.empty(3)
    for k in range(last + 1):
        quat_to_R(it.x[k, 3:7], R)
        before, after = max(0, k - 1), min(last, k + 1)
        for i in range(n):
            bend = (turn[after, i] - turn[before, i]) / (node[after] - node[before])
            thrust_vector(s, it.x[k], R, both[k], bend, force[k, i], i, pull)
            thrust[k, i] = np.sqrt(pull[0] ** 2 + pull[1] ** 2 + pull[2] ** 2)


@njit
def _direction_rate(f: Array, df: Array, out: Array) -> None:
    """Rate of the unit vector along f; zero where f vanishes."""
    size = np.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    out[:] = 0.0
    if size < 1e-6:
        return
    along = (f[0] * df[0] + f[1] * df[1] + f[2] * df[2]) / (size * size)
    for a in range(3):
        out[a] = (df[a] - along * f[a]) / size


@njit
def _share_gains(
    x: Array, turning: Array, gains: tuple[Array, Array], pinv_L: Array, out: Array
) -> None:
    """Force gains of every cable: R P^+ of the wrench (-k e_p - d e_v in W, K (e_R, e_w) in L)."""
    stiffness, damping = gains
    n, R = out.shape[1], np.empty((3, 3))
    for k in range(out.shape[0]):
        quat_to_R(x[k, 3:7], R)
        for i in range(n):
            for a in range(3):
                for e in range(3):
                    by_force, by_turn, by_spin = 0.0, 0.0, 0.0
                    for b in range(3):
                        for j in range(3):
                            by_force += R[a, b] * pinv_L[i, b, j] * R[e, j]
                            moment = R[a, b] * pinv_L[i, b, 3 + j]
                            by_turn += moment * turning[k, j, e]
                            by_spin += moment * turning[k, j, 3 + e]
                    out[k, i, a, e] = -stiffness[e] * by_force
                    out[k, i, a, 6 + e] = -damping[e] * by_force
                    out[k, i, a, 3 + e] = by_turn
                    out[k, i, a, 9 + e] = by_spin
