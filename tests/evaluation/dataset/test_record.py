# SPDX-License-Identifier: Apache-2.0
"""Recording: parts are whole or not there, what is there is kept, bytes do not depend on who works.

The flight is replaced by a plant that hovers; everything after it is the real thing.
"""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import skyhaul.evaluation.dataset.record as module
from skyhaul.cli.main import main
from skyhaul.errors import FileError
from skyhaul.evaluation.dataset import euroc, layout
from skyhaul.evaluation.dataset.euroc import read_table
from skyhaul.evaluation.dataset.record import Recording, Show, record
from skyhaul.evaluation.dataset.recorded import read_folder
from skyhaul.evaluation.mcap_log import McapLog
from skyhaul.geometry.kernels import quat_exp, quat_mul
from skyhaul.geometry.quaternion import quat_rotate
from skyhaul.mission.api import Outcome, Phase
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import FlightProgress
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.sensors.config import SensorsConfig
from skyhaul.sensors.imu import Imu, without_errors
from skyhaul.sensors.load_cell import LoadCell
from skyhaul.sensors.optics import LensParams
from skyhaul.sensors.rig import CameraMount, EventCameraMount, RigParams
from skyhaul.world.load import load_config

STEPS = 120
pytestmark = pytest.mark.timeout(1200)  # the first run compiles the ray caster
BLIND = RigParams(cameras=(), event_camera=None)
FISHEYE = LensParams(kind="equidistant", size_px=(24, 16), fov_deg=140.0)
SMALL = RigParams(
    cameras=(
        CameraMount(
            name="front", lens=LensParams(size_px=(32, 24), fov_deg=80.0), p_BC_m=(0.05, 0.0, 0.0)
        ),
    ),
    event_camera=EventCameraMount(lens=FISHEYE),
)


class Folder:
    """Stands in for the recorder of a run: a folder with a log."""

    def __init__(self, folder: Path, config: RunConfig, seed: int) -> None:
        folder.mkdir(parents=True)
        self._log = McapLog(folder / "log.mcap")

    def tick(self, tick: SimpleNamespace) -> None:
        if tick.truth.stamp_us % 100_000 == 0:
            self._log.write("/mission/phase", "skyhaul_msgs/Phase", tick.truth.stamp_us, 0, 0,
                            "world", "hover", True)  # fmt: skip

    def close(self, outcome: Outcome) -> None:
        self._log.close()


@pytest.fixture
def flights(monkeypatch):
    """Replaces the flight; says how often one was flown, and can end it otherwise."""
    state = SimpleNamespace(count=0, reason="task done")

    def fly(config, seed, recorder, progress):
        state.count += 1
        plant = MujocoPlant(config, seed)
        rotors = plant.truth().rotor_thrust
        recorder.tick(SimpleNamespace(truth=plant.truth()))
        try:
            for k in range(STEPS):
                roll = np.array([1.0, 1.0, -1.0, -1.0])
                truth = plant.step(rotors * (1.0 + 0.1 * np.sin(0.1 * k) + 0.02 * roll))
                recorder.tick(SimpleNamespace(truth=truth))
                progress(FlightProgress(truth.stamp_us, 240_000, Phase.CARRY, 0.0, math.nan))
        finally:
            outcome = Outcome(True, state.reason, 0, {}, 0.0)
            recorder.close(outcome)
        return outcome

    monkeypatch.setattr(module, "fly", fly)
    monkeypatch.setattr(module, "RunRecorder", Folder)
    told = {"mission_success": True, "mission_time_s": 0.2}
    monkeypatch.setattr(module, "evaluate", lambda folder: told)
    return state


def recording(folder: Path, vehicles=(0, 1), workers=1, sensors=None, seed=3) -> Recording:
    config = load_config(RunConfig, "hover")
    sensors = sensors or SensorsConfig(rig=BLIND, load_cell=LoadCell())
    return Recording(replace(config, sensors=sensors), seed, folder, vehicles, workers)


def quiet() -> Show:
    return Show(None, lambda share: None, lambda line: None)


