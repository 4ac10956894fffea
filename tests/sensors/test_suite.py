# SPDX-License-Identifier: Apache-2.0
"""Suites: the same bytes in a flight, after it, alone, in company and in another process."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skyhaul.model.team import Team
from skyhaul.plant.api import PLANT_STEP_US
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.sensors import config
from skyhaul.sensors.config import SensorsConfig
from skyhaul.sensors.faults import ImuGap
from skyhaul.sensors.load_cell import LoadCell
from skyhaul.sensors.optics import LensParams
from skyhaul.sensors.rig import CameraMount, EventCameraMount, RigParams
from skyhaul.sensors.truth_track import TrackWriter, TruthTrack, load_track
from skyhaul.world.load import load_config
from skyhaul.world.scenario import Scenario, World

FISHEYE = LensParams(kind="equidistant", size_px=(24, 16), fov_deg=140.0)
SENSORS = SensorsConfig(
    rig=RigParams(
        cameras=(
            CameraMount(
                name="front",
                lens=LensParams(size_px=(32, 24), fov_deg=80.0),
                p_BC_m=(0.05, 0.0, 0.0),
            ),
        ),
        event_camera=EventCameraMount(lens=FISHEYE),
    ),
    load_cell=LoadCell(),
    faults=(
        ImuGap(vehicle=1, start_s=0.1, duration_s=0.1),
        ImuGap(vehicle="payload", start_s=0.3, duration_s=0.05),
    ),
)
SEED = 4
pytestmark = pytest.mark.timeout(1200)  # the first run compiles the ray caster


@pytest.fixture(scope="module")
def track() -> TruthTrack:
    plant, writer = MujocoPlant(load_config(Scenario, "hover"), 0), TrackWriter()
    writer.add(plant.truth())
    rotors = plant.truth().rotor_thrust
    for k in range(600):
        writer.add(plant.step(rotors * (1.0 + 0.01 * np.sin(0.05 * k))))
    return writer.track()


def bytes_of(readings) -> bytes:
    """Everything that was delivered."""
    parts = []
    for r in readings:
        parts += [r.imu.stamp_us, r.imu.gyro_I, r.imu.accel_I]
        cell = getattr(r, "load_cell", None)
        parts += [cell.stamp_us, cell.tension] if cell is not None else []
        for frame in getattr(r, "frames", ()):
            parts += [np.array([frame.stamp_us, frame.camera]), frame.image]
        events = getattr(r, "events", None)
        parts += [events.t_us, events.x, events.y, events.p] if events is not None else []
    return b"".join(a.tobytes() for a in parts)


def alone(track: TruthTrack, vehicle: int) -> bytes:
    suite, out = SENSORS.vehicle_suite(Team(), World(), vehicle), []
    memory = suite.init(SEED)
    for truth in track.truths():
        memory, reading, _ = suite.step(memory, truth)
        out.append(reading)
    return bytes_of(out)


def alone_from_file(path: Path, vehicle: int) -> bytes:
    return alone(load_track(path), vehicle)


def test_replay_gives_the_bytes_of_the_flight(track) -> None:
    team = SENSORS.team_suite(Team(), World())
    memory, payload, vehicles = team.init(SEED), [], [[] for _ in range(4)]
    for truth in track.truths():
        memory, load, readings = team.step(memory, truth)
        payload.append(load)
        for i, reading in enumerate(readings):
            assert reading.vehicle == i
            vehicles[i].append(reading)
    for i in (3, 1, 0, 2):
        assert bytes_of(vehicles[i]) == alone(track, i)
    suite = SENSORS.payload_suite()
    single, out = suite.init(SEED), []
    for truth in track.truths():
        single, reading = suite.step(single, truth)
        out.append(reading)
    assert bytes_of(payload) == bytes_of(out)


def test_cameras_that_nobody_looks_at_change_no_reading_of_the_others(track) -> None:
    front = SENSORS.rig.cameras[0]
    rig = replace(SENSORS.rig, cameras=(front, replace(front, name="down")))
    sensors = replace(SENSORS, rig=rig)
    all_of_it = sensors.team_suite(Team(), World())
    some = sensors.team_suite(Team(), World(), {"down"}, events=False)
    memory, cut, seen, left = all_of_it.init(SEED), some.init(SEED), [], []
    for truth in track.truths():
        memory, _, readings = all_of_it.step(memory, truth)
        cut, _, fewer = some.step(cut, truth)
        seen += [
            replace(r, events=None, frames=tuple(f for f in r.frames if f.camera == 1))
            for r in readings
        ]
        left += fewer
    assert any(r.frames for r in left)
    assert bytes_of(left) == bytes_of(seen)


def test_the_last_step_delivers_the_events_up_to_it(track) -> None:
    suite = SENSORS.vehicle_suite(Team(), World(), 0)
    memory, end_us = suite.init(SEED), int(track.t_us[-1])
    for truth in track.truths():
        before, memory = memory, suite.step(memory, truth, last=truth.stamp_us == end_us)[0]
    assert before.rest.events.pixels.t_us < end_us - PLANT_STEP_US  # nothing had been due
    assert memory.rest.events.pixels.t_us == end_us


@pytest.mark.slow
def test_two_worker_processes_give_the_same_bytes(track, tmp_path) -> None:
    path = tmp_path / "track.npz"
    track.save(path)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        futures = [pool.submit(alone_from_file, path, i) for i in range(4)]
        there = [f.result() for f in futures]
    assert there == [alone(track, i) for i in range(4)]
    assert len(set(there)) == 4


def test_nothing_is_painted_when_nobody_looks(monkeypatch) -> None:
    def paint(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(config, "build_scene", paint)
    blind = replace(SENSORS, rig=RigParams(cameras=(), event_camera=None))
    assert blind.vehicle_suite(Team(), World(), 0).sensors.cameras is None
    assert len(blind.team_suite(Team(), World()).vehicles) == 4
    with pytest.raises(AssertionError):
        SENSORS.vehicle_suite(Team(), World(), 0)


def test_faults_hit_only_whom_they_name(track) -> None:
    suite = SENSORS.vehicle_suite(Team(), World(), 1)
    memory, samples = suite.init(SEED), []
    for truth in track.truths():
        memory, reading, _ = suite.step(memory, truth)
        samples += reading.imu.stamp_us.tolist()
    missing = {1_000 + 2_000 * k for k in range(600)} - set(samples)
    assert missing == {101_000 + 2_000 * k for k in range(50)}  # measured in [0.1, 0.2) s
    clean = replace(SENSORS, faults=())
    assert clean.vehicle_suite(Team(), World(), 0).sensors.script.faults == ()


def test_the_truth_beside_the_reading_is_the_labels_and_the_imus_bias(track) -> None:
    suite = SENSORS.vehicle_suite(Team(), World(), 0)
    memory = suite.init(SEED)
    start = memory.imu.bias[0]
    for truth in track.truths():
        memory, reading, beside = suite.step(memory, truth)
        assert (beside.labels is None) == (reading.events is None)
        if reading.events is not None:
            assert len(beside.labels.object_id) == len(reading.events.t_us)
    np.testing.assert_array_equal(beside.imu_bias, memory.imu.bias[0])
    assert np.any(beside.imu_bias != start)
