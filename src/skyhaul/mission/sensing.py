# SPDX-License-Identifier: Apache-2.0
"""From the true state to the estimate of the team, by the kind of estimator."""

from typing import Protocol

from skyhaul.mission.config import RunConfig
from skyhaul.mission.odometers import odometers
from skyhaul.mission.stopwatch import Stopwatch
from skyhaul.perception.api import TeamEstimate
from skyhaul.perception.team.api import SurveyedTeam, TagSight, TeamReports, VehicleReport
from skyhaul.perception.team.fused import FusedTeam
from skyhaul.perception.team.tag import tag_finder
from skyhaul.perception.team.truth import TruthTeam
from skyhaul.plant.api import Truth
from skyhaul.sensors.api import VehicleReading


class TeamSensing(Protocol):
    """Sensors and estimator of the team in a flight. Stateful: there is one of it."""

    readings: tuple[VehicleReading, ...]
    """What the vehicles' sensors delivered in the last step; empty with perfect sensors."""

    def estimate(self, truth: Truth) -> TeamEstimate:
        """The estimate now; called at every step of the plant."""
        ...


class PerfectSensing:
    """Perfect sensors."""

    def __init__(self, config: RunConfig, estimator: TruthTeam) -> None:
        self.readings: tuple[VehicleReading, ...] = ()
        self._sensors, self._estimator = config.sensors.team, estimator
        self._memory = estimator.init()

    def estimate(self, truth: Truth) -> TeamEstimate:
        """See `TeamSensing.estimate`."""
        self._memory, estimate = self._estimator.step(self._memory, self._sensors.read(truth))
        return estimate


class FusedSensing:
    """IMUs, cameras and every vehicle's odometry; hooks and rotors tell what they do exactly.

    Where odometry is modelled and obstacles are not seen, the down cameras alone are rendered.
    """

    def __init__(
        self, config: RunConfig, kind: FusedTeam, seed: int, truth: Truth, watch: Stopwatch
    ) -> None:
        sensors, team = config.sensors, config.team
        tag, n = sensors.tag(team), config.team.count
        assert tag is not None, "checked with the configuration"
        modelled = config.perception.odometry.kind == "modelled"
        self.readings: tuple[VehicleReading, ...] = ()
        self._down = [c.name for c in sensors.rig.cameras].index("down")
        self._watch = watch
        self._read = sensors.team
        seeing = config.perception.obstacles.kind == "cameras"
        looks = {"down"} if modelled and not seeing else None
        self._suite = sensors.team_suite(team, config.world, looks, events=False)
        self._sensors = self._suite.init(seed)
        self._finder = tag_finder(tag)
        self._last: list[TagSight | None] = [None] * n
        self._odometers = odometers(config, seed, truth)
        t = truth.team
        start = SurveyedTeam(t.p_WL.copy(), t.q_WL.copy(), t.p_WB.copy(), t.q_WB.copy())
        load_imu = sensors.payload_imu.calibration()
        self._estimator = kind.build(team, sensors.calibration(), load_imu, tag, start)
        self._memory = self._estimator.init()

    def estimate(self, truth: Truth) -> TeamEstimate:
        """See `TeamSensing.estimate`."""
        with self._watch.stage("sensors"):
            self._sensors, payload, readings = self._suite.step(self._sensors, truth)
        self.readings = readings
        with self._watch.stage("odometry"):
            vios = self._odometers.step(truth, readings, self._sensors.imus.bias[1:])
        known, vehicles = self._read.read(truth), []
        for i, (reading, vio) in enumerate(zip(readings, vios, strict=True)):
            tag = None
            for frame in reading.frames:
                if frame.camera == self._down:
                    tag = self._last[i] = self._finder.find(frame, self._last[i])
            thrust, attached = float(known.thrust[i]), bool(known.attached[i])
            vehicles.append(VehicleReport(reading.imu, vio, tag, thrust, attached))
        reports = TeamReports(truth.stamp_us, tuple(vehicles), payload.imu)
        self._memory, estimate = self._estimator.step(self._memory, reports)
        return estimate


def team_sensing(config: RunConfig, seed: int, truth: Truth, watch: Stopwatch) -> TeamSensing:
    """What the configuration asks for."""
    match config.perception.team:
        case FusedTeam() as kind:
            return FusedSensing(config, kind, seed, truth, watch)
        case TruthTeam() as exact:
            return PerfectSensing(config, exact)
