# SPDX-License-Identifier: Apache-2.0
"""`skyhaul vio` on a feature-track file."""

import csv
import io
import json
import os
import sys
from pathlib import Path

import gtsam
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from simulated_tracks import FOCAL_PX, Flight, simulate

from skyhaul.cli.main import main
from skyhaul.cli.recording_bar import RecordingBar
from skyhaul.cli.vio_source import open_source
from skyhaul.errors import FileError
from skyhaul.evaluation.trajectory_file import read_trajectory, write_tum
from skyhaul.geometry.quaternion import R_to_quat
from skyhaul.perception.vio.ekf import EkfEstimator

DATA = Path(os.environ.get("SKYHAUL_DATA", Path(__file__).parents[3] / "shared" / "data"))
CLIP = Path(gtsam.findExampleDataFile("eqvio_processed_30s.csv"))
COLUMNS = [
    *("row_type", "t_abs", "t_rel", "seq", "frame_idx", "landmark_id"),
    *("gx", "gy", "gz", "ax", "ay", "az", "bgx", "bgy", "bgz", "bax", "bay", "baz"),
    *("u_norm", "v_norm", "key", "value"),
]


def write_tracks(file, flown, drop=()):
    """A recording as a feature-track file; times begin at 100 s."""
    rig = flown.recording.rig
    numbers = [*rig.p_IC[0], *R_to_quat(rig.R_IC[0]), FOCAL_PX]
    names = (
        "T_ci_tx",
        "T_ci_ty",
        "T_ci_tz",
        "T_ci_qw",
        "T_ci_qx",
        "T_ci_qy",
        "T_ci_qz",
        "camera_fx",
    )
    with file.open("w", newline="") as out:
        rows = csv.DictWriter(out, COLUMNS)
        rows.writeheader()
        for key, value in zip(names, numbers, strict=True):
            rows.writerow({"row_type": "meta", "key": key, "value": repr(float(value))})
        imu = flown.recording.imu
        for t, w, a in zip(imu.stamp_us.tolist(), imu.gyro_I, imu.accel_I, strict=True):
            values = dict(zip(("gx", "gy", "gz", "ax", "ay", "az"), [*w, *a], strict=True))
            rows.writerow({"row_type": "imu", "t_abs": stamp(t), **values})
        for frame in flown.recording.frames():
            for i, xy in zip(frame.track_id, frame.xy, strict=True):
                at = {"landmark_id": i, "u_norm": xy[0], "v_norm": xy[1]}
                rows.writerow({"row_type": "vision_feature", "t_abs": stamp(frame.stamp_us), **at})
    return file


def stamp(t_us):
    return f"{100 + t_us // 1_000_000}.{t_us % 1_000_000:06d}"


@pytest.fixture(scope="module")
def flown():
    return simulate(Flight(duration_s=4.5, still_s=1.5, pace=1.5))


@pytest.fixture(scope="module")
def folder(tmp_path_factory, flown):
    folder = tmp_path_factory.mktemp("vio")
    write_tracks(folder / "tracks.csv", flown)
    t = flown.truth
    write_tum(folder / "truth.txt", type(t)(t.time_ns + 100 * 10**9, t.p, t.q))
    return folder


def test_a_track_file_gives_back_what_was_written(folder, flown):
    back = open_source(folder / "tracks.csv", 0.7).recording
    np.testing.assert_array_equal(back.imu.stamp_us, flown.recording.imu.stamp_us)
    np.testing.assert_array_equal(back.imu.accel_I, flown.recording.imu.accel_I)
    np.testing.assert_allclose(back.rig.R_IC, flown.recording.rig.R_IC, atol=1e-12)
    assert back.epoch_ns == 100 * 10**9
    assert back.sigma == pytest.approx(0.7 / FOCAL_PX)
    for a, b in zip(back.frames(), flown.recording.frames(), strict=True):
        assert a.stamp_us == b.stamp_us
        np.testing.assert_array_equal(a.track_id, b.track_id)
        np.testing.assert_array_equal(a.xy, b.xy)


def test_readings_bring_every_sample_once_and_one_behind_each_frame(folder):
    recording = open_source(folder / "tracks.csv", 0.7).recording
    stamps = [imu.stamp_us for imu, _ in recording.readings()]
    np.testing.assert_array_equal(
        np.concatenate(stamps), recording.imu.stamp_us[: sum(map(len, stamps))]
    )
    for got, frame in zip(stamps, recording.frames(), strict=True):
        assert got[-1] >= frame.stamp_us or frame.stamp_us > recording.imu.stamp_us[-1]


