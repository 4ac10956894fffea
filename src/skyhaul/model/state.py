# SPDX-License-Identifier: Apache-2.0
"""States of the team."""

from dataclasses import dataclass

import numpy as np

from skyhaul.types import LOAD_P, LOAD_Q, LOAD_V, LOAD_W, Array, frozen


@dataclass(frozen=True, eq=False)
class TautState:
    """State of the team while every cable is taut: the coordinates of Lee (2018)."""

    p_WL: Array  # (3,) centre of mass of the load [m]
    q_WL: Array  # (4,) attitude of the load
    v_WL: Array  # (3,) [m/s]
    w_WL_L: Array  # (3,) [rad/s]
    cable_dir_W: Array  # (n, 3) unit, from the vehicle to its hook
    cable_w_W: Array  # (n, 3) angular velocity of the cable, normal to it [rad/s]
    q_WB: Array  # (n, 4) attitude of the vehicles
    w_WB_B: Array  # (n, 3) [rad/s]

    def __post_init__(self) -> None:
        frozen(self.p_WL, self.q_WL, self.v_WL, self.w_WL_L, self.cable_dir_W, self.cable_w_W)
        frozen(self.q_WB, self.w_WB_B)


@dataclass(frozen=True, eq=False)
class TeamState:
    """Pose and motion of every body, cables taut or slack: what the stages hand on."""

    p_WL: Array  # (3,) centre of mass of the load [m]
    q_WL: Array  # (4,)
    v_WL: Array  # (3,) [m/s]
    w_WL_L: Array  # (3,) [rad/s]
    p_WB: Array  # (n, 3) [m]
    q_WB: Array  # (n, 4)
    v_WB: Array  # (n, 3) [m/s]
    w_WB_B: Array  # (n, 3) [rad/s]

    def __post_init__(self) -> None:
        frozen(self.p_WL, self.q_WL, self.v_WL, self.w_WL_L)
        frozen(self.p_WB, self.q_WB, self.v_WB, self.w_WB_B)

    @property
    def n(self) -> int:
        """Number of vehicles."""
        return len(self.p_WB)

    @property
    def load(self) -> Array:
        """Load state (13,), layout of `types.LOAD_P` and its neighbours."""
        x = np.empty(13)
        x[LOAD_P], x[LOAD_Q], x[LOAD_V], x[LOAD_W] = self.p_WL, self.q_WL, self.v_WL, self.w_WL_L
        return x


@dataclass(frozen=True, eq=False)
class CableState:
    """Direction, rate and tension of every cable."""

    dir_W: Array  # (n, 3) unit, from the vehicle to its hook (also while slack)
    w_W: Array  # (n, 3) angular velocity, normal to dir_W [rad/s]
    tension: Array  # (n,) [N], 0 while slack or released
    length: Array  # (n,) distance hook to vehicle [m]

    def __post_init__(self) -> None:
        frozen(self.dir_W, self.w_W, self.tension, self.length)
