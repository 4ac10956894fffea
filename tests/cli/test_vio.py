# SPDX-License-Identifier: Apache-2.0
"""`skyhaul vio` on a feature-track file."""

import csv
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
from skyhaul.errors import FileError
from skyhaul.evaluation.trajectory_file import read_trajectory, write_tum
from skyhaul.geometry.quaternion import R_to_quat
from skyhaul.perception.vio.track_file import read_track_file

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
    back = read_track_file(folder / "tracks.csv", 0.7)
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
    recording = read_track_file(folder / "tracks.csv", 0.7)
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


def test_a_truth_of_another_time_is_refused(folder, capsys, tmp_path, flown):
    write_tum(tmp_path / "late.txt", flown.truth)
    code = main(["vio", str(folder / "tracks.csv"), "--truth", str(tmp_path / "late.txt")])
    assert code == 1
    assert "overlaps" in capsys.readouterr().err


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
        read_track_file(tmp_path / "x.csv", 1.0)


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
