# SPDX-License-Identifier: Apache-2.0
"""`kind: events`: obstacles that move, from the event cameras of the whole team."""

from dataclasses import dataclass, field
from typing import Any, Literal

from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.perception.api import ObstacleEstimate
from skyhaul.perception.events.classifier import NetworkParams
from skyhaul.perception.events.timestamp import TimestampParams
from skyhaul.perception.obstacles.api import TeamSight
from skyhaul.perception.obstacles.tracker import BearingTracker, TrackerMemory
from skyhaul.perception.obstacles.vehicle_watch import (
    SightRules,
    VehicleWatch,
    VehicleWatchMemory,
    vehicle_watch,
)
from skyhaul.sensors.api import VehicleCalibration


@dataclass(frozen=True, eq=False)
class TeamWatchMemory:
    """Memories of the vehicles' chains and of the tracker."""

    vehicles: tuple[VehicleWatchMemory, ...]
    tracker: TrackerMemory


@dataclass(frozen=True, eq=False)
class TeamWatch:
    """The estimator at work; implements `ObstacleEstimator`. Steps of 10 ms suit it.

    Limits: finds nothing that stands.
    """

    watches: tuple[VehicleWatch, ...]  # by vehicle
    tracker: BearingTracker

    def init(self) -> TeamWatchMemory:
        """See `ObstacleEstimator.init`."""
        return TeamWatchMemory(tuple(w.init() for w in self.watches), self.tracker.init())

    def step(
        self, memory: TeamWatchMemory, reading: TeamSight
    ) -> tuple[TeamWatchMemory, ObstacleEstimate]:
        """See `ObstacleEstimator.step`; it moves memories of vehicles on in place."""
        vehicles, seen = list(memory.vehicles), []
        for sight in reading.vehicles:
            i = sight.vehicle
            vehicles[i], found = self.watches[i].step(
                vehicles[i], reading.stamp_us, reading.team, reading.attached, sight
            )
            seen.append(found)
        tracker, tracks = self.tracker.step(memory.tracker, reading.stamp_us, tuple(seen))
        after = TeamWatchMemory(tuple(vehicles), tracker)
        return after, ObstacleEstimate(reading.stamp_us, (), tracks)


@dataclass(frozen=True, kw_only=True)
class EventObstacles(Params):
    """Which classifier, how its events become directions, and how tracks live."""

    kind: Literal["events"] = "events"
    classifier: NetworkParams | TimestampParams = field(default_factory=NetworkParams)
    """What tells movers' events."""
    sight: SightRules = field(default_factory=SightRules)
    """From movers' events to directions."""
    tracker: BearingTracker = field(default_factory=BearingTracker)
    """From directions to tracks."""

    def build(self, team: Team, calibration: VehicleCalibration) -> TeamWatch:
        """The estimator of a team whose vehicles carry equal sensors.

        Raises:
            SkyhaulError: When there is no event camera, or the weights cannot be read.
        """
        made = self.classifier
        classifier: Any = made.build() if isinstance(made, NetworkParams) else made
        watches = tuple(
            vehicle_watch(i, team, calibration, classifier, self.sight) for i in range(team.count)
        )
        return TeamWatch(watches, self.tracker)
