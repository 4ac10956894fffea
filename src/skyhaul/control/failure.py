# SPDX-License-Identifier: Apache-2.0
"""When a vehicle is lost: noticing it, and the equilibrium of those that carry on."""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.control.allocation import (
    AllocationLimits,
    ForceLimits,
    distribute,
    wrench_map,
    wrench_weights,
)
from skyhaul.geometry.so3 import so3_exp
from skyhaul.model.formation import formation_forces, hover_attitude
from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.types import Array, Mask


@dataclass(frozen=True, kw_only=True)
class LossLimits(Params):
    """What an equilibrium must keep to count as survivable."""

    tilt_max_deg: float = 30.0
    """Largest tilt of the load [deg]."""
    tilt_step_deg: float = 3.0
    """First step of the search over the tilt, refined to an eighth of it [deg]."""
    thrust_share: float = 0.95
    """Largest share of a vehicle's thrust that hover may take."""
    allocation: AllocationLimits = field(default_factory=AllocationLimits)
    """Cone, and the weights of the tension distribution."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.tilt_max_deg < 60.0:
            raise ValueError(f"tilt_max_deg must lie in [0, 60), got {self.tilt_max_deg}")
        if not (self.tilt_step_deg > 0.0 and 0.0 < self.thrust_share <= 1.0):
            raise ValueError(
                "tilt_step_deg must be > 0 and thrust_share lie in (0, 1], got "
                f"{self.tilt_step_deg} and {self.thrust_share}"
            )


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Hover of the cables that carry on; if not survivable, the best that was found."""

    survivable: bool
    formation: bool  # the forces are those of `formation_forces`, so flat references work as such
    active: Mask  # (n,) cables that carry
    R_WL: Array  # (3, 3) attitude of the load, at yaw 0
    force_W: Array  # (n, 3) force of each cable on the load [N]; 0 for the others
    thrust_ratio: Array  # (n,) thrust over the largest; 0 for the others
    separation_m: float  # smallest distance of two carrying vehicles [m]; inf for one
    wrench_error: float  # force [N] and moment over hook radius [N] that is missing, norm

    @property
    def tilt_deg(self) -> float:
        """Angle between the load's z axis and the vertical [deg]."""
        return math.degrees(math.acos(min(1.0, max(-1.0, float(self.R_WL[2, 2])))))

    @property
    def tension(self) -> Array:
        """Tension of every cable, (n,) [N]."""
        size: Array = np.linalg.norm(self.force_W, axis=1)
        return size


def equilibrium_after_loss(
    team: Team, active: Mask, limits: LossLimits | None = None
) -> Equilibrium:
    """Hover of the load on the cables that are left, level or with the smallest tilt that works.

    First `model.hover_attitude` and its formation forces; where these break a limit, the smallest
    tilt, and forces other than the formation's, that keep tension, thrust, cone and separation.

    Args:
        team: The team, as it was.
        active: Cables that carry on, (n,).
        limits: What must hold.

    Source: PAPER_NOTES 33; the paper claims survival and does not design it.
    Limits: Static: says nothing about the way from the old to the new attitude.
    """
    limits = limits or LossLimits()
    active = np.array(active, dtype=bool)
    level = hover_attitude(team, active) if active.any() else np.eye(3)
    best = _balance(team, active, level, limits)
    if best.survivable or not _holds_attitude(team, active):
        return best
    tilts = np.deg2rad(np.arange(0.0, limits.tilt_max_deg + 1e-9, limits.tilt_step_deg))
    for tilt in tilts:
        for heading in np.linspace(0.0, 2.0 * np.pi, 16 if tilt > 0.0 else 1, endpoint=False):
            found = _balance(team, active, _tilted(tilt, heading), limits)
            if found.survivable:
                return _least_tilt(team, found, (tilt, heading), limits)
    return best


def _tilted(tilt: float, heading: float) -> Array:
    """Attitude turned by an angle about a level axis, (3, 3)."""
    R_WL: Array = so3_exp(tilt * np.array([np.cos(heading), np.sin(heading), 0.0]))
    return R_WL


def _least_tilt(
    team: Team, found: Equilibrium, at: tuple[float, float], limits: LossLimits
) -> Equilibrium:
    """Halve the last step of the tilt three times, as long as the equilibrium survives it."""
    tilt, heading = at
    step = math.radians(limits.tilt_step_deg)
    for _ in range(3 if tilt > 0.0 else 0):
        step *= 0.5
        less = _balance(team, found.active, _tilted(tilt - step, heading), limits)
        if less.survivable:
            found, tilt = less, tilt - step
    return found


class FailureRow(NamedTuple):
    """What happens when one vehicle is lost and released."""

    vehicle: int
    survivable: bool
    tilt_deg: float
    tension_min_n: float
    tension_max_n: float
    thrust_ratio_max: float
    separation_m: float


def single_failure_table(team: Team, limits: LossLimits | None = None) -> list[FailureRow]:
    """The team's tolerance to the loss of each single vehicle, one row each."""
    rows = []
    for i in range(team.count):
        active = np.arange(team.count) != i
        e = equilibrium_after_loss(team, active, limits)
        left = e.tension[active] if active.any() else np.zeros(1)
        rows.append(
            FailureRow(
                vehicle=i,
                survivable=e.survivable,
                tilt_deg=e.tilt_deg,
                tension_min_n=float(left.min()),
                tension_max_n=float(left.max()),
                thrust_ratio_max=float(e.thrust_ratio.max()),
                separation_m=e.separation_m,
            )
        )
    return rows


