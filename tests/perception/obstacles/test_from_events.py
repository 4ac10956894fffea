# SPDX-License-Identifier: Apache-2.0
"""Events of made-up movers through the whole chain of a team."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from skyhaul.errors import ConfigError
from skyhaul.geometry.camera import project_points
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.model.team import Team
from skyhaul.perception.events.api import EventScores, Work
from skyhaul.perception.obstacles.api import TeamSight, VehicleSight
from skyhaul.perception.obstacles.from_events import EventObstacles
from skyhaul.sensors.api import EventReading, ImuReading
from skyhaul.sensors.config import SensorsConfig
from skyhaul.sensors.rig import RigParams

from .conftest import PERIOD_US, Swing, nearest, state_of

TEAM, CALIBRATION = Team(), SensorsConfig().calibration()
CAMERA = CALIBRATION.rig.event_camera
IMU_US = 2_000


@dataclass(frozen=True)
class All:
    """Every event is a mover's: here nothing else fires."""

    def init(self, lens):
        return lens

    def step(self, lens, events, turn_C):
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
        of_all = [edge_events(i, m, k, rng, yaw_rate) for m in movers]
        columns = [np.concatenate([getattr(e, c) for e in of_all]) for c in ("t_us", "x", "y", "p")]
        order = np.argsort(columns[0], kind="stable")
        events = EventReading(*(c[order] for c in columns))
        imu = ImuReading(stamps, gyro, np.zeros_like(gyro))
        parts.append(VehicleSight(i, events, imu, np.zeros((6, 6))))
    return TeamSight(k * PERIOD_US, state, np.ones(TEAM.count, np.bool_), tuple(parts))


def follow(estimator, movers, steps, **how):
    rng, memory, out = np.random.default_rng(0), estimator.init(), []
    for k in range(1, steps):
        memory, estimate = estimator.step(memory, sight(movers, k, rng, **how))
        out.append(estimate)
    return out


def ahead_of(vehicles, distance_m):
    """A place between the views of some vehicles."""
    d = np.mean([[np.cos(a), np.sin(a), 0.0] for a in TEAM.azimuths_rad[list(vehicles)]], axis=0)
    return tuple(distance_m * d / np.linalg.norm(d) + [0.0, 0.0, 2.0])


@pytest.mark.parametrize("yaw_rate", [0.0, 1.0])
def test_a_mover_that_two_cameras_see_is_found_within_80_ms_and_placed(yaw_rate):
    """Turning cameras change nothing: the gyro and the poses take the turn out."""
    movers = [Swing(ahead_of((0, 1), 3.5), (0.0, 0.0, 0.6))]
    out = follow(watch(), movers, 45, yaw_rate=yaw_rate)
    first = next(k for k, e in enumerate(out, start=1) if e.tracks)
    assert first * PERIOD_US <= 80_000
    (track,) = out[-1].tracks
    assert track.stamp_us == out[-1].stamp_us
    assert nearest(track, movers, 1e-6 * track.stamp_us)[1] < 0.2
    assert np.linalg.norm(track.v_WO - movers[0].velocity(0.0)) < 0.3
    assert track.shape.radius_m == pytest.approx(0.2, rel=0.25)


def test_a_silent_vehicle_leaves_a_track_that_says_how_unsure_it_is():
    movers = [Swing(ahead_of((0, 1), 3.5), (0.0, 0.0, 0.6))]
    (track,) = follow(watch(), movers, 30, vehicles=(0,))[-1].tracks
    assert np.sqrt(np.linalg.eigvalsh(track.covariance[:3, :3])[-1]) > 0.5
    assert nearest(track, movers, 0.29)[1] < track.tube_m(0.0)


def test_the_team_itself_is_no_mover():
    """Whatever fires where another vehicle is becomes no track; beside it something else does."""
    state = state_of(TEAM, 0.0)
    turned = replace(state, q_WB=np.roll(state.q_WB, 2, axis=0))  # all look inward, at each other
    for where, count in ((state.p_WB[2], 0), (state.p_WB[2] + [0.0, 0.0, 1.0], 1)):
        rng, estimator = np.random.default_rng(0), watch()
        memory = estimator.init()
        for k in range(1, 15):
            made = sight([Swing((9.0, 0.0, 2.0), (0.0, 0.0, 0.0))], k, rng, vehicles=(0,))
            events = _of_ball(turned, 0, where, k, rng)
            seen = replace(made, team=turned, vehicles=(replace(made.vehicles[0], events=events),))
            memory, estimate = estimator.step(memory, seen)
        assert len(estimate.tracks) == count


def _of_ball(state, vehicle, where, k, rng):
    R_WB = quat_to_R(state.q_WB[vehicle])
    p_WC, R_WC = state.p_WB[vehicle] + R_WB @ CAMERA.p_BC, R_WB @ CAMERA.R_BC
    uv, _ = project_points(CAMERA.model, (where + 0.1 * rng.normal(size=(40, 3)) - p_WC) @ R_WC)
    uv = np.rint(uv).astype(np.int16)
    t_us = np.sort(rng.integers((k - 1) * PERIOD_US + 1, k * PERIOD_US, 40))
    return EventReading(t_us, uv[:, 0], uv[:, 1], np.ones(40, np.int8))


def test_without_an_event_camera_it_says_so():
    bare = SensorsConfig(rig=RigParams(event_camera=None)).calibration()
    with pytest.raises(ConfigError, match="event_camera"):
        EventObstacles().build(TEAM, bare)
