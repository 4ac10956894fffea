# SPDX-License-Identifier: Apache-2.0
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from skyhaul.errors import FileError
from skyhaul.evaluation.columns import Layout
from skyhaul.evaluation.folder import read_config, read_metrics
from skyhaul.evaluation.mcap_log import read_log
from skyhaul.evaluation.metrics import evaluate
from skyhaul.evaluation.parquet_log import GrowingParquet
from skyhaul.evaluation.recorder import RunRecorder, _schema
from skyhaul.evaluation.series import load_run
from skyhaul.mission.api import Outcome, Phase
from skyhaul.plant.api import Contact
from skyhaul.world.load import load_config
from skyhaul.world.scenario import Scenario

Flight = Callable[..., Path]
UNITS = ("m", "mps", "mps2", "rad", "radps", "n", "nm", "j", "s", "us", "nd")


def test_every_column_ends_in_a_unit() -> None:
    names = Layout(3, (0, 4)).names
    assert len(names) == len(set(names))
    assert [name for name in names if name.rpartition("_")[2] not in UNITS] == []


def test_rows_come_at_100_hz_and_hold_the_truth(run_folder: Path) -> None:
    run = load_run(run_folder)
    np.testing.assert_array_equal(run.series["t"], 10_000 * np.arange(len(run.t_s)))
    assert run.t_s[-1] == 7.0
    team = run.scenario.team
    out = run.series["vehicle_p"] - run.series["load"][:, None, 0:3] - team.hooks_L()
    np.testing.assert_allclose(np.linalg.norm(out, axis=2), team.cable_length_m, atol=1e-12)
    np.testing.assert_allclose(
        run.series["cable_dir"][:, 0], np.broadcast_to(-out[0, 0], out[:, 0].shape), atol=1e-12
    )
    np.testing.assert_allclose(run.series["obstacle_p"][-1], [[2.1, 0.0, 2.7]], atol=1e-12)


def test_the_same_flight_gives_the_same_bytes(fly_into: Flight, tmp_path: Path) -> None:
    a, b = fly_into(tmp_path / "a"), fly_into(tmp_path / "b")
    assert (a / "states.parquet").read_bytes() == (b / "states.parquet").read_bytes()


def test_an_extreme_between_two_rows_is_kept(fly_into: Flight, tmp_path: Path) -> None:
    folder = fly_into(tmp_path / "r", touch_at_us=3_004_000, slack_at_us=4_006_000)
    run = load_run(folder)
    assert np.min(run.series["clearance_min"]) == -0.01
    assert np.nanmin(run.series["cable_tension_min"][:, 3]) == 0.0
    assert np.min(run.series["cable_tension"]) > 0.0
    assert run.series["slack"][-1] == pytest.approx(0.002)


def test_the_log_opens_with_the_decoder_of_ros_2(run_folder: Path) -> None:
    with (run_folder / "log.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        seen = Counter(c.topic for _, c, _, _ in reader.iter_decoded_messages())
        odometry = next(iter(reader.iter_decoded_messages(topics=["/payload/odometry"])))[3]
        plan = next(iter(reader.iter_decoded_messages(topics=["/control/plan"])))[3]
    assert seen["/payload/odometry"] == seen["/vehicle_3/odometry"] == 351
    assert seen["/tf"] == seen["/cables"] == 351
    assert seen["/team/markers"] == seen["/world/movers"] == 141
    assert seen["/control/solve"] == seen["/control/plan"] == 13
    assert seen["/mission/phase"] == 4
    assert seen["/mission/outcome"] == seen["/plan/reference"] == 1
    assert odometry.header.frame_id == "world"
    assert odometry.pose.pose.position.x == pytest.approx(1.53)
    assert (odometry.pose.pose.orientation.w, odometry.pose.pose.orientation.x) == (1.0, 0.0)
    np.testing.assert_array_equal(plan.gain, np.arange(5 * 4 * 36))


def test_odometry_has_its_velocity_in_the_frame_of_the_body() -> None:
    from skyhaul.evaluation.messages import odometry

    turned = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])  # a quarter turn to the left
    body = np.r_[np.zeros(3), turned, [0.0, 2.0, 0.5], np.zeros(3)]
    leaves = odometry(0, "x", body, np.zeros(36), np.zeros(36))
    np.testing.assert_allclose(leaves[4 + 8 : 4 + 11], [2.0, 0.0, 0.5], atol=1e-12)