@pytest.mark.parametrize("kind", ["smoother", "ekf"])
def test_json_has_the_errors_and_how_they_were_taken(folder, capsys, kind):
    out = folder / f"{kind}.txt"
    code = main(
        [
            *("vio", str(folder / "tracks.csv"), "--truth", str(folder / "truth.txt"), "--json"),
            *("--kind", kind, "--out", str(out)),
        ]
    )
    figures = json.loads(capsys.readouterr().out)
    assert code == 0
    assert figures["ate_m"] < 0.05
    assert figures["rpe_m"] < 0.05
    assert figures["alignment"] == "se3"
    assert figures["kind"] == kind
    assert figures["matched"] == len(read_trajectory(out).time_ns) > 40
    assert figures["real_time_factor"] > 0.0
    assert read_trajectory(out).time_ns[0] >= 100 * 10**9


def test_without_truth_the_errors_are_null_and_the_table_says_so(folder, capsys):
    quick = ["vio", str(folder / "tracks.csv"), "--kind", "ekf"]
    assert main([*quick, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ate_m"] is None
    assert main(quick) == 0
    assert "give --truth FILE" in capsys.readouterr().out


def test_the_table_names_alignment_and_pairs(folder, capsys):
    truth = ["--truth", str(folder / "truth.txt"), "--align", "sim3", "--kind", "ekf"]
    assert main(["vio", str(folder / "tracks.csv"), *truth]) == 0
    text = capsys.readouterr().out
    assert "sim3 alignment" in text
    assert "pairs" in text


def test_loops_need_images_not_tracks_alone(folder, capsys):
    assert main(["vio", str(folder / "tracks.csv"), "--loops"]) == 1
    text = capsys.readouterr().err
    assert "loops are closed by images" in text
    assert text.count("\n") == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "does not exist"),
        (b"", "holds no line of data"),
        (b"\x00\x01\x02\xff\xfe", "is no"),
        (b"time,x,y\n1,2,3\n", "column row_type is missing"),
        ((",".join(COLUMNS) + "\n").encode(), "holds no row of kind imu"),
        (
            (",".join(COLUMNS) + "\nlidar,1" + "," * 20 + "\n").encode(),
            "row_type 'lidar' is unknown",
        ),
        ((",".join(COLUMNS) + "\nimu,abc" + "," * 20 + "\n").encode(), "vision_feature"),
    ],
)
def test_a_wrong_file_is_one_sentence_and_exit_1(tmp_path, capsys, content, message):
    file = tmp_path / "x.csv"
    if content is not None:
        file.write_bytes(content)
    assert main(["vio", str(file)]) == 1
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1


def cell(kind, column, value, row=5):
    """Change one cell of the given row of a kind."""

    def change(rows):
        [r for r in rows if r["row_type"] == kind][row][column] = value
        return rows

    return change


def meta(key, value):
    """Change the value of a meta row."""

    def change(rows):
        for r in rows:
            r["value"] = value if r["key"] == key else r["value"]
        return rows

    return change


def scaled(factor, *columns):
    """Give some columns of the IMU in another unit."""

    def change(rows):
        for r in rows:
            for c in columns if r["row_type"] == "imu" else ():
                r[c] = repr(factor * float(r[c]))
        return rows

    return change


def swapped_axes(rows):
    """Forces where rates belong and the other way round."""
    g, a = ("gx", "gy", "gz"), ("ax", "ay", "az")
    return [r | {k: r[v] for k, v in zip((*g, *a), (*a, *g), strict=True)} for r in rows]


