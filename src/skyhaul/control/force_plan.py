# SPDX-License-Identifier: Apache-2.0
"""A `ForcePlan` at a time: planned load motion, cable forces, their rates, and the feedback."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skyhaul.control.api import ForcePlan
from skyhaul.geometry.kernels import (
    Vec3Out,
    quat_conj,
    quat_exp,
    quat_inv_rotate,
    quat_log,
    quat_mul,
    quat_rotate,
)
from skyhaul.jit import njit
from skyhaul.types import Array, TimeUs, frozen

PLANNED_NX = 19
"""Layout of a planned load motion (19,): load state (13,), acceleration of the centre of mass in
W axes (3,) [m/s^2], angular acceleration in L axes (3,) [rad/s^2]."""


class PlanArrays(NamedTuple):
    """A `ForcePlan` as the kernels take it: writable, contiguous."""

    node: Array  # (K,) [s]
    load: Array  # (K, 13)
    accel: Array  # (K, 3)
    force: Array  # (K, n, 3)
    dforce: Array  # (K, n, 3)
    gain: Array  # (K, n, 3, 12)
    thrust: Array  # (K, n)
    active: Array  # (n,) 1 or 0


def plan_arrays(plan: ForcePlan) -> PlanArrays:
    """The arrays of a plan, copied."""

    def copy(a: object) -> Array:
        return np.array(a, dtype=np.float64, order="C")

    return PlanArrays(
        node=copy(plan.node_s),
        load=copy(plan.load),
        accel=copy(plan.accel_W),
        force=copy(plan.force_W),
        dforce=copy(plan.dforce_W),
        gain=copy(plan.gain),
        thrust=copy(plan.thrust),
        active=copy(plan.active),
    )


@dataclass(frozen=True, eq=False)
class PlanSample:
    """A plan at one time."""

    load: Array  # (13,) planned load state
    accel_W: Array  # (3,) [m/s^2]
    force_W: Array  # (n, 3) force of each cable on the load, without feedback [N]
    dforce_W: Array  # (n, 3) [N/s]
    ddforce_W: Array  # (n, 3) [N/s^2]
    gain: Array  # (n, 3, 12)
    thrust: Array  # (n,) thrust predicted for each vehicle [N]

    def __post_init__(self) -> None:
        frozen(self.load, self.accel_W, self.force_W, self.dforce_W, self.ddforce_W)
        frozen(self.gain, self.thrust)


def sample_plan(plan: ForcePlan, t_us: TimeUs) -> PlanSample:
    """A plan at a time. Before its first node it is taken there, after its last it rests there.

    Args:
        plan: The plan, K nodes, n cables.
        t_us: Time since the start of the run [us].
    """
    return sample_arrays(plan_arrays(plan), 1e-6 * (t_us - plan.stamp_us))


def sample_arrays(arrays: PlanArrays, t: float) -> PlanSample:
    """`sample_plan` of a plan that is packed already, at t after its stamp [s]."""
    n = arrays.force.shape[1]
    planned, forces, gain = np.empty(PLANNED_NX), np.empty((3, n, 3)), np.empty((n, 3, 12))
    sample_motion(arrays, t, planned)
    sample_forces(arrays, t, forces)
    sample_gain(arrays, t, gain)
    k, s, _ = _locate(arrays.node, t)
    last = min(k + 1, len(arrays.node) - 1)
    return PlanSample(
        load=planned[:13].copy(),
        accel_W=planned[13:16].copy(),
        force_W=forces[0].copy(),
        dforce_W=forces[1].copy(),
        ddforce_W=forces[2].copy(),
        gain=gain,
        thrust=(1.0 - s) * arrays.thrust[k] + s * arrays.thrust[last],
    )


@njit
def _locate(node: Array, t: float) -> tuple[int, float, float]:
    """Interval k, place s in 0..1 in it, and its length h [s]; h = 0 beyond the last node."""
    last = node.shape[0] - 1
    if last == 0 or t >= node[last]:
        return last, 0.0, 0.0
    k = 0
    while t >= node[k + 1]:
        k += 1
    h = node[k + 1] - node[k]
    return k, max(0.0, (t - node[k]) / h), h


@njit
def _hermite(
    x0: float, d0: float, x1: float, d1: float, s: float, h: float
) -> tuple[float, float, float]:
    """Cubic through values and slopes at both ends: value, first and second derivative."""
    a = 2.0 * (x0 - x1) + h * (d0 + d1)
    b = 3.0 * (x1 - x0) - h * (2.0 * d0 + d1)
    return (
        x0 + s * (h * d0 + s * (b + s * a)),
        (h * d0 + s * (2.0 * b + 3.0 * s * a)) / h,
        (2.0 * b + 6.0 * s * a) / (h * h),
    )


@njit
def sample_motion(plan: PlanArrays, t: float, out: Array) -> None:
    """Planned load motion at t after the stamp [s] into `out`, (19,), see `PLANNED_NX`.

    Position and velocity are cubic Hermite, the attitude is slerp, the rate linear.
    """
    k, s, h = _locate(plan.node, t)
    x0 = plan.load[k]
    if h == 0.0:
        out[:] = 0.0
        for j in range(7):
            out[j] = x0[j]
        return
    x1 = plan.load[k + 1]
    for j in range(3):
        out[j] = _hermite(x0[j], x0[7 + j], x1[j], x1[7 + j], s, h)[0]
        v, a, _ = _hermite(x0[7 + j], plan.accel[k, j], x1[7 + j], plan.accel[k + 1, j], s, h)
        out[7 + j], out[13 + j] = v, a
        out[10 + j] = x0[10 + j] + s * (x1[10 + j] - x0[10 + j])
        out[16 + j] = (x1[10 + j] - x0[10 + j]) / h
    q0 = (x0[3], x0[4], x0[5], x0[6])
    turn = quat_log(quat_mul(quat_conj(q0), x1[3:7]))
    q = quat_mul(q0, quat_exp((s * turn[0], s * turn[1], s * turn[2])))
    out[3], out[4], out[5], out[6] = q


@njit
def sample_forces(plan: PlanArrays, t: float, out: Array) -> None:
    """Planned cable forces and two derivatives at t after the stamp [s] into `out`, (3, n, 3)."""
    k, s, h = _locate(plan.node, t)
    for i in range(plan.force.shape[1]):
        for j in range(3):
            if h == 0.0:
                out[0, i, j], out[1, i, j], out[2, i, j] = plan.force[k, i, j], 0.0, 0.0
            else:
                f, df, ddf = _hermite(
                    plan.force[k, i, j],
                    plan.dforce[k, i, j],
                    plan.force[k + 1, i, j],
                    plan.dforce[k + 1, i, j],
                    s,
                    h,
                )
                out[0, i, j], out[1, i, j], out[2, i, j] = f, df, ddf


@njit
def sample_gain(plan: PlanArrays, t: float, out: Array) -> None:
    """Feedback gains at t after the stamp [s] into `out`, (n, 3, 12); linear between nodes."""
    k, s, _ = _locate(plan.node, t)
    a = plan.gain[k]
    b = plan.gain[min(k + 1, plan.node.shape[0] - 1)]
    for i in range(a.shape[0]):
        for j in range(3):
            for m in range(12):
                out[i, j, m] = a[i, j, m] + s * (b[i, j, m] - a[i, j, m])


@njit
def load_error(load: Array, planned: Array, out: Array) -> None:
    """Load error into `out`, (12,), layout of `types.ERR_P`.

    e = (p - p_d, Log(q_d^-1 (x) q), v - v_d, w - R^T R_d w_d)
    """
    for j in range(3):
        out[j] = load[j] - planned[j]
        out[6 + j] = load[7 + j] - planned[7 + j]
    out[3], out[4], out[5] = quat_log(quat_mul(quat_conj(planned[3:7]), load[3:7]))
    w_D = _to_load_axes(load, planned, planned[10:13])
    for j in range(3):
        out[9 + j] = load[10 + j] - w_D[j]


@njit
def load_error_rates(load: Array, planned: Array, motion: Array, e: Array, out: Array) -> None:
    """First and second derivative of the load error under modelled accelerations.

    de = (v - v_d, e_w, a - a_d, dw - R^T R_d dw_d + w x R^T R_d w_d), the attitude row to first
    order in the error; dde keeps the two accelerations, whose own rates the caller adds.

    Args:
        load: Load state, (13,).
        planned: Planned motion, (19,).
        motion: Modelled acceleration (W axes) and angular acceleration (L axes), (6,).
        e: Load error, (12,).
        out: Both derivatives, (2, 12).
    """
    w_D = _to_load_axes(load, planned, planned[10:13])
    dw_D = _to_load_axes(load, planned, planned[16:19])
    turn = (
        load[11] * w_D[2] - load[12] * w_D[1],
        load[12] * w_D[0] - load[10] * w_D[2],
        load[10] * w_D[1] - load[11] * w_D[0],
    )
    for j in range(3):
        out[0, j], out[0, 3 + j] = e[6 + j], e[9 + j]
        out[0, 6 + j] = motion[j] - planned[13 + j]
        out[0, 9 + j] = motion[3 + j] - dw_D[j] + turn[j]
        out[1, j], out[1, 3 + j] = out[0, 6 + j], out[0, 9 + j]
        out[1, 6 + j] = out[1, 9 + j] = 0.0


@njit
def _to_load_axes(load: Array, planned: Array, v_D: Array) -> Vec3Out:
    """R^T R_d v: from the planned load's axes to the load's."""
    return quat_inv_rotate(load[3:7], quat_rotate(planned[3:7], v_D))
