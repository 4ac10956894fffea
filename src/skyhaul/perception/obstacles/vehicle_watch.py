# SPDX-License-Identifier: Apache-2.0
"""One vehicle's event camera: events -> movers' events -> clusters -> directions in the world.

Movers' events of the last `window_us` are moved to where the turned camera sees them now, and
grouped every step: what moves slowly fires too seldom to be seen in one step of 10 ms. Clusters of
successive steps then share events, so their errors are alike; each counts for less accordingly.
Of a cluster with many events only the newest count, so that what is fast is not smeared; how old
they are on average is handed on with the direction.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from skyhaul.errors import ConfigError
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.model.state import TeamState
from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.perception.events.api import EventClassifier
from skyhaul.perception.events.lens import EventLens, event_lens
from skyhaul.perception.events.noise_filter import KEPT, FilterMemory, NoiseFilter, chosen
from skyhaul.perception.events.rotation import TurnMemory, turn_at
from skyhaul.perception.obstacles.api import Bearings, VehicleSight
from skyhaul.perception.obstacles.clusters import ClusterRules, Clusters
from skyhaul.perception.obstacles.own_bodies import blind_cells, own_bodies
from skyhaul.sensors.api import EventReading, VehicleCalibration
from skyhaul.types import Array, Mask, TimeUs

_CELL_PX = 4


@dataclass(frozen=True, kw_only=True)
class SightRules(Params):
    """How movers' events become directions."""

    noise: NoiseFilter = field(default_factory=lambda: NoiseFilter(support_us=25_000))
    """What is dropped before the classifier."""
    clusters: ClusterRules = field(
        default_factory=lambda: ClusterRules(
            cell_px=2,
            dense_count=4.0,
            join_cells=0,
            min_events=8,
            newest=60,
            margin=0.0,
            edge_px=0.0,
        )
    )
    """How movers' events are grouped."""
    window_us: int = 60_000
    """Events of so long a time are grouped [us]."""
    pixel_sigma: float = 0.4
    """Standard deviation of the middle of a cluster [px]."""
    size_sigma: float = 0.1
    """What is added to it, as a share of the cluster's size."""
    body_margin_m: float = 0.05
    """The team's own bodies are left out with this margin [m]."""

    def __post_init__(self) -> None:
        for name in ("window_us", "pixel_sigma"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        for name in ("size_sigma", "body_margin_m"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class VehicleWatchMemory:
    """What one vehicle remembers between steps."""

    turn: TurnMemory
    noise: FilterMemory
    classifier: Any
    movers: EventReading  # of the window
    turn_C: Array  # (k, 3) of the camera at each of them [rad]


class CameraPose(NamedTuple):
    """Where a camera is, how fast it flies, and how well that is known."""

    p_WC: Array  # (3,) [m]
    v_WC: Array  # (3,) [m/s]
    R_WC: Array  # (3, 3)
    covariance: Array  # (6, 6) of position [m] and attitude [rad], W axes


@dataclass(frozen=True, eq=False)
class VehicleWatch:
    """The chain of one vehicle; build it with `vehicle_watch`."""

    vehicle: int
    team: Team
    calibration: VehicleCalibration
    lens: EventLens
    classifier: EventClassifier[Any]
    rules: SightRules

    def init(self) -> VehicleWatchMemory:
        """Memory before the first event."""
        none = np.zeros(0, np.int64)
        empty = EventReading(
            none, none.astype(np.int16), none.astype(np.int16), none.astype(np.int8)
        )
        return VehicleWatchMemory(
            TurnMemory(), self.rules.noise.init(self.lens.width, self.lens.height),
            self.classifier.init(self.lens), empty, np.zeros((0, 3)),
        )  # fmt: skip

    def step(
        self, memory: VehicleWatchMemory, stamp_us: TimeUs, team: TeamState, attached: Mask,
        sight: VehicleSight,
    ) -> tuple[VehicleWatchMemory, Bearings]:  # fmt: skip
        """Take in the events up to a time; what moves."""
        event_camera = self.calibration.rig.event_camera
        assert event_camera is not None
        R_WB = quat_to_R(team.q_WB[self.vehicle])
        R_WC = R_WB @ event_camera.R_BC
        gyro_C = sight.imu.gyro_I @ (self.calibration.imu.R_BI.T @ event_camera.R_BC)
        imu_us = sight.imu.stamp_us - self.calibration.imu.clock_offset_us
        turn, turns = turn_at(memory.turn, imu_us, gyro_C, np.append(sight.events.t_us, stamp_us))
        noise, why = self.rules.noise.step(memory.noise, sight.events)
        keep = why == KEPT
        kept, turn_kept = chosen(sight.events, keep), turns[:-1][keep]
        arm_W = R_WB @ event_camera.p_BC
        p_WC = team.p_WB[self.vehicle] + arm_W
        v_WC = team.v_WB[self.vehicle] + np.cross(R_WB @ team.w_WB_B[self.vehicle], arm_W)
        v_C = np.broadcast_to(R_WC.T @ v_WC, (len(kept.t_us), 3))
        classifier, scores = self.classifier.step(memory.classifier, kept, turn_kept, v_C)
        seen = scores.mover & ~self._blind(kept, team, attached, p_WC, R_WC, sight)
        movers, turn_C = self._window(memory, chosen(kept, seen), turn_kept[seen], stamp_us)
        clusters = self.rules.clusters.find(
            self.lens, self._turned(movers, turn_C, turns[-1]), stamp_us
        )
        pose = CameraPose(p_WC, v_WC, R_WC, sight.pose_covariance)
        after = VehicleWatchMemory(turn, noise, classifier, movers, turn_C)
        return after, self._bearings(clusters, pose)

    def _window(
        self, memory: VehicleWatchMemory, new: EventReading, turn_new: Array, stamp_us: TimeUs
    ) -> tuple[EventReading, Array]:
        """Movers' events of the window."""
        old = memory.movers
        keep = slice(int(np.searchsorted(old.t_us, stamp_us - self.rules.window_us)), None)
        columns = ((getattr(old, k)[keep], getattr(new, k)) for k in ("t_us", "x", "y", "p"))
        return (
            EventReading(*(np.concatenate(c) for c in columns)),
            np.concatenate([memory.turn_C[keep], turn_new]),
        )

    def _turned(self, movers: EventReading, turn_C: Array, turn_now_C: Array) -> EventReading:
        """Events where a camera turned to `turn_now_C` sees them; outside its image none."""
        flow = self.lens.turn_flow[movers.y, movers.x]
        shift = np.einsum("kij,kj->ki", flow, turn_now_C - turn_C)
        x = np.rint(movers.x + shift[:, 0]).astype(np.int16)
        y = np.rint(movers.y + shift[:, 1]).astype(np.int16)
        inside = (x >= 0) & (x < self.lens.width) & (y >= 0) & (y < self.lens.height)
        return EventReading(movers.t_us[inside], x[inside], y[inside], movers.p[inside])

    def _blind(
        self, events: EventReading, team: TeamState, attached: Mask, p_WC: Array, R_WC: Array,
        sight: VehicleSight,
    ) -> Mask:  # fmt: skip
        """Which events lie where the team's own bodies are."""
        half = _CELL_PX // 2
        rays_C = self.lens.rays_C[half::_CELL_PX, half::_CELL_PX]
        rays_W = rays_C.reshape(-1, 3) @ R_WC.T
        bodies = own_bodies(self.team, team, attached, self.vehicle)
        pixel = float(np.arccos(np.clip(rays_C[0, 0] @ rays_C[0, 1], -1.0, 1.0))) / _CELL_PX
        sigma_p, sigma_angle = _sigmas(sight.pose_covariance)
        slack = 0.75 * _CELL_PX * pixel + 2.0 * sigma_angle
        margin_m = self.rules.body_margin_m + 2.0 * sigma_p
        blind = blind_cells(rays_W, p_WC, bodies, margin_m, slack).reshape(rays_C.shape[:2])
        found: Mask = blind[events.y // _CELL_PX, events.x // _CELL_PX]
        return found

    def _bearings(self, clusters: Clusters, pose: CameraPose) -> Bearings:
        """Directions in the world, with their errors: of the cluster, of the pose, of its age."""
        size = 2.0 * np.sqrt(np.prod(clusters.half_size, axis=1))
        per_px = clusters.half_angle_rad / np.maximum(0.5 * size, 0.5)
        sigma_p, sigma_angle = _sigmas(pose.covariance)
        in_image = np.hypot(self.rules.pixel_sigma, self.rules.size_sigma * size) * per_px
        cut = self._cut(clusters)
        sigma = np.sqrt(in_image**2 + sigma_angle**2 + (sigma_p / _USUAL_M) ** 2)
        sigma = np.where(cut, sigma + clusters.half_angle_rad + _CUT_RAD, sigma)
        alike = np.maximum(2.0 * clusters.age_s / _STEP_S, 1.0)
        none = np.full(len(sigma), np.nan)
        p_then = pose.p_WC - clusters.age_s[:, None] * pose.v_WC
        return Bearings(
            clusters.stamp_us, self.vehicle, p_then, pose.v_WC, clusters.dir_C @ pose.R_WC.T, sigma,
            clusters.half_angle_rad, none, none.copy(), clusters.age_s, alike,
        )  # fmt: skip

    def _cut(self, clusters: Clusters) -> Mask:
        """Which clusters end at the border of the image: their middle is not the obstacle's."""
        low, high = clusters.middle - clusters.half_size, clusters.middle + clusters.half_size
        edge = np.array([self.lens.width, self.lens.height]) - 1.0 - _BORDER_PX
        cut: Mask = np.any((low < _BORDER_PX) | (high > edge), axis=1)
        return cut


_STEP_S = 0.01
"""Time between two steps; events that are older were in earlier clusters too [s]."""
_BORDER_PX = 3.0
"""What comes so close to the border may go on beyond it [px]."""
_CUT_RAD = 0.08
"""By how much the middle of what ends at the border may be off besides [rad]."""
_USUAL_M = 3.0
"""Distance at which a vehicle's error of position is taken as one of direction [m]."""


def _sigmas(covariance: Array) -> tuple[float, float]:
    """Standard deviations of position [m] and of attitude [rad], the mean over the axes."""
    return (
        float(np.sqrt(np.trace(covariance[:3, :3]) / 3.0)),
        float(np.sqrt(np.trace(covariance[3:, 3:]) / 3.0)),
    )


def vehicle_watch(
    vehicle: int, team: Team, calibration: VehicleCalibration, classifier: EventClassifier[Any],
    rules: SightRules,
) -> VehicleWatch:  # fmt: skip
    """The chain of one vehicle.

    Raises:
        ConfigError: When its rig has no event camera.
    """
    camera = calibration.rig.event_camera
    if camera is None:
        raise ConfigError(
            "sensors.rig.event_camera: null, but obstacles of kind events need one; leave it out "
            "or take perception.obstacles.kind truth"
        )
    lens = event_lens(camera.model)
    return VehicleWatch(vehicle, team, calibration, lens, classifier, rules)