def without_imu(first, last):
    """Leave some rows of the IMU out."""

    def change(rows):
        imu = [r for r in rows if r["row_type"] == "imu"]
        return [r for r in rows if r["row_type"] != "imu"] + imu[:first] + imu[last:]

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (cell("imu", "gx", "nan"), "(imu): gx is 'nan', not finite"),
        (cell("imu", "gx", ""), "(imu): gx is '', no number"),
        (cell("imu", "az", "1e160", 600), "(imu): az is 1e+160, at most 4000 is possible"),
        (cell("imu", "t_abs", "100.0", 9), "comes -40000000 ns after that of line"),
        (cell("imu", "t_abs", "1403715273262142976"), "give seconds, not nanoseconds"),
        (cell("imu", "t_abs", "soon"), "t_abs 'soon' is no time in seconds"),
        (cell("vision_feature", "t_abs", "100.0", 99), "comes after one at"),
        (cell("vision_feature", "u_norm", "320.5"), "u_norm is 320.5, at most 20 is possible"),
        (cell("vision_feature", "v_norm", "inf"), "v_norm is 'inf', not finite"),
        (cell("vision_feature", "landmark_id", "1.5"), "landmark_id '1.5' is no whole number"),
        (cell("vision_feature", "landmark_id", "-1"), "landmark_id '-1' is no whole number"),
        (lambda rows: [*rows, rows[-1]], "stands twice at t_abs"),
        (meta("T_ci_qw", "0.1"), "must be a unit quaternion"),
        (meta("T_ci_tx", "1e160"), "(meta): T_ci_tx is 1e+160, at most 100 is possible"),
        (meta("T_ci_qx", "x"), "(meta): T_ci_qx is 'x', no number"),
        (meta("camera_fx", "0.8"), "camera_fx 10 px at least"),
        (meta("camera_fx", "-400"), "camera_fx 10 px at least"),
        (
            lambda rows: [*rows, rows[0] | {"key": "measurement_space", "value": "pixel"}],
            "measurement_space 'pixel' is unknown",
        ),
        (lambda rows: rows[1:], "T_ci_tx is missing"),
        (swapped_axes, "columns of gyroscope and accelerometer are swapped"),
        (scaled(1.0 / 9.81, "ax", "ay", "az"), "give specific force in m/s^2"),
        (scaled(57.3, "gx", "gy", "gz"), "give angular rates in rad/s"),
        (without_imu(400, 10**9), "leave out frames without IMU"),
    ],
)
def test_a_wrong_row_is_one_sentence_before_anything_is_played(
    folder, tmp_path, capfd, change, message
):
    with (folder / "tracks.csv").open(newline="") as file:
        rows = change(list(csv.DictReader(file)))
    wrong, out = tmp_path / "wrong.csv", tmp_path / "out.txt"
    with wrong.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    assert main(["vio", str(wrong), "--json", "--kind", "ekf", "--out", str(out)]) == 1
    printed = capfd.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"skyhaul: {wrong}: ")
    assert message in printed.err
    assert printed.err.count("\n") == 1
    assert [f.name for f in tmp_path.iterdir()] == ["wrong.csv"]


def test_an_imu_at_10_hz_is_refused(folder, tmp_path, capsys):
    lines = (folder / "tracks.csv").read_text().splitlines()
    imu = [line for line in lines if line.startswith("imu,")]
    rest = [line for line in lines if not line.startswith("imu,")]
    (tmp_path / "slow.csv").write_text("\n".join([*rest, *imu[::20]]))
    assert main(["vio", str(tmp_path / "slow.csv")]) == 1
    assert "IMU: 10 samples a second, 50 to 2000 are allowed" in capsys.readouterr().err


def test_a_file_that_is_cut_off_says_where(folder, tmp_path, capsys):
    (tmp_path / "cut.csv").write_bytes((folder / "tracks.csv").read_bytes()[:-20])
    assert main(["vio", str(tmp_path / "cut.csv")]) == 1
    assert "the file may be cut off" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "message"),
    [("/dev/null", "is no file"), ("x" * 300, "cannot be read: File name too long")],
)
def test_what_is_neither_file_nor_folder_is_refused(capsys, name, message):
    assert main(["vio", name]) == 1
    assert message in capsys.readouterr().err


def test_a_truth_of_another_time_is_refused_before_anything_is_played(
    folder, capsys, tmp_path, flown, monkeypatch
):
    monkeypatch.setattr("skyhaul.cli.vio.play", None)
    write_tum(tmp_path / "late.txt", flown.truth)
    code = main(["vio", str(folder / "tracks.csv"), "--truth", str(tmp_path / "late.txt")])
    assert code == 1
    text = capsys.readouterr().err
    assert "in 0 frames, 3 at least are needed: it goes from 0.000 to" in text
    assert "the recording from 100.000 to" in text


def test_a_truth_with_quaternions_in_another_order_is_told(folder, capsys, tmp_path):
    head, *rows = (folder / "truth.txt").read_text().splitlines()
    cells = [row.split() for row in rows]
    turned = [" ".join([*c[:4], c[7], *c[4:7]]) for c in cells]
    (tmp_path / "wxyz.txt").write_text("\n".join([head, *turned]))
    quick = ["vio", str(folder / "tracks.csv"), "--kind", "ekf", "--truth"]
    assert main([*quick, str(tmp_path / "wxyz.txt")]) == 1
    assert "only if they are in the order w x y z" in capsys.readouterr().err