def _holds_attitude(team: Team, active: Mask) -> bool:
    """Whether the cables can balance every moment on the load (a point mass has none)."""
    if team.payload.kind == "point":
        return bool(active.any())
    return int(np.linalg.matrix_rank(wrench_map(team.hooks_L(), active), tol=1e-6)) == 6


def _balance(team: Team, active: Mask, R_WL: Array, limits: LossLimits) -> Equilibrium:
    """Cable forces that hold the load at an attitude, within the limits if they can be kept."""
    arrays, n = team.arrays(), team.count
    weight = np.concatenate([arrays.m_L * arrays.g * R_WL[2], np.zeros(3)])
    arm = arrays.p_LA @ R_WL.T
    lim = ForceLimits(
        axis=np.ascontiguousarray(team.formation_dirs_L() @ R_WL.T),
        arm=arm,
        offset=np.outer(arrays.m_B, [0.0, 0.0, arrays.g]),
        thrust_max=limits.thrust_share * arrays.thrust_max,
        length=arrays.length,
        active=active.astype(np.float64),
        tension_min=team.tension_min_n,
        cone_tan=math.tan(math.radians(limits.allocation.cone_deg)),
        separation=0.9 * team.separation_m if n > 1 else 0.0,
        weight=wrench_weights(limits.allocation, team.hook_ring_m),
        tolerance=limits.allocation.tolerance_n,
    )
    if not active.any():
        return _equilibrium(team, lim, R_WL, np.zeros((n, 3)), formation=True, kept=False)
    force = np.ascontiguousarray(formation_forces(team, weight, active) @ R_WL.T)
    steps, kept = distribute(force, lim, limits.allocation.max_cuts, np.empty(6))
    return _equilibrium(team, lim, R_WL, force, formation=steps == 0, kept=kept)


def _equilibrium(
    team: Team, lim: ForceLimits, R_WL: Array, force_W: Array, *, formation: bool, kept: bool
) -> Equilibrium:
    active = lim.active > 0.0
    force_W = force_W * lim.active[:, None]
    wrench = wrench_map(lim.arm) @ force_W.ravel()
    arrays = team.arrays()
    missing = wrench - np.array([0.0, 0.0, arrays.m_L * arrays.g, 0.0, 0.0, 0.0])
    missing[3:] = missing[3:] / team.hook_ring_m if team.payload.kind == "rigid" else 0.0
    thrust = np.linalg.norm(force_W + lim.offset, axis=1) * lim.active
    unit = force_W / np.maximum(np.linalg.norm(force_W, axis=1, keepdims=True), 1e-12)
    tips = (lim.arm + lim.length[:, None] * unit)[active]
    i, k = np.triu_indices(len(tips), 1)
    error = float(np.linalg.norm(missing))
    return Equilibrium(
        survivable=kept and error < 0.01 * arrays.m_L * arrays.g and _holds_attitude(team, active),
        formation=formation,
        active=active,
        R_WL=R_WL,
        force_W=force_W,
        thrust_ratio=thrust / arrays.thrust_max,
        separation_m=float(np.linalg.norm(tips[i] - tips[k], axis=1).min(initial=np.inf)),
        wrench_error=error,
    )


@dataclass(frozen=True, kw_only=True)
class ThrustMonitor(Params):
    """Finds vehicles that no longer give the thrust that was asked for."""

    kind: Literal["thrust"] = "thrust"
    gap_share: float = 0.15
    """Missing thrust, over a vehicle's largest, that counts."""
    hold_s: float = 0.02
    """A fault is a gap that lasts this long [s]; a dead vehicle shows after some 10 ms more."""

    def __post_init__(self) -> None:
        if not (0.0 < self.gap_share < 1.0 and self.hold_s >= 0.0):
            raise ValueError(
                f"gap_share must lie in (0, 1) and hold_s be >= 0, got {self.gap_share}, "
                f"{self.hold_s}"
            )

    def init(self) -> "MonitorMemory":
        """Memory before the first tick."""
        return MonitorMemory(None, 0.0)

    def step(
        self, memory: "MonitorMemory", thrust_cmd: float, thrust: float, rotor: "Rotor", dt: float
    ) -> tuple["MonitorMemory", bool]:
        """Whether a vehicle gives too little, once it has lasted `hold_s`.

        The thrust expected is the command behind the rotors' lag.

        Args:
            memory: From `init` or the tick before.
            thrust_cmd: Thrust commanded in the tick before, all rotors [N].
            thrust: Thrust that the rotors give now [N].
            rotor: What the vehicle can do.
            dt: Time since the last tick [s].
        """
        before = thrust if memory.expected is None else memory.expected
        keep = math.exp(-dt / rotor.lag_s) if rotor.lag_s > 0.0 else 0.0
        expected = before + (1.0 - keep) * (thrust_cmd - before)
        missing = expected - thrust > self.gap_share * rotor.thrust_max_n
        lasted = memory.lasted_s + dt if missing else 0.0
        return MonitorMemory(expected, lasted), lasted > self.hold_s


class Rotor(NamedTuple):
    """What `ThrustMonitor` must know of a vehicle."""

    thrust_max_n: float
    lag_s: float


class MonitorMemory(NamedTuple):
    """What `ThrustMonitor` keeps between ticks."""

    expected: float | None  # thrust that the rotors should give [N]; None: not yet known
    lasted_s: float  # how long the gap has lasted [s]
