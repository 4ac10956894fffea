# SPDX-License-Identifier: Apache-2.0
"""Parameters of the payload NMPC, and how they become a controller."""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from skyhaul.control.nmpc.allocation import Controlled, FreeForces, WrenchShares
from skyhaul.control.nmpc.controller import PayloadNmpc, Settings
from skyhaul.control.nmpc.forces import StageParams
from skyhaul.control.nmpc.hpipm import QpOptions
from skyhaul.control.nmpc.load_step import LoadParams
from skyhaul.control.nmpc.plan import make_feedback
from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.types import Vec3
from skyhaul.world.scenario import Limits


@dataclass(frozen=True, kw_only=True)
class Weights(Params):
    """Cost per second of a unit error; forces count in units of the force of one cable in hover."""

    position: Vec3 = (100.0, 100.0, 100.0)
    """Position error, W axes [1/m^2]."""
    attitude: Vec3 = (20.0, 20.0, 20.0)
    """Attitude error Log(q_d^-1 q) [1/rad^2]."""
    velocity: Vec3 = (60.0, 60.0, 60.0)
    """Velocity error, W axes [s^2/m^2]."""
    rate: Vec3 = (1.0, 1.0, 1.0)
    """Angular rate error, L axes [s^2/rad^2]."""
    force: float = 10.0
    """Deviation from the forces of the reference."""
    force_rate: float = 5.0
    """Deviation from their rates [s^2]."""
    force_bend: float = 2.0
    """Second derivative of the force on the load, in shares of its weight [s^4]."""
    end_s: float = 1.0
    """The end of the horizon counts as so many seconds of position and velocity error [s]."""
    obstacle: float = 2000.0
    """Slack of a clearance, linear [1/m] and squared [1/m^2]."""
    limit: float = 20.0
    """Slack of tension, cone and thrust, linear [1/N] and squared."""
    speed: float = 100.0
    """Slack of the speed, linear [s/m] and squared."""
    tilt: float = 2.0
    """Slack of cos(tilt); above the curvature of the attitude's cost the steps would overshoot."""

    def __post_init__(self) -> None:
        for name in ("position", "attitude", "velocity", "rate"):
            if min(getattr(self, name)) < 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")
        for name in ("force", "force_rate", "force_bend", "obstacle", "limit", "speed", "tilt"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if self.end_s < 0.0:
            raise ValueError(f"end_s must be >= 0, got {self.end_s}")


@dataclass(frozen=True, kw_only=True)
class FeedbackParams(Params):
    """Feedback along the plan: bandwidths of the load's error."""

    position_rad_s: Vec3 = (2.2, 2.2, 3.0)
    """Of the position, along W's axes [rad/s]."""
    attitude_rad_s: Vec3 = (8.0, 8.0, 5.0)
    """Of the attitude, about L's axes [rad/s]."""
    damping: float = 1.0
    """Damping ratio."""

    def __post_init__(self) -> None:
        for name in ("position_rad_s", "attitude_rad_s"):
            if not min(getattr(self, name)) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not self.damping >= math.sqrt(0.5):
            raise ValueError(f"damping must be >= 0.707, got {self.damping}")


@dataclass(frozen=True, kw_only=True)
class NmpcParams(Params):
    """What both kinds share."""

    step_s: tuple[float, ...] = (0.05,) * 4 + (0.1,) * 5 + (0.15,) * 9
    """Intervals of the horizon, the finer ones first [s]."""
    weights: Weights = field(default_factory=Weights)
    """Cost."""
    feedback: FeedbackParams = field(default_factory=FeedbackParams)
    """Between solves."""
    rate_horizontal: float = 4.0
    """Bound of the rate of a cable force, horizontal, in hover forces per second [1/s]."""
    rate_vertical: float = 10.0
    """The same, vertical [1/s]."""
    cone_deg: float = 30.0
    """Largest angle between a cable and its direction in the reference [deg]."""
    tilt_deg: float = 45.0
    """Largest tilt of the load [deg]."""
    thrust_share: float = 0.95
    """Share of a vehicle's largest thrust that plans may use."""
    speed_share: float = 1.3
    """Largest speed of plans, in shares of that of references."""
    movers: int = 6
    """Moving obstacles that a solve looks at: the nearest ones."""
    tolerance: float = 1e-4
    """KKT residual at which a QP is solved."""
    qp_iterations: int = 60
    """Interior-point iterations at most."""
    small_step: float = 2e-3
    """A step below this ends a solve: m, rad, m/s, rad/s, shares of the forces of hover. The next
    one would be of the size of its square."""

    def __post_init__(self) -> None:
        if not (self.step_s and min(self.step_s) > 0.0):
            raise ValueError(f"step_s must be positive times, got {self.step_s}")
        for name in ("rate_horizontal", "rate_vertical", "speed_share", "tolerance", "small_step"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        for name in ("cone_deg", "tilt_deg"):
            if not 0.0 < getattr(self, name) < 90.0:
                raise ValueError(f"{name} must lie in (0, 90), got {getattr(self, name)}")
        if not 0.0 < self.thrust_share <= 1.0:
            raise ValueError(f"thrust_share must lie in (0, 1], got {self.thrust_share}")
        if self.movers < 0 or self.qp_iterations < 1:
            raise ValueError("movers must be >= 0 and qp_iterations >= 1")


@dataclass(frozen=True, kw_only=True)
class Nmpc(NmpcParams):
    """NMPC that decides the force of every cable."""

    kind: Literal["nmpc"] = "nmpc"

    def build(self, team: Team, limits: Limits) -> PayloadNmpc:
        """The controller of a team."""
        return _build(self, FreeForces(), team, limits)


@dataclass(frozen=True, kw_only=True)
class WrenchNmpc(NmpcParams):
    """NMPC that decides the wrench on the load, as the paper does; P^+ shares it."""

    kind: Literal["wrench"] = "wrench"

    def build(self, team: Team, limits: Limits) -> PayloadNmpc:
        """The controller of a team."""
        return _build(self, WrenchShares(), team, limits)


def _build(p: NmpcParams, controlled: Controlled, team: Team, limits: Limits) -> PayloadNmpc:
    nz, w, f = controlled.count(team), p.weights, p.feedback
    horizontal = np.arange(nz) % 3 < 2
    settings = Settings(
        stage=_stage_params(p, team, limits, nz),
        rate_max=np.where(horizontal, p.rate_horizontal, p.rate_vertical),
        slack=(w.limit, w.tilt, w.speed, w.obstacle),
        movers=p.movers,
        small_step=p.small_step,
        feedback=make_feedback(
            np.array(f.position_rad_s), np.array(f.attitude_rad_s), f.damping, team.payload.mass_kg
        ),
        qp=QpOptions(tolerance=p.tolerance, iterations=p.qp_iterations),
    )
    return PayloadNmpc(team, controlled, settings)


def _stage_params(p: NmpcParams, team: Team, limits: Limits, nz: int) -> StageParams:
    a, w = team.arrays(), p.weights
    load = LoadParams(a.m_L, a.J_L, a.rigid, a.g)
    w_x = np.concatenate([w.position, w.attitude, w.velocity, w.rate])
    dt = np.array(p.step_s)
    return StageParams(
        load=load,
        m_B=a.m_B,
        length=a.length,
        p_LA=a.p_LA,
        thrust_max=p.thrust_share * a.thrust_max,
        tension_min=a.tension_min,
        cos_cone=math.cos(math.radians(p.cone_deg)),
        cos_tilt=math.cos(math.radians(p.tilt_deg)),
        speed_max=p.speed_share * limits.v_max_mps,
        w_x=w_x,
        w_z=np.full(nz, w.force),
        w_u=np.full(nz, w.force_rate),
        w_bend=w.force_bend / (a.m_L * a.g) ** 2,
        w_end=w.end_s * w_x,
        dt=dt,
    )
