# SPDX-License-Identifier: Apache-2.0
"""What a solve starts from: position as measured, fast attitude as the plan in force has it."""

from dataclasses import dataclass

import numpy as np

from skyhaul.control.api import ControlRequest, ForcePlan
from skyhaul.control.force_plan import load_error, sample_plan
from skyhaul.geometry.kernels import quat_exp, quat_mul, quat_rotate
from skyhaul.types import ERR_R, ERR_W, LOAD_NE, LOAD_Q, LOAD_W, US_PER_S, Array

SETTLE_S = 0.5
"""Time constant with which plans take over the measured attitude of the load [s]."""


@dataclass(frozen=True, eq=False)
class Start:
    """Node 0 of a new plan."""

    load: Array  # (13,)
    force_W: Array  # (n, 3) force of each cable on the load [N]
    dforce_W: Array  # (n, 3) [N/s]


def starting_point(plan: ForcePlan | None, request: ControlRequest) -> Start:
    """Where a new plan starts.

    The load swings under its hooks faster than forces can be turned, so its attitude must be left
    to the feedback, without a break at each solve: the new plan takes over only a part of the
    attitude error against the plan in force, and leaves out of its forces what the feedback will
    go on to give for the rest. The sum of both is continuous.

    Args:
        plan: The plan in force; None, ended or with other cables: all is taken as measured.
        request: The measured load, and the forces commanded now.
    """
    carry = request.active[:, None]
    force = request.force_W * carry
    if (
        plan is None
        or not plan.stamp_us <= request.stamp_us < plan.end_us
        or not np.array_equal(plan.active, request.active)
    ):
        return Start(request.load, force, request.dforce_W * carry)
    now = sample_plan(plan, request.stamp_us)
    e = np.empty(LOAD_NE)
    load_error(np.array(request.load), now.load, e)
    kept = np.exp(-(request.stamp_us - plan.stamp_us) / US_PER_S / SETTLE_S)
    rest = np.zeros(LOAD_NE)
    rest[ERR_R], rest[ERR_W] = kept * e[ERR_R], kept * e[ERR_W]
    load = request.load.copy()
    load[LOAD_Q] = quat_mul(request.load[LOAD_Q], quat_exp(-rest[ERR_R]))
    load[LOAD_W] = quat_rotate(quat_exp(rest[ERR_R]), request.load[LOAD_W] - rest[ERR_W])
    return Start(load, force - now.gain @ rest, now.dforce_W.copy())