def files_of(folder: Path) -> dict[str, bytes]:
    """Every file below a folder but the flight's and the log, which holds no time of day either."""
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


def test_a_recording_holds_every_body_and_no_part_of_anything(flights, tmp_path) -> None:
    record(recording(tmp_path / "set"), quiet())
    names = sorted(p.name for p in (tmp_path / "set").iterdir())
    assert names == ["flight", "log.mcap", "payload", "record.json", "vehicle_0", "vehicle_1"]
    assert not list((tmp_path / "set").rglob("*.part"))
    stamps, _ = read_table(tmp_path / "set" / "vehicle_1" / "mav0" / "imu0" / "data.csv")
    assert len(stamps) == STEPS
    stamps, _ = read_table(tmp_path / "set" / "payload" / "mav0" / "imu0" / "data.csv")
    assert len(stamps) == STEPS // 5
    assert json.loads((tmp_path / "set" / "record.json").read_text())["log"] == [
        "payload", "vehicle_0", "vehicle_1",
    ]  # fmt: skip


def test_exact_imu_tables_lead_along_the_ground_truth(flights, tmp_path) -> None:
    sensors = SensorsConfig(rig=BLIND, imu=without_errors(Imu(rotation_deg=(10.0, 20.0, 30.0))))
    record(recording(tmp_path / "set", (2,), sensors=sensors), quiet())
    mav = tmp_path / "set" / "vehicle_2" / "mav0"
    _, samples = read_table(mav / "imu0" / "data.csv")
    _, truth = read_table(mav / "state_groundtruth_estimate0" / "data.csv")
    p, q, v = truth[0, :3], truth[0, 3:7], truth[0, 7:10]
    for w, f in zip(samples[:, :3], samples[:, 3:], strict=True):
        middle = np.array(quat_mul(tuple(q), quat_exp(0.001 * w)))
        a = quat_rotate(middle, f) - np.array([0.0, 0.0, 9.81])
        p, v = p + 0.002 * v + 2e-6 * a, v + 0.002 * a
        q = np.array(quat_mul(tuple(q), quat_exp(0.002 * w)))
    assert np.linalg.norm(truth[-1, 7:10]) > 0.01
    assert np.linalg.norm(samples[-1, :3]) > 0.1
    np.testing.assert_allclose(p, truth[-1, :3], rtol=0.0, atol=3e-6)
    np.testing.assert_allclose(v, truth[-1, 7:10], rtol=0.0, atol=1e-10)
    assert abs(q @ truth[-1, 3:7]) == pytest.approx(1.0, abs=1e-12)
    assert np.all(truth[:, 10:] == 0.0)


@pytest.mark.parametrize("ahead_us", [5_000, -5_000])
def test_a_clock_that_is_off_is_read_back_as_one_that_is_not(flights, tmp_path, ahead_us) -> None:
    for name, offset_us in (("off", ahead_us), ("right", 0)):
        sensors = SensorsConfig(imu=Imu(clock_offset_us=offset_us), rig=SMALL)
        record(recording(tmp_path / name, vehicles=(0,), sensors=sensors), quiet())
    off, right = (read_folder(tmp_path / name / "vehicle_0") for name in ("off", "right"))
    np.testing.assert_array_equal(off.imu_ns, right.imu_ns)
    np.testing.assert_array_equal(off.gyro_I, right.gyro_I)
    np.testing.assert_array_equal(off.accel_I, right.accel_I)
    np.testing.assert_array_equal(off.cameras[0].time_ns, right.cameras[0].time_ns)


def test_the_same_seed_gives_the_same_bytes_in_any_order(flights, tmp_path) -> None:
    seeing = SensorsConfig(rig=SMALL)
    record(recording(tmp_path / "a", sensors=seeing), quiet())
    record(recording(tmp_path / "b", (1,), sensors=seeing), quiet())
    record(recording(tmp_path / "b", sensors=seeing), quiet())
    a, b = files_of(tmp_path / "a"), files_of(tmp_path / "b")
    assert a.keys() == b.keys()
    assert [name for name in a if a[name] != b[name]] == []
    assert sum(name.endswith(".png") for name in a) == 6
    assert a["vehicle_0/events.txt"].count(b"\n") > 9
    record(recording(tmp_path / "c", (0,), sensors=seeing, seed=4), quiet())
    assert files_of(tmp_path / "c" / "vehicle_0") != files_of(tmp_path / "a" / "vehicle_0")


