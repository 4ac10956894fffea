# SPDX-License-Identifier: Apache-2.0
"""The sensors of a team."""

from dataclasses import dataclass, field

from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.sensors.api import RigCalibration, VehicleCalibration
from skyhaul.sensors.faults import SensorFault, check_faults
from skyhaul.sensors.imu import Imu, imu_bank
from skyhaul.sensors.load_cell import LoadCell
from skyhaul.sensors.perfect import PerfectObjects, PerfectState
from skyhaul.sensors.script import script_of
from skyhaul.sensors.streams import PAYLOAD_BODY
from skyhaul.sensors.suite import PayloadSuite, TeamSuite, VehicleSensors, VehicleSuite


@dataclass(frozen=True, kw_only=True)
class SensorsConfig(Params):
    """What measures: perfect sensors for `--perception truth`, real ones for everything else."""

    team: PerfectState = field(default_factory=PerfectState)
    """What tells where the team is."""
    objects: PerfectObjects = field(default_factory=PerfectObjects)
    """What sees obstacles."""
    imu: Imu = field(default_factory=Imu)
    """IMU of every vehicle."""
    payload_imu: Imu = field(default_factory=lambda: Imu(rate_hz=100, position_m=(0.0, 0.0, 0.03)))
    """IMU of the load."""
    load_cell: LoadCell | None = None
    """Load cell in every hook; default: none."""
    faults: tuple[SensorFault, ...] = ()
    """What goes wrong with the sensors, and when."""

    def check(self, team: Team) -> None:
        """Refuse faults of vehicles and cameras that do not exist.

        Raises:
            ValueError: With one sentence that begins with the key at fault.
        """
        check_faults(self.faults, team.count, self.camera_names, self.event_size_px)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of a vehicle's cameras, in the order of `CameraFrame.camera`."""
        return ()

    @property
    def event_size_px(self) -> tuple[int, int] | None:
        """Columns and rows of a vehicle's event camera; None without one."""
        return None

    def calibration(self) -> VehicleCalibration:
        """What an estimator may know of a vehicle's sensors."""
        return VehicleCalibration(
            imu=self.imu.calibration(),
            rig=RigCalibration((), None),
            load_cell_rate_hz=self.load_cell.rate_hz if self.load_cell else None,
        )

    def vehicle_suite(self, vehicle: int) -> VehicleSuite:
        """All sensors of one vehicle."""
        return VehicleSuite(imu_bank([self.imu], [1 + vehicle]), self._vehicle(vehicle))

    def payload_suite(self) -> PayloadSuite:
        """The sensors of the load."""
        script = script_of(self.faults, PAYLOAD_BODY, (), None)
        return PayloadSuite(imu_bank([self.payload_imu], [PAYLOAD_BODY]), script)

    def team_suite(self, team: Team) -> TeamSuite:
        """The sensors of load and vehicles, for a flight."""
        n = team.count
        imus, bodies = [self.payload_imu] + n * [self.imu], [PAYLOAD_BODY, *range(1, 1 + n)]
        vehicles = tuple(self._vehicle(i) for i in range(n))
        return TeamSuite(imu_bank(imus, bodies), vehicles, self.payload_suite().script)

    def _vehicle(self, vehicle: int) -> VehicleSensors:
        script = script_of(self.faults, 1 + vehicle, self.camera_names, self.event_size_px)
        return VehicleSensors(vehicle, None, None, self.load_cell, script)
