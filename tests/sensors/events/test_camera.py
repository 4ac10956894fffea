# SPDX-License-Identifier: Apache-2.0
"""Tests of `sensors.events.camera`: when it renders, and what it blames for events."""

import hashlib
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.camera import project
from skyhaul.geometry.shapes import pose_shapes
from skyhaul.mission.config import RunConfig
from skyhaul.sensors.camera import camera_pose
from skyhaul.sensors.events.camera import EventParams, Pacing, event_camera
from skyhaul.sensors.events.pixels import EventPixels
from skyhaul.sensors.imaging.scene import build_scene
from skyhaul.sensors.optics import LensParams
from skyhaul.sensors.rig import EventCameraMount
from skyhaul.world.load import load_config
from skyhaul.world.scenario import Light, LightChange

QUIET = EventParams(pixels=EventPixels(leak_hz=0.0, shot_hz=0.0, hot_share=0.0))
MOUNT = EventCameraMount(lens=LensParams(kind="equidistant", size_px=(80, 60), fov_deg=150.0))
STEP_US = 2_000


@pytest.fixture(scope="module")
def config():
    return load_config(RunConfig, "paper", ())


@pytest.fixture(scope="module")
def scene(config):
    return build_scene(config.team, config.world)


@pytest.fixture
def still(config, make_truth):
    """Vehicles hover apart in the hall; vehicle 0 looks along +x."""
    obstacles = config.world.obstacles
    p_WB = [[-4.0, 0.0, 1.5], [-4.0, 3.0, 1.5], [-4.0, -3.0, 1.5], [-6.0, 0.0, 1.5]]
    return make_truth(p_WB, [o.shape for o in obstacles], [o.center_m for o in obstacles])


def turned(truth, t_us, rate):
    """Vehicle 0 yaws at a rate [rad/s]."""
    team, angle = truth.team, 0.5e-6 * rate * t_us
    q, w = team.q_WB.copy(), team.w_WB_B.copy()
    q[0], w[0, 2] = (math.cos(angle), 0.0, 0.0, math.sin(angle)), rate
    return replace(truth, stamp_us=t_us, team=replace(team, q_WB=q, w_WB_B=w))


def watch(camera, states, seed=0):
    """Readings of a flight with their labels, and the times of renderings."""
    memory, readings, at, renderings = camera.init(seed), [], [], 0
    for truth in states:
        memory, reading, labels = camera.step(memory, truth)
        if memory.renderings > renderings:
            renderings = memory.renderings
            at.append(truth.stamp_us)
        if reading is not None:
            readings.append((reading, labels))
    columns = [
        np.concatenate([getattr(r, k) for r, _ in readings]) for k in ("t_us", "x", "y", "p")
    ]
    return np.column_stack([*columns, np.concatenate([v.object_id for _, v in readings])]), at


def test_the_wait_is_that_in_which_the_image_moves_by_flow_px():
    pacing = Pacing(flow_px=0.5, longest_us=20_000)
    assert pacing.due_us(1_000, 100.0) == 6_000
    assert pacing.due_us(1_000, 25.0) == 21_000
    assert pacing.due_us(1_000, 0.0) == 21_000
    with pytest.raises(ValueError, match="flow_px"):
        Pacing(flow_px=0.0)
    with pytest.raises(ValueError, match="longest_us"):
        Pacing(longest_us=100)


def test_no_rendering_comes_between_two_steps_however_fast_the_image_moves(scene, still):
    camera = event_camera(QUIET, MOUNT, scene, Light(), 0)
    states = [turned(still, t_us, 30.0) for t_us in range(0, 20_000, STEP_US)]
    memory = camera.init(0)
    for truth in states:
        memory, _, _ = camera.step(memory, truth)
    assert memory.renderings == len(states)
    assert memory.flow_pxps * STEP_US > 1.2e6 * QUIET.pacing.flow_px  # the limit is exceeded


def test_where_nothing_moves_nothing_fires_and_little_is_rendered(scene, still):
    camera = event_camera(QUIET, MOUNT, scene, Light(), 0)
    states = (replace(still, stamp_us=t) for t in range(0, 200_001, STEP_US))
    events, at = watch(camera, states)
    assert len(events) == 0
    assert np.diff(at).tolist() == [20_000] * 10