@pytest.mark.slow
def test_two_worker_processes_give_the_same_bytes(flights, tmp_path) -> None:
    seeing = SensorsConfig(rig=SMALL)
    record(recording(tmp_path / "a", sensors=seeing), quiet())
    record(recording(tmp_path / "b", workers=2, sensors=seeing), quiet())
    a, b = files_of(tmp_path / "a"), files_of(tmp_path / "b")
    assert a.keys() == b.keys()
    assert [name for name in a if a[name] != b[name]] == []


def test_an_interrupted_recording_goes_on_where_it_stopped(flights, tmp_path, monkeypatch) -> None:
    folder, said = tmp_path / "set", []

    def interrupt(share: float) -> None:
        if share > 0.4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(recording(folder), Show(None, interrupt, said.append))
    assert (folder / "vehicle_0").is_dir()
    names = sorted(p.name for p in folder.iterdir())
    assert names == ["flight", "record.json", "vehicle_0"]
    kept = (folder / "vehicle_0" / "mav0" / "imu0" / "data.csv").stat().st_mtime_ns
    record(recording(folder), Show(None, lambda share: None, said.append))
    assert flights.count == 1
    assert "vehicle_0 is there already" in said
    assert (folder / "vehicle_0" / "mav0" / "imu0" / "data.csv").stat().st_mtime_ns == kept
    record(recording(tmp_path / "whole"), quiet())
    assert files_of(folder) == files_of(tmp_path / "whole")


def test_an_interrupted_flight_leaves_nothing_that_looks_whole(flights, tmp_path) -> None:
    flights.reason = "interrupted"
    with pytest.raises(KeyboardInterrupt):
        record(recording(tmp_path / "set"), quiet())
    assert [p.name for p in (tmp_path / "set").iterdir()] == ["record.json"]
    flights.reason = "task done"
    record(recording(tmp_path / "set"), quiet())
    assert (tmp_path / "set" / "log.mcap").is_file()


def test_a_folder_of_something_else_is_refused(flights, tmp_path) -> None:
    record(recording(tmp_path / "set", ()), quiet())
    with pytest.raises(FileError, match=r"another scenario, seed or settings \(hover, seed 3\)"):
        record(recording(tmp_path / "set", seed=9), quiet())
    with pytest.raises(FileError, match="another scenario, seed or settings"):
        record(
            recording(tmp_path / "set", sensors=SensorsConfig(rig=BLIND, imu=Imu(rate_hz=100))),
            quiet(),
        )
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("")
    with pytest.raises(FileError, match="is not empty; give a new or an empty folder"):
        record(recording(tmp_path / "full"), quiet())
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="is a file; give a folder"):
        record(recording(tmp_path / "file"), quiet())
    (tmp_path / "set" / "record.json").write_text("[")
    with pytest.raises(FileError, match="is damaged"):
        record(recording(tmp_path / "set"), quiet())


def test_two_recordings_never_share_a_folder(flights, tmp_path) -> None:
    with layout.locked(tmp_path / "set"):
        with pytest.raises(FileError, match="another recording works in it; wait for it or give"):
            record(recording(tmp_path / "set"), quiet())
        assert list((tmp_path / "set").iterdir()) == []
    assert flights.count == 0
    record(recording(tmp_path / "set"), quiet())
    assert (tmp_path / "set" / "payload" / "tag.yaml").read_text().count("tag25h9") == 1


