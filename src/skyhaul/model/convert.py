# SPDX-License-Identifier: Apache-2.0
"""Between the coordinates of the taut model and the poses of all bodies."""

import numpy as np

from skyhaul.geometry.quaternion import quat_rotate
from skyhaul.model.dynamics import AnyTeam, arrays_of, vehicle_motion
from skyhaul.model.state import CableState, TautState, TeamState
from skyhaul.types import Array


def team_state(team: AnyTeam, state: TautState) -> TeamState:
    """Poses and motion of all bodies while the cables are taut."""
    p_WB, v_WB = vehicle_motion(team, state)
    return TeamState(
        p_WL=state.p_WL,
        q_WL=state.q_WL,
        v_WL=state.v_WL,
        w_WL_L=state.w_WL_L,
        p_WB=p_WB,
        q_WB=state.q_WB,
        v_WB=v_WB,
        w_WB_B=state.w_WB_B,
    )


def cable_state(team: AnyTeam, state: TeamState, tension: Array) -> CableState:
    """Directions, rates and lengths of the lines from the vehicles to their hooks.

    Args:
        team: The team.
        state: Poses and motion; the cables may be slack.
        tension: Tensions, (n,) [N], handed through.
    """
    p_LA = arrays_of(team).p_LA
    line = state.p_WL + quat_rotate(state.q_WL, p_LA) - state.p_WB
    v_hook = state.v_WL + quat_rotate(state.q_WL, np.cross(state.w_WL_L, p_LA))
    length = np.linalg.norm(line, axis=1)
    dir_W = line / length[:, None]
    w_W = np.cross(dir_W, v_hook - state.v_WB) / length[:, None]
    return CableState(dir_W=dir_W, w_W=w_W, tension=tension, length=length)


def taut_state(team: AnyTeam, state: TeamState) -> TautState:
    """The taut state nearest to the poses: directions and rates of the lines to the hooks.

    Limits: Exact where every vehicle is one cable length from its hook and keeps it; the part of
        the motion along a cable is dropped. `cable_state` gives the lengths to check.
    """
    cables = cable_state(team, state, np.zeros(state.n))
    return TautState(
        p_WL=state.p_WL,
        q_WL=state.q_WL,
        v_WL=state.v_WL,
        w_WL_L=state.w_WL_L,
        cable_dir_W=cables.dir_W,
        cable_w_W=cables.w_W,
        q_WB=state.q_WB,
        w_WB_B=state.w_WB_B,
    )
