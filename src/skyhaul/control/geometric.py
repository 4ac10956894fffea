# SPDX-License-Identifier: Apache-2.0
"""The classical baseline: PD on the load with flat feed-forward, no optimisation."""

import time
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skyhaul.control.api import ControlRequest, ForcePlan, Solution, SolveStatus
from skyhaul.geometry.quaternion import R_to_quat
from skyhaul.model.flatness import flat_outputs
from skyhaul.model.formation import formation
from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.planning.api import Reference
from skyhaul.types import (
    ERR_P,
    ERR_R,
    ERR_V,
    ERR_W,
    LOAD_P,
    LOAD_Q,
    LOAD_V,
    LOAD_W,
    Array,
    Mask,
    TimeUs,
)
from skyhaul.world.scenario import Limits


@dataclass(frozen=True, kw_only=True)
class Geometric(Params):
    """Lee (2018): F = m (a_d + g e_3 - k_p e_p - k_v e_v), M likewise, shared out by P^+.

    The gains place the load's poles on the linear model at hover, cable and rotor lag included, at
    -1.6 +- 1.2 i [1/s]; the attitude is three times as fast.
    """

    kind: Literal["geometric"] = "geometric"
    position_stiffness: float = 4.0
    """k_p [1/s^2]."""
    position_damping: float = 3.4
    """k_v [1/s]."""
    attitude_stiffness: float = 12.0
    """k_R, moment per inertia and error [1/s^2]."""
    attitude_damping: float = 6.0
    """k_w, moment per inertia and rate error [1/s]."""
    horizon_s: float = 3.0
    """Length of the plan [s]."""
    node_s: float = 0.1
    """Time between the nodes of the plan [s]."""

    def __post_init__(self) -> None:
        for name in ("position_stiffness", "position_damping", "attitude_stiffness"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not (self.attitude_damping > 0.0 and 0.0 < self.node_s <= self.horizon_s):
            raise ValueError(
                "attitude_damping must be > 0 and node_s lie in (0, horizon_s], got "
                f"{self.attitude_damping}, {self.node_s} and {self.horizon_s}"
            )

    def build(self, team: Team, limits: Limits) -> "GeometricController":
        """The controller of a team; the limits are the reference's concern."""
        return GeometricController(team=team, params=self)


@dataclass(frozen=True, eq=False)
class GeometricController:
    """`Geometric` for one team; a `PayloadController` without memory."""

    team: Team
    params: Geometric

    def init(self) -> None:
        """There is nothing to remember."""

    def solve(self, memory: None, request: ControlRequest) -> tuple[None, Solution]:
        """The flat plan along the reference; the measured load enters by the feedback alone."""
        begin = time.perf_counter()
        plan = self.plan(request.reference, request.stamp_us, request.active)
        wall_ms = 1e3 * (time.perf_counter() - begin)
        solution = Solution(
            status=SolveStatus.OK,
            plan=plan,
            kkt_residual=0.0,
            iterations=0,
            slack_m=0.0,
            wall_ms=wall_ms,
        )
        return None, solution

    def plan(self, reference: Reference, stamp_us: TimeUs, active: Mask) -> ForcePlan:
        """The flat plan along a reference from a time on, by the cables that carry, (n,)."""
        p = self.params
        node_s = np.arange(0.0, p.horizon_s + 0.5 * p.node_s, p.node_s)
        sample = reference.sample(stamp_us + np.rint(1e6 * node_s))
        return flat_plan(self.team, stamp_us, node_s, (sample.p_WD, sample.R_WD), active, p)


def flat_plan(
    team: Team,
    stamp_us: int,
    node_s: Array,
    motion: tuple[Array, Array],
    active: Mask,
    gains: Geometric,
) -> ForcePlan:
    """A plan that follows a motion of the load exactly, with PD feedback.

    Args:
        team: The team.
        stamp_us: Time of node 0 [us].
        node_s: Times of the nodes after it, (K,) [s].
        motion: Derivatives 0..6 of position, (K, 7, 3), and rotation matrix, (K, 7, 3, 3).
        active: Cables that carry, (n,).
        gains: PD gains.
    """
    p_WD, R_WD = motion
    flat = flat_outputs(team, p_WD, R_WD, np.zeros((team.count, 3)), active)
    load = np.empty((len(node_s), 13))
    load[:, LOAD_P], load[:, LOAD_V] = p_WD[:, 0], p_WD[:, 1]
    load[:, LOAD_Q], load[:, LOAD_W] = R_to_quat(R_WD[:, 0]), flat.w_WL_L
    return ForcePlan(
        stamp_us=stamp_us,
        node_s=np.array(node_s),
        load=load,
        accel_W=p_WD[:, 2].copy(),
        force_W=flat.force_W[:, 0].copy(),
        dforce_W=flat.force_W[:, 1].copy(),
        gain=feedback_gains(team, R_WD[:, 0], active, gains),
        thrust=np.where(active, flat.wrench[:, :, 0], 0.0),
        active=np.array(active),
    )


def feedback_gains(team: Team, R_WL: Array, active: Mask, gains: Geometric) -> Array:
    """PD gains of the load, mapped to cable forces.

    K e = R P^+ [-m R^T (k_p e_p + k_v e_v); -J (k_R e_R + k_w e_w)]

    Args:
        team: The team.
        R_WL: Attitudes of the load, (K, 3, 3).
        active: Cables that carry, (n,).
        gains: PD gains.

    Returns:
        (K, n, 3, 12), [N] per unit of error, layout of `types.ERR_P`.

    Source:    Paper eq. (26); Lee, IEEE TCST 26 (2018).
    Deviation: The paper's gains and error signs are open (PAPER_NOTES 9): errors are actual minus
        desired, so every gain is negative; see `test_feedback_gives_the_pd_wrench`.
    """
    pinv = formation(team, active).pinv_L
    arrays = team.arrays()
    force = np.einsum("kab,ibc,kdc->kiad", R_WL, pinv[:, :, :3], R_WL)
    moment = np.einsum("kab,ibc->kiac", R_WL, pinv[:, :, 3:]) * (arrays.J_L * arrays.rigid)
    K = np.empty((*force.shape[:3], 12))
    K[..., ERR_P] = -arrays.m_L * gains.position_stiffness * force
    K[..., ERR_V] = -arrays.m_L * gains.position_damping * force
    K[..., ERR_R] = -gains.attitude_stiffness * moment
    K[..., ERR_W] = -gains.attitude_damping * moment
    return K


def hold_plan(
    team: Team, stamp_us: int, p_WL: Array, R_WL: Array, active: Mask, gains: Geometric
) -> ForcePlan:
    """The plan that holds a place at rest for good: safe hover, lift-off, set-down.

    Args:
        team: The team.
        stamp_us: When it begins [us].
        p_WL: Place of the load's centre of mass, (3,) [m].
        R_WL: Its attitude, (3, 3).
        active: Cables that carry, (n,).
        gains: PD gains.
    """
    p, R = np.zeros((1, 7, 3)), np.zeros((1, 7, 3, 3))
    p[0, 0], R[0, 0] = p_WL, R_WL
    return flat_plan(team, stamp_us, np.zeros(1), (p, R), active, gains)
