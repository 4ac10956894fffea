# SPDX-License-Identifier: Apache-2.0
"""The load's dynamics in CasADi: the symbolic twin of `dynamics.load_acceleration` and friend.

Same names and argument order as in `model.dynamics`, tied by `tests/model/test_casadi_model.py`.
"""

from typing import Any

import casadi as ca
import numpy as np

from skyhaul.model.dynamics import AnyTeam, arrays_of
from skyhaul.types import LOAD_Q, LOAD_V, LOAD_W

Symbol = Any
"""A `casadi.SX`, `MX` or `DM`; the package carries no types."""


def quat_to_R(q: Symbol) -> Symbol:
    """Rotation matrix of a unit quaternion, (4,) -> (3, 3)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return ca.vertcat(
        ca.horzcat(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        ca.horzcat(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        ca.horzcat(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def load_acceleration(team: AnyTeam, load: Symbol, force_W: Symbol) -> Symbol:
    """Acceleration of the load under cable forces: (a_WL, dw_WL_L), (6,) [m/s^2, rad/s^2].

    m_L a = sum_i f_i - m_L g e_3
    J_L dw = sum_i p_LA x R_WL^T f_i - w x J_L w

    Args:
        team: The team.
        load: Load state, (13,).
        force_W: Force of each cable on the load, (n, 3) [N].

    Source: Paper eqs. (1)-(2), with the cable directions in world axes (PAPER_NOTES 4).
    """
    arrays = arrays_of(team)
    force: Symbol = ca.sum1(force_W).T
    a = force / arrays.m_L - ca.DM([0.0, 0.0, arrays.g])
    if not arrays.rigid:
        return ca.vertcat(a, ca.DM.zeros(3))
    R, w, J = quat_to_R(load[LOAD_Q]), load[LOAD_W], ca.DM(arrays.J_L)
    force_L = force_W @ R
    moment = -ca.cross(w, J * w)
    for i, hook in enumerate(np.asarray(arrays.p_LA)):
        moment += ca.cross(ca.DM(hook), force_L[i, :].T)
    return ca.vertcat(a, moment / J)


def load_derivative(team: AnyTeam, load: Symbol, force_W: Symbol, norm_gain: float = 0.0) -> Symbol:
    """Time derivative of the load state under cable forces, (13,).

    dq = 1/2 q (x) (0, w) + norm_gain (1 - |q|^2) q

    Args:
        team: The team.
        load: Load state, (13,).
        force_W: Force of each cable on the load, (n, 3) [N].
        norm_gain: Rate at which |q| returns to 1 [1/s]; changes nothing on unit quaternions, and
            keeps long predictions of an integrator without projection from drifting.
    """
    acceleration = load_acceleration(team, load, force_W)
    q, w = load[LOAD_Q], load[LOAD_W]
    dq = ca.DM.zeros(4)
    if arrays_of(team).rigid:
        u = q[1:]
        dq = 0.5 * ca.vertcat(-ca.dot(u, w), q[0] * w + ca.cross(u, w))
        dq += norm_gain * (1.0 - ca.dot(q, q)) * q
    return ca.vertcat(load[LOAD_V], dq, acceleration)
