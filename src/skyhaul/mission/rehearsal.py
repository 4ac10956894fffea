# SPDX-License-Identifier: Apache-2.0
"""Short flights before a flight, so that none of its kernels is compiled or loaded in mid-air."""

from collections.abc import Callable
from dataclasses import replace

from skyhaul.errors import ConfigError
from skyhaul.geometry.shapes import Box, Sphere
from skyhaul.mission.api import Recorder
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import Flight
from skyhaul.mission.judge import FLYING_ON
from skyhaul.world.obstacles import CyclicPath, Obstacle
from skyhaul.world.scenario import AirStart

GROUND_S, AIR_S = 0.02, 0.13
"""How long the rehearsals last: on the floor a few ticks, in the air until a mover that comes
near has been dodged [s]."""
HEIGHT_M = 1.5
"""Height of the load in the air [m]."""


def rehearse(config: RunConfig, recorder: Callable[[RunConfig], Recorder], seed: int) -> None:
    """Fly two short scenes with the stack of a flight: from its own start, and among obstacles.

    Args:
        config: The flight to come. Its stack is used as it is; results do not depend on this.
        recorder: Makes the recorder of a rehearsal, of the kind that the flight will have.
        seed: That of the flight: with it an obstacle stands where it will stand.
    """
    short = replace(config, events=(), time_limit_s=GROUND_S)
    if config.start.kind != "air":
        _fly(short, recorder, seed)
    try:
        _fly(_in_the_air(short), recorder, seed)
    except ConfigError:
        return  # no room above the start: what is missing is compiled when it is needed


def _fly(config: RunConfig, recorder: Callable[[RunConfig], Recorder], seed: int) -> None:
    """Fly to the end of the time; unlike in a flight, an interrupt is passed on."""
    listener, verdict = recorder(config), FLYING_ON
    flight = Flight(config, seed, listener)
    try:
        verdict = flight.run(None)
    finally:
        listener.close(flight.outcome(verdict))


def _in_the_air(config: RunConfig) -> RunConfig:
    """The same team, hovering over its start, with a box beside it and a ball that comes near."""
    x, y = config.start.payload_m[:2]
    z = config.start.payload_m[2] if config.start.kind == "air" else HEIGHT_M
    reach = float(max(config.team.cable_lengths_m()))
    ball = CyclicPath(points_m=((x + 0.1, y, z),), speed_mps=1.0, phase_s=0.5)
    near, beside = reach + 1.5, reach + 1.0
    obstacles = (
        Obstacle(name="box", shape=Box(size_m=(0.3, 0.3, 0.6)), center_m=(x, y + beside, z)),
        Obstacle(name="ball", shape=Sphere(radius_m=0.2), center_m=(x + near, y, z), motion=ball),
    )
    return replace(
        config,
        start=AirStart(payload_m=(x, y, z)),
        world=replace(config.world, obstacles=obstacles),
        time_limit_s=AIR_S,
    )
