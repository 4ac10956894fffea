# SPDX-License-Identifier: Apache-2.0
"""The whole configuration of a flight: the scenario and the stack that flies it."""

from dataclasses import dataclass, field

from skyhaul.comms.in_process import InProcess
from skyhaul.control.config import ControlConfig
from skyhaul.mapping.mapper import Mapping
from skyhaul.mission.latency import Latency
from skyhaul.mission.odometry import ModelledOdometry
from skyhaul.mission.station import StationParams, TakeOffParams
from skyhaul.mission.triggers import EventTrigger, ReplanTriggers, SolveTrigger
from skyhaul.params import Params
from skyhaul.perception.obstacles.from_events import EventObstacles
from skyhaul.perception.obstacles.truth import TruthObstacles
from skyhaul.perception.scene.from_cameras import CameraObstacles
from skyhaul.perception.team.fused import FusedTeam
from skyhaul.perception.team.truth import TruthTeam
from skyhaul.perception.vio.vehicle import VehicleVio
from skyhaul.planning.config import PlanningConfig
from skyhaul.sensors.config import SensorsConfig
from skyhaul.world.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class PerceptionConfig(Params):
    """Estimators."""

    team: TruthTeam | FusedTeam = field(default_factory=TruthTeam)
    """Where the team is."""
    odometry: ModelledOdometry | VehicleVio = field(default_factory=ModelledOdometry)
    """Own odometry of every vehicle, which `team.kind: fused` reads: `modelled`, or `ekf` or
    `smoother` on its own cameras and IMU."""
    obstacles: TruthObstacles | CameraObstacles | EventObstacles = field(
        default_factory=TruthObstacles
    )
    """Where the obstacles are: exactly, or seen by the stereo pairs (`cameras`, which needs
    `team.kind: fused`); `events` runs over recorded events, not in a flight."""


@dataclass(frozen=True, kw_only=True)
class MissionConfig(Params):
    """Phases and triggers."""

    station: StationParams = field(default_factory=StationParams)
    """Lift-off."""
    replan: ReplanTriggers = field(default_factory=ReplanTriggers)
    """When to plan anew."""
    trigger: SolveTrigger = field(default_factory=EventTrigger)
    """When to solve anew."""
    latency: Latency = "none"
    """Whether replans and solves take effect at once, or after the wall time they took."""
    recovery_s: float = 2.0
    """After a vehicle is lost the load is flown by the geometric law for this long [s]."""
    lift_m: float = 0.5
    """Height to which the load is lifted before the flight begins [m]."""
    clear_of_floor_m: float = 0.15
    """The lift ends and the flight begins when the load is this high above its place [m]."""
    take_off: TakeOffParams = field(default_factory=TakeOffParams)
    """When to take off beside movers."""
    spool_s: float = 0.4
    """Time in which the cable forces grow to the weight of the load [s]."""

    def __post_init__(self) -> None:
        for name in ("lift_m", "clear_of_floor_m", "spool_s"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not self.recovery_s >= 0.0:
            raise ValueError(f"recovery_s must be >= 0, got {self.recovery_s}")
        if not self.clear_of_floor_m < self.lift_m:
            raise ValueError(
                f"clear_of_floor_m must be < lift_m = {self.lift_m}, got {self.clear_of_floor_m}"
            )


@dataclass(frozen=True, kw_only=True)
class RunConfig(Scenario):
    """Everything that decides a flight, but for the seed."""

    sensors: SensorsConfig = field(default_factory=SensorsConfig)
    """Sensors."""
    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    """Estimators."""
    mapping: Mapping = field(default_factory=Mapping)
    """The map M(t)."""
    planning: PlanningConfig = field(default_factory=PlanningConfig)
    """Paths and references."""
    control: ControlConfig = field(default_factory=ControlConfig)
    """Payload controller and what follows its plan."""
    comms: InProcess = field(default_factory=InProcess)
    """The bus between the agents."""
    mission: MissionConfig = field(default_factory=MissionConfig)
    """Phases and triggers."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.sensors.check(self.team)
        if self.perception.obstacles.kind == "cameras":
            if self.perception.team.kind != "fused":
                raise ValueError(
                    "perception.obstacles: kind cameras needs perception.team of kind fused, whose "
                    f"cameras it looks through, got {self.perception.team.kind}"
                )
            if self.world.map.window_m is not None:
                raise ValueError(
                    "perception.obstacles: kind cameras needs a map that stays, got world.map with "
                    f"window_m {self.world.map.window_m}; leave window_m out or take kind truth"
                )
        if self.perception.team.kind == "fused":
            if self.team.payload.kind != "rigid":
                raise ValueError(
                    "perception.team: kind fused needs a tag, which a load of kind rigid carries, "
                    f"got a load of kind {self.team.payload.kind}"
                )
            names = [c.name for c in self.sensors.rig.cameras]
            if "down" not in names:
                raise ValueError(
                    "perception.team: kind fused needs a camera named down in sensors.rig, "
                    f"got {', '.join(names) or 'none'}"
                )