def test_config_reads_back_equal_and_can_be_flown_again(run_folder: Path) -> None:
    scenario, origin = read_config(run_folder)
    assert origin.seed == 0
    assert origin.versions["numpy"] == np.__version__
    assert load_config(Scenario, str(run_folder / "config.yaml")) == scenario


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"\x00\xff\xfe", "is damaged: it is no YAML"),
        (b"team: [1, 2", "is damaged: it is no YAML"),
        (b"- 1\n- 2\n", "is damaged: it is no mapping"),
        (b"", "is damaged: it is no mapping"),
        (b"# origin: {}\nteam: {count: 40}\n", "count must lie in 1..8, got 40"),
        (b"# origin: {seed\nteam: {count: 4}\n", "its line '# origin:'"),
        (b"team: {count: 4}\n", "has no line '# origin:'"),
    ],
)
def test_a_damaged_configuration_is_told_in_one_sentence(
    tmp_path: Path, content: bytes, part: str
) -> None:
    (tmp_path / "config.yaml").write_bytes(content)
    with pytest.raises(FileError) as caught:
        read_config(tmp_path)
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\x00", b"[1]"])
def test_damaged_metrics_are_told_in_one_sentence(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "metrics.json").write_bytes(content)
    with pytest.raises(FileError, match=r"metrics\.json is damaged"):
        read_metrics(tmp_path)


def test_a_folder_in_use_is_refused(run_folder: Path) -> None:
    with pytest.raises(FileError, match="is not empty"):
        RunRecorder(run_folder, Scenario(), 0)


@pytest.mark.parametrize("rows", [[3], [250, 250, 7], [1] * 9])
def test_the_series_file_is_whole_after_every_row_group(tmp_path: Path, rows: list[int]) -> None:
    layout = Layout(2, ())
    path = tmp_path / "s.parquet"
    writer = GrowingParquet(path, _schema(layout))
    assert pq.read_table(path).num_rows == 0
    data = np.round(np.random.default_rng(1).normal(size=(sum(rows), len(layout.names))), 0)
    at = 0
    for count in rows:
        writer.append(data[at : at + count])
        at += count
        table = pq.read_table(path)
        assert table.num_rows == at
        np.testing.assert_array_equal(table.column("load_z_m").to_numpy(), data[:at, 9])
        np.testing.assert_array_equal(table.column("t_us").to_numpy(), data[:at, 0])
    writer.close()
    assert path.read_bytes().count(b"PAR1") == 2  # no old footer is left inside


@contextmanager
def file_limit(size: int) -> Iterator[None]:
    """Like a full disk: no file of this process may grow beyond a size [byte]."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_leaves_the_series_as_it_was(tmp_path: Path) -> None:
    layout = Layout(2, ())
    path = tmp_path / "s.parquet"
    writer = GrowingParquet(path, _schema(layout))
    data = np.random.default_rng(1).normal(size=(500, len(layout.names)))
    writer.append(data[:250])
    before = path.read_bytes()
    with file_limit(len(before) + 1000):
        for _ in range(2):
            with pytest.raises(FileError, match=r"s\.parquet cannot be written: .*large"):
                writer.append(data[250:])
            assert path.read_bytes() == before
    writer.append(data[250:])  # there is room again
    writer.close()
    table = pq.read_table(path)
    np.testing.assert_array_equal(table.column("load_z_m").to_numpy(), data[:, 9])


def test_a_flight_on_a_full_disk_can_be_read_and_says_so(
    made_up: ModuleType, tmp_path: Path
) -> None:
    s = made_up.scenario()
    recorder = RunRecorder(tmp_path / "r", s, 0)

    def fly() -> None:
        for k in range(4000):
            recorder.tick(made_up.tick_at(s, 10_000 * k, made_up.Faults()))

    with file_limit(300_000):
        with pytest.raises(FileError) as refused:
            fly()
        with pytest.raises(FileError):
            recorder.close(Outcome(False, f"broken off: {refused.value}", 0, {}, 1.0))
    run = load_run(tmp_path / "r")
    assert len(run.t_s) >= 250
    assert run.events.outcome is not None
    assert run.events.outcome.reason == f"broken off: {refused.value}"
    assert evaluate(tmp_path / "r")["mission_success"] is False


def test_a_log_without_its_end_or_without_anything_is_read_as_far_as_it_goes(
    run_folder: Path, tmp_path: Path
) -> None:
    whole = (run_folder / "log.mcap").read_bytes()
    path = tmp_path / "log.mcap"
    counts = []
    for size in np.linspace(60, len(whole), 40, dtype=int):  # the header is whole
        path.write_bytes(whole[:size])
        counts.append(len(list(read_log(path, {"/mission/phase"}))))
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, 4)
    path.write_bytes(b"")
    with pytest.raises(FileError, match="is not an MCAP file"):
        list(read_log(path, {"/mission/phase"}))


def test_only_a_run_without_a_step_can_be_withdrawn(made_up: ModuleType, tmp_path: Path) -> None:
    s = made_up.scenario()
    assert RunRecorder(tmp_path / "new", s, 0).withdraw()
    (tmp_path / "empty").mkdir()
    recorder = RunRecorder(tmp_path / "empty", s, 0)
    (tmp_path / "empty" / "mine.txt").write_text("keep")
    assert recorder.withdraw()
    assert [f.name for f in tmp_path.rglob("*")] == ["empty", "mine.txt"]
    recorder = RunRecorder(tmp_path / "flown", s, 0)
    recorder.tick(made_up.tick_at(s, 0, made_up.Faults()))
    assert not recorder.withdraw()
    recorder.close(Outcome(False, "", 0, {}, 1.0))
    assert len(load_run(tmp_path / "flown").t_s) == 1


KILLED = """
import importlib.util, os, pathlib, signal, sys
spec = importlib.util.spec_from_file_location("made_up", sys.argv[1])
made_up = importlib.util.module_from_spec(spec)
sys.modules["made_up"] = made_up
spec.loader.exec_module(made_up)
from skyhaul.evaluation.recorder import RunRecorder
s = made_up.scenario()
recorder = RunRecorder(pathlib.Path(sys.argv[2]), s, 0)
trigger = recorder.tick
def tick(t):
    trigger(t)
    if t.truth.stamp_us == 6_400_000:
        os.kill(os.getpid(), signal.SIGKILL)
