# SPDX-License-Identifier: Apache-2.0
"""The stack of one flight, built once from its configuration."""

from dataclasses import dataclass
from typing import Any

from skyhaul.control.api import PayloadController
from skyhaul.control.failure import ThrustMonitor
from skyhaul.control.free_flight import FreeFlyer
from skyhaul.control.geometric import Geometric, GeometricController
from skyhaul.control.vehicle import CableTracker
from skyhaul.mapping.mapper import Mapper
from skyhaul.mission.config import MissionConfig, RunConfig
from skyhaul.model.envelope import TeamShape, team_shape
from skyhaul.model.team import Team, TeamArrays
from skyhaul.planning.api import ReferencePlanner
from skyhaul.planning.heading import Heading
from skyhaul.world.scenario import Limits, Start, Task


@dataclass(frozen=True, eq=False)
class Stack:
    """Everything an agent computes with; nothing in it changes during a flight."""

    team: Team
    arrays: TeamArrays
    shape: TeamShape
    start: Start
    task: Task
    limits: Limits
    mission: MissionConfig
    mapper: Mapper
    planner: ReferencePlanner
    heading: Heading
    controller: PayloadController[Any]  # each kind has its own memory
    backup: GeometricController
    vehicle_control: CableTracker
    free_flight: FreeFlyer
    fault_watch: ThrustMonitor


def build_stack(config: RunConfig) -> Stack:
    """The stack for a configuration."""
    team, limits = config.team, config.limits
    shape = team_shape(team, config.planning.margin_m)
    return Stack(
        team=team,
        arrays=team.arrays(),
        shape=shape,
        start=config.start,
        task=config.task,
        limits=limits,
        mission=config.mission,
        mapper=config.mapping.build(config.world.map, config.world.room, shape),
        planner=config.planning.build(shape),
        heading=config.planning.heading,
        controller=config.control.payload.build(team, limits),
        backup=Geometric().build(team, limits),
        vehicle_control=config.control.vehicle.build(team),
        free_flight=config.control.free_flight.build(team),
        fault_watch=config.control.fault,
    )
