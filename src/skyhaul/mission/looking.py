# SPDX-License-Identifier: Apache-2.0
"""From the true state, or from what the vehicles' cameras delivered, to the obstacles."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from skyhaul.errors import ConfigError
from skyhaul.mission.config import RunConfig
from skyhaul.mission.stopwatch import Stopwatch
from skyhaul.perception.api import ObstacleEstimate, TeamEstimate
from skyhaul.perception.obstacles.api import TeamViews, VehicleView
from skyhaul.perception.obstacles.truth import TruthObstacles
from skyhaul.perception.scene.from_cameras import CameraObstacles
from skyhaul.plant.api import Truth
from skyhaul.sensors.api import VehicleReading

OBSTACLE_PERIOD_US = 20_000
"""Time between two estimates of obstacles, and two updates of M(t) [us]."""


class ObstacleLook(Protocol):
    """Sensors and estimator of obstacles in a flight. Stateful: there is one of it."""

    def look(
        self, truth: Truth, estimate: TeamEstimate, readings: Sequence[VehicleReading]
    ) -> ObstacleEstimate | None:
        """The obstacles, when it is due; called at every step of the plant."""
        ...


class PerfectLook:
    """Perfect sensors."""

    def __init__(self, config: RunConfig, estimator: TruthObstacles) -> None:
        self._shapes = tuple(o.shape for o in config.world.obstacles)
        self._sensors, self._estimator = config.sensors.objects, estimator
        self._seen, self._memory = self._sensors.init(len(self._shapes)), estimator.init()

    def look(
        self, truth: Truth, estimate: TeamEstimate, readings: Sequence[VehicleReading]
    ) -> ObstacleEstimate | None:
        """See `ObstacleLook.look`."""
        if truth.stamp_us % OBSTACLE_PERIOD_US:
            return None
        self._seen, reading = self._sensors.read(self._seen, truth, self._shapes)
        self._memory, obstacles = self._estimator.step(self._memory, reading)
        return obstacles


class CameraLook:
    """The vehicles' cameras. Images are read when they come, at the estimate of that time."""

    def __init__(self, config: RunConfig, kind: CameraObstacles, watch: Stopwatch) -> None:
        frame, room = config.world.map, config.world.room
        cells = np.ceil(np.array(frame.size_m) / frame.voxel_m - 1e-9).astype(np.int64)
        self._estimator = kind.build(
            config.team,
            config.sensors.calibration(),
            np.array([room.min_m, room.max_m], dtype=np.float64),
            np.array(frame.origin_m) + 0.5 * frame.voxel_m,
            frame.voxel_m,
            cells,
        )
        self._memory, self._watch = self._estimator.init(), watch
        self._pair = self._estimator.pair

    def look(
        self, truth: Truth, estimate: TeamEstimate, readings: Sequence[VehicleReading]
    ) -> ObstacleEstimate | None:
        """See `ObstacleLook.look`."""
        views = tuple(self._views(estimate, readings))
        due = estimate.stamp_us % OBSTACLE_PERIOD_US == 0
        if not views and not due:
            return None
        with self._watch.stage("scene"):
            reading = TeamViews(estimate.stamp_us, estimate.team, estimate.attached.copy(), views)
            self._memory, obstacles = self._estimator.step(self._memory, reading)
        return obstacles if due else None

    def _views(
        self, estimate: TeamEstimate, readings: Sequence[VehicleReading]
    ) -> list[VehicleView]:
        """Of each vehicle whose pair delivered both images of one time."""
        views = []
        for reading in readings:
            found = {f.camera: f for f in reading.frames}
            left, right = (found.pop(k, None) for k in self._pair)
            if left is None or right is None or left.stamp_us != right.stamp_us:
                continue
            cov = estimate.load_covariance[:6, :6].copy()
            others = tuple(
                (k, f.image) for k, f in sorted(found.items()) if f.stamp_us == left.stamp_us
            )
            views.append(
                VehicleView(
                    reading.vehicle, estimate.stamp_us, left.image, right.image, cov, others
                )
            )
        return views


def obstacle_look(config: RunConfig, watch: Stopwatch) -> ObstacleLook:
    """What the configuration asks for.

    Raises:
        ConfigError: When it is an estimator that a flight has no readings for.
    """
    match config.perception.obstacles:
        case CameraObstacles() as kind:
            return CameraLook(config, kind, watch)
        case TruthObstacles() as exact:
            return PerfectLook(config, exact)
        case other:
            raise ConfigError(
                f"perception.obstacles.kind: {other.kind} runs over recorded events only; a "
                "flight takes kind truth or cameras"
            )