recorder.tick = tick
made_up.fly(recorder, s)
"""


def test_a_killed_run_keeps_what_it_had(tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    source = str(Path(__file__).with_name("conftest.py"))
    command = [sys.executable, "-c", KILLED, source, str(folder)]
    result = subprocess.run(command, env=os.environ | {"OMP_NUM_THREADS": "1"}, check=False)
    assert result.returncode == -signal.SIGKILL
    assert pq.read_table(folder / "states.parquet").num_rows == 500
    run = load_run(folder)
    assert run.t_s[-1] == 4.99
    assert [x.t_s for x in run.events.solves] == [1.0 + 0.5 * k for k in range(10)]
    metrics = evaluate(folder)
    assert metrics["mission_success"] is False
    assert metrics["outcome"] == "interrupted: the run has no recorded end"
    assert metrics["tracking_rmse_m"] == pytest.approx(0.03)
    assert metrics["real_time_factor"] is None


def test_a_safe_hover_before_lift_off_is_not_airborne(made_up: ModuleType, tmp_path: Path) -> None:
    s = made_up.scenario()
    recorder = RunRecorder(tmp_path / "r", s, 0)
    phases = [Phase.LIFT, Phase.SAFE, Phase.LIFT, Phase.CARRY, Phase.SAFE]
    for k in range(500):
        tick = made_up.tick_at(s, 2_000 * k, made_up.Faults())
        recorder.tick(replace(tick, phase=phases[k // 100]))
    recorder.close(Outcome(False, "", 1_000_000, {}, 1.0))
    run = load_run(tmp_path / "r")
    np.testing.assert_array_equal(run.airborne, run.t_s >= 0.6)
    names = [name for name, _, _ in run.phase_spans]
    assert names == ["lift", "safe hover", "lift", "carry", "safe hover"]


def test_lift_off_is_when_the_load_leaves_the_floor(made_up: ModuleType, tmp_path: Path) -> None:
    """A contact in the lift counts once the load hangs, and not while it stands."""
    s = made_up.scenario()
    recorder = RunRecorder(tmp_path / "r", s, 0)
    contacts = (Contact(200_000, "vehicle 1", "ball"), Contact(800_000, "vehicle 2", "ball"))
    for k in range(500):
        tick = made_up.tick_at(s, 2_000 * k, made_up.Faults(contacts=contacts))
        load = tick.truth.team.p_WL.copy()
        load[2] += 0.1 * (k >= 300)
        truth = replace(tick.truth, team=replace(tick.truth.team, p_WL=load))
        recorder.tick(replace(tick, phase=Phase.LIFT, truth=truth))
    recorder.close(Outcome(False, "", 1_000_000, {}, 1.0))
    run = load_run(tmp_path / "r")
    np.testing.assert_array_equal(run.airborne, run.t_s >= 0.6)
    assert [c.airborne for c in run.events.contacts] == [False, True]


def test_leaving_the_recorder_by_an_exception_closes_it(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), RunRecorder(tmp_path / "r", Scenario(), 0):
        raise RuntimeError
    outcome = load_run(tmp_path / "r").events.outcome
    assert outcome is not None
    assert outcome.reason == "broken off by RuntimeError"
