# SPDX-License-Identifier: Apache-2.0
"""Where everything is at time 0."""

from dataclasses import dataclass

import numpy as np

from skyhaul.errors import ConfigError
from skyhaul.model.dynamics import vehicle_motion
from skyhaul.model.formation import hover_forces, hover_state, hover_wrenches
from skyhaul.model.team import Team
from skyhaul.types import Array
from skyhaul.world.check import parked_m
from skyhaul.world.scenario import AirStart, FlyInStart, GroundStart, Scenario


@dataclass(frozen=True, eq=False)
class StartState:
    """Poses and rotor thrusts at time 0; everything is at rest."""

    p_WL: Array  # (3,) [m]
    q_WL: Array  # (4,)
    p_WB: Array  # (n, 3) [m]
    q_WB: Array  # (n, 4)
    rotor_thrust: Array  # (n, 4) [N]
    tension: Array  # (n,) cable tensions [N]
    attached: bool
    airborne: bool


def start_state(scenario: Scenario) -> StartState:
    """Poses at time 0.

    On the ground the bodies stand on the floor, rotors idling at their smallest thrust; in the
    air the team hovers (`model.formation.hover_state`) with the rotors at their hover thrust.
    Every vehicle looks outward, along the azimuth of its cable.

    Raises:
        ConfigError: when vehicles overlap, or a cable does not reach from its hook.
    """
    start, team = scenario.start, scenario.team
    match start:
        case AirStart():
            state = _in_the_air(team, start)
        case _:
            state = _on_the_ground(team, start)
    _check_spacing(team, state.p_WB)
    return state


def _in_the_air(team: Team, start: AirStart) -> StartState:
    hover = hover_state(team, np.array(start.payload_m), headings=team.azimuths_rad)
    return StartState(
        p_WL=hover.p_WL,
        q_WL=hover.q_WL,
        p_WB=vehicle_motion(team, hover)[0],
        q_WB=hover.q_WB,
        rotor_thrust=np.repeat(0.25 * hover_wrenches(team)[:, :1], 4, axis=1),
        tension=np.linalg.norm(hover_forces(team), axis=1),
        attached=True,
        airborne=True,
    )


def _on_the_ground(team: Team, start: GroundStart | FlyInStart) -> StartState:
    n, payload = team.count, team.payload
    spots = parked_m(team, start)
    if len(spots) != n:
        raise ConfigError(f"start.vehicles_m has {len(spots)} places for {n} vehicles")
    height = 0.5 * payload.size_m[2] if payload.kind == "rigid" else payload.radius_m
    p_WL = np.array([*start.payload_m, height], dtype=np.float64)
    p_WB = np.column_stack([spots, np.full(n, team.vehicle.half_height_m)])
    attached = isinstance(start, GroundStart)
    if attached:
        _check_reach(team, p_WL, p_WB)
    half = 0.5 * team.azimuths_rad
    return StartState(
        p_WL=p_WL,
        q_WL=np.array([1.0, 0.0, 0.0, 0.0]),
        p_WB=p_WB,
        q_WB=np.column_stack([np.cos(half), np.zeros((n, 2)), np.sin(half)]),
        rotor_thrust=np.repeat(0.25 * team.arrays().thrust_min[:, None], 4, axis=1),
        tension=np.zeros(n),
        attached=attached,
        airborne=False,
    )


def _check_reach(team: Team, p_WL: Array, p_WB: Array) -> None:
    """Cables reach from the hooks of a level load to the vehicles."""
    away = np.linalg.norm(p_WB - p_WL - team.hooks_L(), axis=1)
    for i, (distance, length) in enumerate(zip(away, team.cable_lengths_m(), strict=True)):
        if distance > length:
            raise ConfigError(
                f"start: cable {i} is too short: vehicle {i} stands {distance:.2f} m from its "
                f"hook and the cable is {length:.2f} m long; move it nearer or lengthen the cable"
            )


def _check_spacing(team: Team, p_WB: Array) -> None:
    least = 2.0 * team.vehicle.radius_m
    for i in range(len(p_WB)):
        for j in range(i):
            distance = float(np.linalg.norm(p_WB[i] - p_WB[j]))
            if distance < least:
                raise ConfigError(
                    f"start: vehicles {j} and {i} are {distance:.2f} m apart; their centres must "
                    f"be at least {least:.2f} m apart, two radii"
                )
