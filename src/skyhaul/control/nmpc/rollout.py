# SPDX-License-Identifier: Apache-2.0
"""A flyable guess: the load led to its reference by feedback, with forces that lag behind."""

import math
from typing import NamedTuple

import numpy as np

from skyhaul.control.nmpc.load_step import LoadParams
from skyhaul.geometry.kernels import quat_conj, quat_exp, quat_inv_rotate, quat_log, quat_mul
from skyhaul.jit import njit
from skyhaul.types import Array

STEP_S = 0.01
"""Longest step of the roll-out [s]."""


class Lead(NamedTuple):
    """Feedback of the roll-out."""

    position: float  # bandwidth [rad/s]
    attitude: float  # bandwidth [rad/s]
    lag: float  # time constant of the wrench [s]
    accel_max: float  # largest acceleration asked of the load beside the reference's [m/s^2]
    turn_max: float  # the same, angular [rad/s^2]


LEAD = Lead(position=2.0, attitude=5.0, lag=0.08, accel_max=3.0, turn_max=40.0)


@njit
def roll_out(
    load: LoadParams,
    lead: Lead,
    ref: tuple[Array, Array],
    start: tuple[Array, Array],
    node: Array,
    out: tuple[Array, Array],
) -> None:
    """Load states and wrenches at the nodes of the horizon under critically damped feedback.

    Args:
        load: The load.
        lead: Feedback.
        ref: Reference states (N+1, 13) and their wrenches (F in W, M in L axes), (N+1, 6).
        start: Measured state (13,) and present wrench (6,).
        node: Times of the nodes, (N+1,) [s].
        out: Results, (N+1, 13) and (N+1, 6).
    """
    x, wrench = start[0].copy(), start[1].copy()
    out[0][0], out[1][0] = x, wrench
    wanted = np.empty(6)
    for k in range(node.shape[0] - 1):
        steps = math.ceil((node[k + 1] - node[k]) / STEP_S - 1e-9)
        h = (node[k + 1] - node[k]) / steps
        share = 1.0 - math.exp(-h / lead.lag)
        for i in range(steps):
            _wanted_wrench(load, lead, ref, k, (i + 1.0) / steps, x, wanted)
            for a in range(6):
                wrench[a] += share * (wanted[a] - wrench[a])
            _advance(load, wrench, h, x)
        out[0][k + 1], out[1][k + 1] = x, wrench


@njit
def _wanted_wrench(
    load: LoadParams,
    lead: Lead,
    ref: tuple[Array, Array],
    k: int,
    s: float,
    x: Array,
    out: Array,
) -> None:
    """Wrench of the reference at share s of interval k, and a damped pull towards it."""
    x0, x1, w0, w1 = ref[0][k], ref[0][k + 1], ref[1][k], ref[1][k + 1]
    kp, kd = lead.position * lead.position, 2.0 * lead.position
    a0 = kp * (x0[0] + s * (x1[0] - x0[0]) - x[0]) + kd * (x0[7] + s * (x1[7] - x0[7]) - x[7])
    a1 = kp * (x0[1] + s * (x1[1] - x0[1]) - x[1]) + kd * (x0[8] + s * (x1[8] - x0[8]) - x[8])
    a2 = kp * (x0[2] + s * (x1[2] - x0[2]) - x[2]) + kd * (x0[9] + s * (x1[9] - x0[9]) - x[9])
    fair = min(1.0, lead.accel_max / (math.sqrt(a0 * a0 + a1 * a1 + a2 * a2) + 1e-12))
    out[0] = w0[0] + s * (w1[0] - w0[0]) + load.m * fair * a0
    out[1] = w0[1] + s * (w1[1] - w0[1]) + load.m * fair * a1
    out[2] = w0[2] + s * (w1[2] - w0[2]) + load.m * fair * a2
    out[3:6] = 0.0
    if not load.rigid:
        return
    relative = quat_mul(quat_conj(x1[3:7]), x[3:7])
    turn, spin = quat_log(relative), quat_inv_rotate(relative, x1[10:13])
    kr, kw = lead.attitude * lead.attitude, 2.0 * lead.attitude
    b0 = -kr * turn[0] - kw * (x[10] - spin[0])
    b1 = -kr * turn[1] - kw * (x[11] - spin[1])
    b2 = -kr * turn[2] - kw * (x[12] - spin[2])
    fair = min(1.0, lead.turn_max / (math.sqrt(b0 * b0 + b1 * b1 + b2 * b2) + 1e-12))
    out[3] = w0[3] + s * (w1[3] - w0[3]) + load.J[0] * fair * b0
    out[4] = w0[4] + s * (w1[4] - w0[4]) + load.J[1] * fair * b1
    out[5] = w0[5] + s * (w1[5] - w0[5]) + load.J[2] * fair * b2


@njit
def _advance(load: LoadParams, wrench: Array, h: float, x: Array) -> None:
    """One step of the load under a held wrench, in place, rates first."""
    for a in range(3):
        accel = wrench[a] / load.m
        if a == 2:
            accel -= load.g
        x[7 + a] += h * accel
        x[a] += h * x[7 + a]
    if not load.rigid:
        return
    J, w0, w1, w2 = load.J, x[10], x[11], x[12]
    x[10] += h * (wrench[3] - (J[2] - J[1]) * w1 * w2) / J[0]
    x[11] += h * (wrench[4] - (J[0] - J[2]) * w2 * w0) / J[1]
    x[12] += h * (wrench[5] - (J[1] - J[0]) * w0 * w1) / J[2]
    q = quat_mul(x[3:7], quat_exp((h * x[10], h * x[11], h * x[12])))
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for a in range(4):
        x[3 + a] = scale * q[a]
