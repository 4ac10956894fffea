# SPDX-License-Identifier: Apache-2.0
"""What the event cameras of a team see of made-up movers."""

from dataclasses import dataclass, replace

import numpy as np

from skyhaul.geometry.camera import project_points
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.model.team import Team
from skyhaul.perception.events.api import EventScores, Work
from skyhaul.perception.obstacles.api import TeamSight, VehicleSight
from skyhaul.perception.obstacles.from_events import EventObstacles
from skyhaul.sensors.api import EventReading, ImuReading
from skyhaul.sensors.config import SensorsConfig

from .conftest import PERIOD_US, state_of

TEAM, CALIBRATION = Team(), SensorsConfig().calibration()
CAMERA = CALIBRATION.rig.event_camera
IMU_US = 2_000


@dataclass(frozen=True)
class All:
    """Every event is a mover's: here nothing else fires."""

    def init(self, lens):
        return lens

    def step(self, lens, events, turn_C, v_WC_C=None):
        newest = int(events.t_us[-1]) if len(events.t_us) else 0
        cells = np.zeros((-(-lens.height // 16), -(-lens.width // 16)), np.float32)
        return lens, EventScores(newest, np.ones(len(events.t_us), np.float32), cells, 16)

    def work(self, lens):
        return Work()


def watch(params=None):
    built = (params or EventObstacles()).build(TEAM, CALIBRATION)
    return replace(built, watches=tuple(replace(w, classifier=All()) for w in built.watches))


def edge_events(vehicle, mover, k, rng, yaw_rate=0.0, per_ms=4):
    """Events on the rim and inside of a ball, as a camera sees it in the step before k."""
    columns = []
    for ms in range(10):
        t_us = (k - 1) * PERIOD_US + 1_000 * ms + 500
        state = state_of(TEAM, yaw_rate, 1e-6 * t_us)
        R_WB = quat_to_R(state.q_WB[vehicle])
        p_WC, R_WC = state.p_WB[vehicle] + R_WB @ CAMERA.p_BC, R_WB @ CAMERA.R_BC
        points = rng.normal(size=(per_ms, 3))
        points *= mover.radius_m / np.linalg.norm(points, axis=1, keepdims=True)
        uv, seen = project_points(CAMERA.model, (mover.place(1e-6 * t_us) + points - p_WC) @ R_WC)
        w, h = CAMERA.model.size_px
        uv = uv[seen]
        uv = np.rint(uv[np.all((uv >= 0) & (uv <= [w - 1, h - 1]), axis=1)]).astype(np.int16)
        columns += [(t_us, *one) for one in uv]
    table = np.array(columns, dtype=np.int64).reshape(-1, 3)
    ones = np.ones(len(table), np.int8)
    return EventReading(table[:, 0], table[:, 1].astype(np.int16), table[:, 2].astype(np.int16),
                        ones)  # fmt: skip


def sight(movers, k, rng, yaw_rate=0.0, vehicles=range(4)):
    """What the team has at step k."""
    state = state_of(TEAM, yaw_rate, 1e-6 * k * PERIOD_US)
    stamps = np.arange((k - 1) * PERIOD_US + IMU_US, k * PERIOD_US + 1, IMU_US)
    gyro = np.tile([0.0, 0.0, yaw_rate], (len(stamps), 1)) @ CALIBRATION.imu.R_BI
    parts = []
    for i in vehicles:
        none = np.zeros(0, np.int64)
        of_all = [EventReading(none, none.astype(np.int16), none.astype(np.int16), none)]
        of_all += [edge_events(i, m, k, rng, yaw_rate) for m in movers]
        columns = [np.concatenate([getattr(e, c) for e in of_all]) for c in ("t_us", "x", "y", "p")]
        order = np.argsort(columns[0], kind="stable")
        events = EventReading(*(c[order] for c in columns))
        imu = ImuReading(stamps, gyro, np.zeros_like(gyro))
        parts.append(VehicleSight(i, events, imu, np.zeros((6, 6))))
    return TeamSight(k * PERIOD_US, state, np.ones(TEAM.count, np.bool_), tuple(parts))
