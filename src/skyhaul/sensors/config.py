# SPDX-License-Identifier: Apache-2.0
"""The sensors of a team."""

from collections.abc import Container
from dataclasses import dataclass, field, replace

from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.sensors.api import TagCalibration, VehicleCalibration
from skyhaul.sensors.camera import cameras
from skyhaul.sensors.events.camera import EventParams, event_camera
from skyhaul.sensors.faults import SensorFault, check_faults
from skyhaul.sensors.imaging.plate import tag_on
from skyhaul.sensors.imaging.scene import Scene, build_scene, object_names
from skyhaul.sensors.imu import Imu, imu_bank
from skyhaul.sensors.load_cell import LoadCell
from skyhaul.sensors.perfect import PerfectObjects, PerfectState
from skyhaul.sensors.rig import RigParams
from skyhaul.sensors.script import script_of
from skyhaul.sensors.streams import PAYLOAD_BODY
from skyhaul.sensors.suite import PayloadSuite, TeamSuite, VehicleSensors, VehicleSuite
from skyhaul.sensors.truth_api import NOISE_LABEL, SKY_LABEL, LabelName
from skyhaul.world.scenario import Light, World


@dataclass(frozen=True, kw_only=True)
class SensorsConfig(Params):
    """What measures: perfect sensors for `--perception truth`, real ones for everything else."""

    team: PerfectState = field(default_factory=PerfectState)
    """What tells where the team is."""
    objects: PerfectObjects = field(default_factory=PerfectObjects)
    """What sees obstacles."""
    imu: Imu = field(default_factory=Imu)
    """IMU of every vehicle."""
    payload_imu: Imu = field(default_factory=lambda: Imu(rate_hz=100, p_BI_m=(0.0, 0.0, 0.03)))
    """IMU of the load."""
    rig: RigParams = field(default_factory=RigParams)
    """Cameras of every vehicle."""
    events: EventParams = field(default_factory=EventParams)
    """What the rig's event camera makes of light."""
    load_cell: LoadCell | None = None
    """Load cell in every hook; default: none."""
    faults: tuple[SensorFault, ...] = ()
    """What goes wrong with the sensors, and when."""

    def check(self, team: Team) -> None:
        """Refuse faults of vehicles and cameras that do not exist.

        Raises:
            ValueError: With one sentence that begins with the key at fault.
        """
        check_faults(self.faults, team.count, self._camera_names, self._event_size_px)

    def calibration(self) -> VehicleCalibration:
        """What an estimator may know of a vehicle's sensors."""
        rate_hz = self.load_cell.rate_hz if self.load_cell else None
        return VehicleCalibration(self.imu.calibration(), self.rig.calibration(), rate_hz)

    def tag(self, team: Team) -> TagCalibration | None:
        """What an estimator may know of the tag on the load; None without one."""
        return tag_on(team.payload)

    def label_names(self, team: Team, world: World) -> tuple[LabelName, ...]:
        """What the labels of events mean, from the least label on."""
        rows = enumerate(zip(*object_names(team, world), strict=True))
        objects = [LabelName(i, name, kind) for i, (name, kind) in rows]
        sky, noise = LabelName(SKY_LABEL, "sky", "sky"), LabelName(NOISE_LABEL, "noise", "noise")
        return (sky, noise, *objects)

    def vehicle_suite(self, team: Team, world: World, vehicle: int) -> VehicleSuite:
        """All sensors of one vehicle."""
        sensors = self._vehicle(self._scene(team, world), world.light, vehicle, team.count)
        return VehicleSuite(imu_bank([self.imu], [1 + vehicle]), sensors)

    def payload_suite(self) -> PayloadSuite:
        """The sensors of the load."""
        script = script_of(self.faults, PAYLOAD_BODY, (), None, self.payload_imu.clock_offset_us)
        return PayloadSuite(imu_bank([self.payload_imu], [PAYLOAD_BODY]), script)

    def team_suite(
        self, team: Team, world: World, images: Container[str] | None = None, *, events: bool = True
    ) -> TeamSuite:
        """The sensors of load and vehicles, for a flight; vehicles share one scene.

        Args:
            team: Who carries them.
            world: What they see.
            images: Names of the cameras that somebody looks at; the others are not rendered,
                which changes no reading. None: all.
            events: Whether somebody looks at the event cameras.
        """
        n, scene = team.count, self._scene(team, world)
        imus, bodies = [self.payload_imu] + n * [self.imu], [PAYLOAD_BODY, *range(1, 1 + n)]
        seeing = self if events else replace(self, rig=replace(self.rig, event_camera=None))
        vehicles = tuple(seeing._vehicle(scene, world.light, i, n, images) for i in range(n))
        return TeamSuite(imu_bank(imus, bodies), vehicles, self.payload_suite().script)

    @property
    def _camera_names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.rig.cameras)

    @property
    def _event_size_px(self) -> tuple[int, int] | None:
        mount = self.rig.event_camera
        return mount.model.size_px if mount is not None else None

    def _scene(self, team: Team, world: World) -> Scene | None:
        """What cameras see; None when nobody looks, for it takes long to paint."""
        looks = self.rig.cameras or self.rig.event_camera
        return build_scene(team, world) if looks else None

    def _vehicle(
        self,
        scene: Scene | None,
        light: Light,
        vehicle: int,
        count: int,
        names: Container[str] | None = None,
    ) -> VehicleSensors:
        mount, events, images = self.rig.event_camera, None, None
        if scene is not None and mount is not None:
            events = event_camera(self.events, mount, scene, light, vehicle)
        if scene is not None and self.rig.cameras:
            images = cameras(self.rig, scene, light, vehicle, count, names)
        return VehicleSensors(
            vehicle=vehicle,
            cameras=images,
            events=events,
            load_cell=self.load_cell,
            script=script_of(
                self.faults,
                1 + vehicle,
                self._camera_names,
                self._event_size_px,
                self.imu.clock_offset_us,
            ),
        )
