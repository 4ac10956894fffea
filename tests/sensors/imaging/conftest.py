# SPDX-License-Identifier: Apache-2.0
"""Small worlds to look at, and a team that hovers in formation."""

import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_mul
from skyhaul.geometry.shapes import Box, Capsule, Sphere
from skyhaul.model.dynamics import vehicle_motion
from skyhaul.model.formation import hover_state
from skyhaul.model.state import CableState, TeamState
from skyhaul.model.team import Team
from skyhaul.plant.api import Truth
from skyhaul.sensors.imaging.frame import blank_frame
from skyhaul.sensors.imaging.lens import make_lens
from skyhaul.sensors.imaging.raycast import render
from skyhaul.sensors.imaging.scene import build_scene
from skyhaul.world.motion import obstacle_field
from skyhaul.world.obstacles import Line, Obstacle
from skyhaul.world.scenario import Room, World

TEAM = Team()
ROOM = Room(min_m=(-5.0, -4.0, 0.0), max_m=(5.0, 4.0, 5.0))
OBSTACLES = (
    Obstacle(name="crate", shape=Box(size_m=(0.9, 0.6, 1.2), yaw_deg=30.0),
             center_m=(2.5, 1.0, 1.8)),
    Obstacle(name="ball", shape=Sphere(radius_m=0.4), center_m=(2.2, -1.2, 2.4),
             motion=Line(velocity_mps=(0.3, 0.4, -0.2))),
    Obstacle(name="pole", shape=Capsule(radius_m=0.15, length_m=1.6, axis=(0.3, 0.2, 1.0)),
             center_m=(3.0, 0.1, 2.6)),
)  # fmt: skip
WORLD = World(room=ROOM, obstacles=OBSTACLES)


def formation(p_WL=(0.0, 0.0, 1.5), yaw_off_deg=45.0, t_us=0, turn=(0.0, 0.0, 0.0), world=WORLD):
    """Truth of a team that hovers, every vehicle turned outward by its cable's azimuth + offset."""
    state, arrays = hover_state(TEAM, np.array(p_WL)), TEAM.arrays()
    half = 0.5 * (TEAM.azimuths_rad + np.radians(yaw_off_deg))
    yaw = np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])
    q_WB, n, m = quat_mul(yaw, state.q_WB), TEAM.count, len(world.obstacles)
    spin = np.tile(np.array(turn, dtype=np.float64), (n, 1))
    team = TeamState(
        state.p_WL, state.q_WL, state.v_WL, state.w_WL_L, vehicle_motion(arrays, state)[0],
        q_WB, np.zeros((n, 3)), spin,
    )  # fmt: skip
    field = obstacle_field(world, 0)
    return Truth(
        stamp_us=t_us, team=team,
        cables=CableState(state.cable_dir_W, np.zeros((n, 3)), np.ones(n), arrays.length.copy()),
        attached=np.ones(n, bool), alive=np.ones(n, bool), rotor_thrust=np.ones((n, 4)),
        accel_W=np.zeros((1 + n, 3)), obstacles=field.shapes_at(t_us),
        v_WO=field.velocities_at(t_us), present=np.ones(m, bool), wind_W=np.zeros(3),
        clearance_m=1.0, contacts=(),
    )  # fmt: skip


def look(scene, model, p_WC, R_WC, own=-1, frame=None, lens=None):
    """A frame of a posed scene."""
    lens = lens or make_lens(model)
    frame = frame or blank_frame(scene.arrays, lens)
    p, R = np.array(p_WC, dtype=np.float64), np.ascontiguousarray(R_WC, dtype=np.float64)
    render(scene.arrays, lens, p, R, own, frame)
    return frame


@pytest.fixture(scope="session")
def scene():
    """Room, obstacles and team; whoever moves it poses it first."""
    return build_scene(TEAM, WORLD)


@pytest.fixture
def hovering():
    return formation


@pytest.fixture
def see():
    return look


@pytest.fixture
def world():
    return WORLD


@pytest.fixture
def team():
    return TEAM
