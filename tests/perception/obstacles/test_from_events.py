# SPDX-License-Identifier: Apache-2.0
"""Events of made-up movers through the whole chain of a team."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.errors import ConfigError
from skyhaul.geometry.camera import project_points
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.perception.obstacles.from_events import EventObstacles
from skyhaul.sensors.api import EventReading
from skyhaul.sensors.config import SensorsConfig
from skyhaul.sensors.rig import RigParams

from .conftest import PERIOD_US, Swing, nearest, state_of
from .sights import CAMERA, TEAM, All, sight, watch


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


class Ear(All):
    """Keeps the velocities that it is told."""

    def __init__(self):
        self.told = []

    def step(self, lens, events, turn_C, v_WC_C=None):
        self.told.append(v_WC_C)
        return super().step(lens, events, turn_C)


def test_the_classifier_is_told_how_the_camera_flies():
    """A camera off the middle of a vehicle that turns: v is the derivative of its place."""
    estimator, ear = watch(), Ear()
    first = replace(estimator.watches[0], classifier=ear)
    estimator = replace(estimator, watches=(first, *estimator.watches[1:]))
    follow(estimator, [Swing(ahead_of((0, 1), 3.5), (0.0, 0.0, 0.6))], 3, yaw_rate=1.0)

    def place(t_s):
        state = state_of(TEAM, 1.0, t_s)
        R_WB = quat_to_R(state.q_WB[0])
        return state.p_WB[0] + R_WB @ CAMERA.p_BC, R_WB @ CAMERA.R_BC

    t, h = 2e-6 * PERIOD_US, 1e-5
    v_WC = (place(t + h)[0] - place(t - h)[0]) / (2 * h)
    assert np.linalg.norm(v_WC) > 0.01
    np.testing.assert_allclose(
        ear.told[-1], np.tile(place(t)[1].T @ v_WC, (len(ear.told[-1]), 1)), atol=1e-8
    )


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
