# SPDX-License-Identifier: Apache-2.0
"""The team: its vehicles, cables and payload, as configured and as arrays for the kernels."""

import math
from dataclasses import dataclass, field
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.params import Params
from skyhaul.types import GRAVITY_MPS2, Array, Vec3


@dataclass(frozen=True, kw_only=True)
class Vehicle(Params):
    """One quadrotor.

    Source:
        Mass, arm, inertia and largest thrust: the 250 g "dragonfly" of Li, Liu, Loianno, RotorTM
        (2022), 4 rotors of 3.94e-9 N/rpm^2 at 16,400 rpm. Motor lag: 30 ms, a usual figure for
        5 cm rotors. Thrust and drag per rotor are checked against hover by `skyhaul doctor`.
    """

    mass_kg: float = 0.25
    """Mass [kg]."""
    inertia_kgm2: Vec3 = (6.01e-4, 5.89e-4, 1.076e-3)
    """Principal inertia about the centre of mass, body axes [kg m^2]."""
    arm_m: float = 0.1
    """Distance from the centre to each rotor axis [m]."""
    rotor_radius_m: float = 0.05
    """Radius of a rotor [m]."""
    half_height_m: float = 0.03
    """Half of the height of the body [m]."""
    thrust_max_n: float = 4.24
    """Largest total thrust of the four rotors [N]."""
    thrust_min_n: float = 0.2
    """Smallest total thrust of the four rotors [N]."""
    torque_per_thrust_m: float = 0.016
    """Yaw moment of a rotor per newton of thrust [m]."""
    motor_lag_s: float = 0.03
    """First-order time constant of the rotor thrust [s]; 0 means none."""
    drag_ns_per_m: float = 0.03
    """Linear drag of the airframe, force per relative air speed [N s/m]."""

    def __post_init__(self) -> None:
        for name in ("mass_kg", "arm_m", "rotor_radius_m", "half_height_m", "thrust_max_n"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not min(self.inertia_kgm2) > 0.0:
            raise ValueError(f"inertia_kgm2 must be positive, got {self.inertia_kgm2}")
        if not 0.0 <= self.thrust_min_n < self.thrust_max_n:
            raise ValueError(f"thrust_min_n must lie in [0, thrust_max_n), got {self.thrust_min_n}")
        if self.motor_lag_s < 0.0 or self.drag_ns_per_m < 0.0 or self.torque_per_thrust_m <= 0.0:
            raise ValueError("motor_lag_s and drag_ns_per_m must be >= 0, torque_per_thrust_m > 0")

    @property
    def radius_m(self) -> float:
        """Radius of the disc that holds the arms and the rotors [m]."""
        return self.arm_m + self.rotor_radius_m


@dataclass(frozen=True, kw_only=True)
class RigidPayload(Params):
    """A uniform box with the hooks around its upper face.

    The centre of mass lies half a height below the hooks, so that a team of four can lose one
    vehicle (PAPER_NOTES 33).
    """

    kind: Literal["rigid"] = "rigid"
    mass_kg: float = 0.232
    """Mass [kg]."""
    size_m: Vec3 = (0.2, 0.2, 0.08)
    """Edge lengths of the box, centred on the centre of mass, L axes [m]."""
    inertia_kgm2: Vec3 | None = None
    """Principal inertia, L axes [kg m^2]; default that of the uniform box."""
    hook_radius_m: float = 0.1414
    """Distance of the hooks from the vertical axis, for hooks placed by azimuth [m]."""
    hook_height_m: float = 0.04
    """Height of the hooks above the centre of mass, for hooks placed by azimuth [m]."""
    drag_ns_per_m: float = 0.02
    """Linear drag [N s/m]."""

    def __post_init__(self) -> None:
        _check_positive(self.mass_kg, "mass_kg")
        _check_not_negative(self.drag_ns_per_m, "drag_ns_per_m")
        _check_positive(min(self.size_m), "size_m")
        _check_positive(self.hook_radius_m, "hook_radius_m")
        if self.inertia_kgm2 is not None:
            _check_positive(min(self.inertia_kgm2), "inertia_kgm2")

    @property
    def J_L(self) -> Array:
        """Principal inertia, L axes, (3,) [kg m^2]."""
        if self.inertia_kgm2 is not None:
            return np.array(self.inertia_kgm2)
        x, y, z = np.square(self.size_m)
        return self.mass_kg / 12.0 * np.array([y + z, x + z, x + y])


@dataclass(frozen=True, kw_only=True)
class PointPayload(Params):
    """A small sphere, all cables meet at its centre; it has no attitude (q = identity)."""

    kind: Literal["point"] = "point"
    mass_kg: float = 0.232
    """Mass [kg]."""
    radius_m: float = 0.05
    """Radius of the sphere [m]."""
    drag_ns_per_m: float = 0.02
    """Linear drag [N s/m]."""

    def __post_init__(self) -> None:
        _check_positive(self.mass_kg, "mass_kg")
        _check_not_negative(self.drag_ns_per_m, "drag_ns_per_m")
        _check_positive(self.radius_m, "radius_m")


@dataclass(frozen=True, kw_only=True)
class VehicleOverride(Params):
    """What one vehicle has different from the others."""

    index: int
    """Which vehicle, 0-based."""
    mass_kg: float | None = None
    """Mass [kg]."""
    thrust_max_n: float | None = None
    """Largest total thrust [N]."""
    cable_length_m: float | None = None
    """Cable length [m]."""


@dataclass(frozen=True, kw_only=True)
class Team(Params):
    """The vehicles, the cables and the payload."""

    count: int = 4
    """Number of vehicles n; the model takes 1 to 8, missions 3 to 8."""
    vehicle: Vehicle = field(default_factory=Vehicle)
    """Every vehicle, unless overridden."""
    overrides: tuple[VehicleOverride, ...] = ()
    """Vehicles that differ."""
    payload: RigidPayload | PointPayload = field(default_factory=RigidPayload)
    """The load."""
    cable_length_m: float = 1.0
    """Length of every cable, hook to centre of the vehicle, unless overridden [m]."""
    cable_radius_m: float = 0.002
    """Radius of the cables [m]."""
    azimuths_deg: tuple[float, ...] | None = None
    """Direction of each cable around the load, from L's x axis [deg]; default evenly spaced."""
    hooks_m: tuple[Vec3, ...] | None = None
    """Hooks in L axes, from the centre of mass [m]; default: on a ring, by azimuth."""
    cable_angle_deg: float = 25.0
    """Target angle of the cables from the vertical, outward [deg]; raised if the vehicles would
    come closer than `separation_m`."""
    separation_m: float = 0.5
    """Smallest distance between the centres of two vehicles [m]."""
    tension_min_n: float = 0.1
    """Smallest tension that the controllers command [N]."""

    def __post_init__(self) -> None:
        if not 1 <= self.count <= 8:
            raise ValueError(f"count must lie in 1..8, got {self.count}")
        for name in ("cable_length_m", "cable_radius_m", "separation_m"):
            _check_positive(getattr(self, name), name)
        _check_not_negative(self.tension_min_n, "tension_min_n")
        for name in ("azimuths_deg", "hooks_m"):
            rows = getattr(self, name)
            if rows is not None and len(rows) != self.count:
                raise ValueError(
                    f"{name} has {len(rows)} entries for count = {self.count} vehicles; "
                    "give one each, or set it to null"
                )
        _check_overrides(self.overrides, self.count)
        if not 0.0 <= self.cable_angle_deg < 70.0:
            raise ValueError(f"cable_angle_deg must lie in [0, 70), got {self.cable_angle_deg}")
        if self.count > 1 and self._needed_sine() > math.sin(math.radians(70.0)):
            raise ValueError(
                f"cable_length_m = {self.cable_length_m} is too short for {self.count} vehicles "
                f"{self.separation_m} m apart; lengthen the cables or lower separation_m"
            )

    @property
    def azimuths_rad(self) -> Array:
        """Direction of each cable around the load, (n,) [rad]."""
        if self.azimuths_deg is not None:
            return np.deg2rad(np.array(self.azimuths_deg, dtype=np.float64))
        i = np.arange(self.count)
        return np.asarray(np.pi / self.count + 2.0 * np.pi * i / self.count)

    @property
    def hook_ring_m(self) -> float:
        """Distance of the outermost hook from the vertical axis [m]."""
        return float(np.max(np.hypot(*self.hooks_L()[:, :2].T)))

    @property
    def cable_angle_rad(self) -> float:
        """Angle of the cables from the vertical in the formation [rad]."""
        target = math.radians(self.cable_angle_deg)
        if self.count == 1:
            return 0.0
        return max(target, math.asin(max(0.0, self._needed_sine())))

    def _needed_sine(self) -> float:
        """Sine of the angle at which the closest two vehicles are `separation_m` apart.

        Seen from above, two vehicles on cables of the shortest length l are d_0 + s d_1 apart, s
        the sine, d_0 = h_i - h_k between their hooks and d_1 = l (u_i - u_k) between their cables.
        """
        hooks, shortest = self.hooks_L()[:, :2], float(np.min(self.cable_lengths_m()))
        out = np.column_stack([np.cos(self.azimuths_rad), np.sin(self.azimuths_rad)])
        return max(
            _sine_apart(hooks[i] - hooks[k], shortest * (out[i] - out[k]), self.separation_m)
            for i, k in combinations(range(self.count), 2)
        )

    def cable_lengths_m(self) -> Array:
        """Length of each cable, (n,) [m]."""
        lengths = np.full(self.count, self.cable_length_m)
        for o in self.overrides:
            if o.cable_length_m is not None:
                lengths[o.index] = o.cable_length_m
        return lengths

    def hooks_L(self) -> Array:
        """Hooks A in L axes, from the centre of mass, (n, 3) [m]."""
        if self.hooks_m is not None:
            return np.array(self.hooks_m)
        if self.payload.kind == "point":
            return np.zeros((self.count, 3))
        a, r = self.azimuths_rad, self.payload.hook_radius_m
        z = np.full(self.count, self.payload.hook_height_m)
        return np.column_stack([r * np.cos(a), r * np.sin(a), z])

    def formation_dirs_L(self) -> Array:
        """Directions hook -> vehicle at the target angle, L axes, (n, 3); minus `cable_dir`."""
        a, tilt = self.azimuths_rad, self.cable_angle_rad
        flat = np.sin(tilt) * np.column_stack([np.cos(a), np.sin(a)])
        return np.column_stack([flat, np.full(self.count, np.cos(tilt))])

    def arrays(self) -> "TeamArrays":
        """The same parameters as arrays, for the numba kernels."""
        n, v = self.count, self.vehicle
        mass, thrust = np.full(n, v.mass_kg), np.full(n, v.thrust_max_n)
        for o in self.overrides:
            mass[o.index] = o.mass_kg or mass[o.index]
            thrust[o.index] = o.thrust_max_n or thrust[o.index]
        payload = self.payload
        return TeamArrays(
            m_L=payload.mass_kg,
            J_L=payload.J_L if payload.kind == "rigid" else np.ones(3),
            rigid=payload.kind == "rigid",
            p_LA=np.ascontiguousarray(self.hooks_L()),
            m_B=mass,
            J_B=np.tile(np.array(v.inertia_kgm2), (n, 1)),
            length=self.cable_lengths_m(),
            thrust_min=np.full(n, v.thrust_min_n),
            thrust_max=thrust,
            arm=v.arm_m,
            torque_per_thrust=v.torque_per_thrust_m,
            motor_lag=v.motor_lag_s,
            tension_min=self.tension_min_n,
            g=GRAVITY_MPS2,
        )


class TeamArrays(NamedTuple):
    """Parameters of the team as numba sees them. Row i is vehicle, cable and hook i."""

    m_L: float  # mass of the load [kg]
    J_L: Array  # (3,) principal inertia, L axes [kg m^2]; ones for a point mass
    rigid: bool  # False: point mass, the attitude is frozen at identity
    p_LA: Array  # (n, 3) hooks from the centre of mass, L axes [m]
    m_B: Array  # (n,) [kg]
    J_B: Array  # (n, 3) principal inertia, B axes [kg m^2]
    length: Array  # (n,) [m]
    thrust_min: Array  # (n,) total of the four rotors [N]
    thrust_max: Array  # (n,) [N]
    arm: float  # [m]
    torque_per_thrust: float  # [m]
    motor_lag: float  # [s]
    tension_min: float  # [N]
    g: float  # [m/s^2]


def _sine_apart(d0: Array, d1: Array, separation_m: float) -> float:
    """Larger root s of |d_0 + s d_1| = separation; 0 where any s does, inf where none does."""
    a, b, c = float(d1 @ d1), float(d0 @ d1), float(d0 @ d0) - separation_m**2
    if a < 1e-12:
        return math.inf if c < 0.0 else 0.0
    square = b * b - a * c
    return (math.sqrt(square) - b) / a if square > 0.0 else 0.0


def _check_overrides(overrides: tuple[VehicleOverride, ...], count: int) -> None:
    for k, o in enumerate(overrides):
        if not 0 <= o.index < count:
            raise ValueError(f"overrides[{k}]: index must lie in 0..{count - 1}, got {o.index}")
        if o.index in (other.index for other in overrides[:k]):
            raise ValueError(f"overrides[{k}]: vehicle {o.index} stands twice; give it one entry")
        for name in ("mass_kg", "thrust_max_n", "cable_length_m"):
            value = getattr(o, name)
            if value is not None:
                _check_positive(value, f"overrides[{k}].{name}")


def _check_not_negative(value: float, name: str) -> None:
    if not value >= 0.0:
        raise ValueError(f"{name} must be >= 0, got {value}")


def _check_positive(value: float, name: str) -> None:
    if not value > 0.0:
        raise ValueError(f"{name} must be > 0, got {value}")