def test_a_recording_goes_on_with_the_version_that_began_it(flights, tmp_path) -> None:
    record(recording(tmp_path / "set", ()), quiet())
    path = tmp_path / "set" / "record.json"
    begun = json.loads(path.read_text())
    path.write_text(json.dumps(begun | {"commit": "unknown"}))
    record(recording(tmp_path / "set", ()), quiet())
    for key in ("version", "commit"):
        path.write_text(json.dumps(begun | {key: "0.0-other"}))
        with pytest.raises(FileError, match=r"was begun by skyhaul .*0\.0-other"):
            record(recording(tmp_path / "set", ()), quiet())


def test_a_disk_that_refuses_is_one_sentence(flights, tmp_path, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "/somewhere/data.csv")

    monkeypatch.setattr(euroc, "_row", full)
    with pytest.raises(FileError, match=r"data.csv cannot be written: No space left on device$"):
        record(recording(tmp_path / "set"), quiet())


def test_the_command_records_and_says_where(flights, tmp_path, capsys) -> None:
    argv = ["record", "hover", "--dataset", "euroc", "--out", str(tmp_path / "set")]
    blind = ["--set", "sensors.rig.cameras=[]", "sensors.rig.event_camera=null"]
    assert main([*argv, "--vehicles", "2,0", *blind]) == 0
    assert "mission done" in capsys.readouterr().out
    assert {p.name for p in (tmp_path / "set").iterdir()} >= {"vehicle_0", "vehicle_2", "payload"}


def test_an_interrupt_while_the_logs_are_joined_leaves_no_half_log(
    flights, tmp_path, monkeypatch
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("skyhaul.evaluation.dataset.sensor_log._streams", stop)
    with pytest.raises(KeyboardInterrupt):
        record(recording(tmp_path / "set", vehicles=(0,)), quiet())
    names = sorted(p.name for p in (tmp_path / "set").iterdir())
    assert names == ["flight", "payload", "record.json", "vehicle_0"]


def test_an_interrupted_command_says_what_is_kept(flights, tmp_path, capsys) -> None:
    flights.reason = "interrupted"
    folder = tmp_path / "set"
    assert main(["record", "hover", "--dataset", "euroc", "--out", str(folder)]) == 130
    said = f"interrupted; what is whole is kept in {folder}; the same command goes on from there"
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--dataset", "kitti"], "--dataset kitti: unknown; allowed: euroc"),
        (["--dataset", "euroc", "--vehicles", "7"], "there is no vehicle 7; allowed: 0 to 3"),
        (["--dataset", "euroc", "--vehicles", "x"], "write numbers with commas, as in 0,2"),
        (["--dataset", "euroc", "--set", "sensors.imu.rate_hz=7"], "rate_hz must divide 500"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_1(words, sentence, tmp_path, capsys) -> None:
    assert main(["record", "hover", "--out", str(tmp_path / "set"), *words]) == 1
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("option", "value", "sentence"),
    [
        ("--workers", "0", "the number of processes is a whole number, 1 or more, got '0'"),
        ("--workers", "two", "the number of processes is a whole number, 1 or more, got 'two'"),
        ("--seed", "-1", "a seed is a whole number, 0 or more, got '-1'"),
        ("--seed", "x", "a seed is a whole number, 0 or more, got 'x'"),
    ],
)
def test_a_wrong_number_is_wrong_usage(option, value, sentence, tmp_path, capsys) -> None:
    argv = ["record", "hover", "--dataset", "euroc", "--out", str(tmp_path), option, value]
    with pytest.raises(SystemExit) as error:
        main(argv)
    assert error.value.code == 2
    assert sentence in capsys.readouterr().err


def test_a_terminal_that_goes_away_is_not_called_a_fault_of_the_disk(flights, tmp_path) -> None:
    def gone(now: object) -> None:
        raise BrokenPipeError(32, "Broken pipe")

    with pytest.raises(BrokenPipeError):
        record(recording(tmp_path / "set", ()), replace(quiet(), flight=gone))
    assert not (tmp_path / "set" / "flight").exists()
    record(recording(tmp_path / "set", ()), quiet())
    assert (tmp_path / "set" / "flight").is_dir()