@pytest.mark.parametrize("rate", [0.5, 3.0])
def test_the_image_moves_by_one_pixel_at_most_between_renderings(scene, still, rate):
    camera = event_camera(QUIET, MOUNT, scene, Light(), 0)
    states = (turned(still, t, rate) for t in range(0, 300_001, STEP_US))
    events, at = watch(camera, states)
    focal = MOUNT.model.focal_px[0]
    waits = np.diff(at)
    assert waits.max() <= 20_000
    assert waits.max() * 1e-6 * rate * focal <= 1.0 + 1e-9
    assert waits.min() + STEP_US > min(20_000, 0.6e6 / (rate * focal))
    assert len(events) > 1_000
    assert np.all(np.diff(events[:, 0]) >= 0)


def test_a_mover_is_seen_where_it_is_and_blamed(scene, still, config):
    """A still camera: all events are of the one obstacle that moves."""
    camera = event_camera(QUIET, MOUNT, scene, Light(), 0)
    names = [o.name for o in config.world.obstacles]
    row = names.index("mover 1")
    speed = np.array([0.0, 2.0, 0.0])
    states = []
    for t in range(0, 300_001, STEP_US):
        p_WO = still.obstacles.p_WO.copy()
        p_WO[row] = np.array([-3.1, -0.3, 1.6]) + 1e-6 * t * speed
        v_WO = np.zeros_like(p_WO)
        v_WO[row] = speed
        shapes = pose_shapes([o.shape for o in config.world.obstacles], p_WO)
        states.append(replace(still, stamp_us=t, obstacles=shapes, v_WO=v_WO))
    events, _ = watch(camera, states)
    mover = scene.names.index("mover 1")
    assert len(events) > 300
    assert np.mean(events[:, 4] == mover) > 0.85  # the others: pixels that its edge half covers
    middle = events[(events[:, 0] > 140_000) & (events[:, 0] < 160_000)]
    p_WC, R_WC = camera_pose(camera.calibration, still, 0)
    p_C = R_WC.T @ (states[75].obstacles.p_WO[row] - p_WC)
    u, v, _ = project(MOUNT.model.arrays(), *p_C)
    assert abs(np.mean(middle[:, 1]) - u) < 2.0
    assert abs(np.mean(middle[:, 2]) - v) < 2.0


def test_a_lamp_that_fails_is_rendered_at_once_and_fires_everywhere(scene, still):
    lamp = Light(changes=(LightChange(at_s=0.101, level=0.4),))
    camera = event_camera(QUIET, MOUNT, scene, lamp, 0)
    states = (replace(still, stamp_us=t) for t in range(0, 160_001, STEP_US))
    events, at = watch(camera, states)
    assert 100_000 in at
    assert 102_000 in at
    assert np.all(events[:, 3] == -1)
    assert np.all(events[:, 0] >= 100_000)
    assert len(np.unique(events[:, 1] + 80 * events[:, 2])) > 0.95 * 80 * 60


def test_the_same_seed_gives_the_same_bytes_and_another_one_others(scene, still):
    camera = event_camera(EventParams(), MOUNT, scene, Light(), 0)
    runs = [
        watch(camera, (turned(still, t, 1.0) for t in range(0, 60_001, STEP_US)), seed)[0].tobytes()
        for seed in (1, 1, 2)
    ]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


SCRIPT = """
import hashlib
import numpy as np
from skyhaul.sensors.events.kernel import View
from skyhaul.sensors.events.pixels import EventPixels

rng = np.random.default_rng(4)
lights = rng.uniform(0.1, 0.9, (6, 600)).astype(np.float32)
views = [View(v, np.arange(600, dtype=np.int16), np.ones(600)) for v in lights]
params = EventPixels(shot_hz=50.0)
memory, total = params.init(views[0], 30, 0, np.random.default_rng(9)), hashlib.sha256()
for k, view in enumerate(views[1:]):
    memory, r, labels = params.step(memory, view, 5000 * (k + 1))
    for column in (r.t_us, r.x, r.y, r.p, labels.object_id):
        total.update(column.tobytes())
print(total.hexdigest())
"""


def test_another_process_gives_the_same_bytes(capsys):
    exec(SCRIPT, {})
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    assert done.stdout == capsys.readouterr().out
    assert len(done.stdout.strip()) == len(hashlib.sha256().hexdigest())