def test_too_short_a_truth_gives_no_rpe_and_the_table_says_so(folder, capsys, tmp_path):
    lines = (folder / "truth.txt").read_text().splitlines()
    (tmp_path / "short.txt").write_text("\n".join(lines[60:64]))
    truth = ["--truth", str(tmp_path / "short.txt"), "--kind", "ekf"]
    assert main(["vio", str(folder / "tracks.csv"), *truth, "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert (figures["matched"], figures["rpe_pairs"], figures["rpe_m"]) == (4, 0, None)
    assert main(["vio", str(folder / "tracks.csv"), *truth]) == 0
    assert "not known: no motion over 1.0 s has a truth" in capsys.readouterr().out


def test_scale_is_aligned_only_on_demand(folder, capsys, tmp_path, flown):
    t = flown.truth
    write_tum(tmp_path / "twice.txt", type(t)(t.time_ns + 100 * 10**9, 2.0 * t.p, t.q))
    found = []
    for align in ((), ("--align", "sim3")):
        truth = ["--truth", str(tmp_path / "twice.txt"), "--kind", "ekf", "--json", *align]
        assert main(["vio", str(folder / "tracks.csv"), *truth]) == 0
        found.append(json.loads(capsys.readouterr().out))
    plain, scaled_too = found
    assert (plain["alignment"], plain["scale"]) == ("se3", 1.0)
    assert plain["ate_m"] > 0.1
    assert scaled_too["scale"] == pytest.approx(2.0, rel=0.05)
    assert scaled_too["ate_m"] < 0.05


def test_a_file_that_is_there_stays_as_it_is(folder, capsys, tmp_path):
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    assert main(["vio", str(folder / "tracks.csv"), "--out", str(mine)]) == 1
    assert "is there already" in capsys.readouterr().err
    assert mine.read_text() == "mine"


def test_ctrl_c_leaves_nothing_and_says_so(folder, capsys, tmp_path, monkeypatch):
    step, count = EkfEstimator.step, []

    def interrupted(*args):
        count.append(1)
        if len(count) == 40:
            raise KeyboardInterrupt
        return step(*args)

    monkeypatch.setattr(EkfEstimator, "step", interrupted)
    out = ["--out", str(tmp_path / "out.txt"), "--kind", "ekf", "--json"]
    assert main(["vio", str(folder / "tracks.csv"), *out]) == 130
    assert capsys.readouterr() == ("", "skyhaul: interrupted\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("sigma", ["abc", "nan", "0", "-1", "1e160"])
def test_an_impossible_sigma_is_wrong_usage(folder, capsys, sigma):
    with pytest.raises(SystemExit) as left:
        main(["vio", str(folder / "tracks.csv"), f"--sigma-px={sigma}"])
    assert left.value.code == 2
    assert "a number from 0.01 to 100 [px]" in capsys.readouterr().err


class Terminal(io.StringIO):
    """Takes what a terminal would show."""

    def isatty(self):
        return True


def test_the_bar_shows_time_speed_and_status_on_a_terminal_and_nothing_elsewhere(monkeypatch):
    monkeypatch.setattr("skyhaul.cli.recording_bar.EVERY_S", 0.0)
    monkeypatch.setenv("TERM", "xterm")
    for file, shown in ((Terminal(), True), (io.StringIO(), False)):
        with RecordingBar("ekf: [bold]tracks.csv", 4.5, file) as bar:
            bar.begin()
            bar.update(1.25, "tracking")
        assert ("1.2 of 4.5 s" in file.getvalue()) is shown
        assert ("ekf: [bold]tracks.csv" in file.getvalue()) is shown
        assert ("tracking" in file.getvalue()) is shown


def test_an_imu_in_g_is_refused(folder, capsys, tmp_path, flown):
    from dataclasses import replace

    imu = flown.recording.imu
    wrong = replace(imu, accel_I=imu.accel_I / 9.81)
    recording = replace(flown.recording, imu=wrong)
    file = write_tracks(tmp_path / "g.csv", replace(flown, recording=recording))
    assert main(["vio", str(file)]) == 1
    assert "give specific force in m/s^2" in capsys.readouterr().err


def test_a_recording_that_never_shows_its_state_says_what_it_needs(capsys, tmp_path):
    short = simulate(Flight(duration_s=0.8, still_s=5.0))
    file = write_tracks(tmp_path / "short.csv", short)
    assert main(["vio", str(file)]) == 1
    assert "no state was found in 0.8 s" in capsys.readouterr().err


def test_extrinsics_must_be_there(folder, tmp_path):
    lines = (folder / "tracks.csv").read_text().splitlines()
    (tmp_path / "x.csv").write_text("\n".join(line for line in lines if "T_ci_tx" not in line))
    with pytest.raises(FileError, match="needs meta rows T_ci_tx"):
        open_source(tmp_path / "x.csv", 1.0)


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "euroc").is_dir(), reason=f"no recordings in {DATA}")
@pytest.mark.parametrize(("kind", "ate_m"), [("smoother", 0.05), ("ekf", 0.08)])
def test_a_real_clip_is_followed_within_centimetres(capsys, kind, ate_m):
    truth = DATA / "euroc" / "V1_01_easy_truth.csv"
    assert main(["vio", str(CLIP), "--truth", str(truth), "--json", "--kind", kind]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["ate_m"] <= ate_m
    assert figures["matched"] > 550
    assert figures["frames_lost"] == 0
    assert figures["real_time_factor"] > 1.0
