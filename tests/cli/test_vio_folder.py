# SPDX-License-Identifier: Apache-2.0
"""`skyhaul vio` on folders from outside: what only shows when they are opened or played."""

import json
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from simulated_tracks import Flight, simulate

from skyhaul.cli.main import main
from skyhaul.evaluation.dataset.euroc import EurocWriter
from skyhaul.evaluation.dataset.png import read_png
from skyhaul.evaluation.dataset.recorded import read_folder
from skyhaul.evaluation.trajectory_file import read_trajectory
from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.vio.imu import NO_SAMPLES
from skyhaul.sensors.api import (
    CameraCalibration,
    CameraFrame,
    ImuReading,
    RigCalibration,
    VehicleCalibration,
    VehicleReading,
)
from skyhaul.sensors.imu import Imu
from skyhaul.sensors.truth_api import SensorTruth

EPOCH = 1_500_000_000_000_000_000


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Two cameras that see grey noise, on a body that stands and then swings."""
    flown = simulate(Flight(duration_s=2.0, still_s=1.5, tracks=1))
    rig, imu = flown.recording.rig, flown.recording.imu
    mav = tmp_path_factory.mktemp("folder") / "mav0"
    (mav / "imu0").mkdir(parents=True)
    rows = [
        ",".join([str(EPOCH + 1000 * us), *(repr(float(v)) for v in (*w, *a))])
        for us, w, a in zip(imu.stamp_us.tolist(), imu.gyro_I, imu.accel_I, strict=True)
    ]
    (mav / "imu0" / "data.csv").write_text("#time\n" + "\n".join(rows) + "\n")
    wall = cv2.GaussianBlur(
        np.random.default_rng(0).integers(0, 256, (96, 128), dtype=np.uint8), (0, 0), 1.5
    )
    for c in range(2):
        (mav / f"cam{c}" / "data").mkdir(parents=True)
        names = []
        for k, ns in enumerate(flown.truth.time_ns.tolist()):
            noise = np.random.default_rng([c, k]).integers(0, 3, wall.shape, dtype=np.uint8)
            name = f"{EPOCH + ns}.png"
            cv2.imwrite(str(mav / f"cam{c}" / "data" / name), cv2.add(wall, noise))
            names.append(f"{EPOCH + ns},{name}")
        (mav / f"cam{c}" / "data.csv").write_text("\n".join(names))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rig.R_IC[0], rig.p_IC[0] - [0.0, 0.1 * c, 0.0]
        (mav / f"cam{c}" / "sensor.yaml").write_text(yaml.safe_dump(sensor(T)))
    return mav


def sensor(T):
    return {
        "T_BS": T.tolist(),
        "resolution": [128, 96],
        "intrinsics": [90.0, 90.0, 64.0, 48.0],
        "distortion_model": "radtan",
        "distortion_coefficients": [0.0, 0.0, 0.0, 0.0],
    }


@pytest.fixture
def mav(good, tmp_path):
    return Path(shutil.copytree(good, tmp_path / "mav0"))


def sixteen_bits(path):
    cv2.imwrite(str(path), cv2.imread(str(path), 0).astype(np.uint16) * 16)


def smaller(path):
    cv2.imwrite(str(path), np.zeros((48, 64), dtype=np.uint8))


def cut(path):
    path.write_bytes(path.read_bytes()[:500])


def damaged(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 255
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (sixteen_bits, "it has 16 bits"),
        (smaller, "it has 64 x 48 px"),
        (cut, "it is cut off"),
        (damaged, "its data are damaged (checksum)"),
    ],
)
def test_a_broken_image_ends_it_with_one_sentence_and_nothing_written(
    mav, tmp_path, capfd, spoil, message
):
    image = sorted((mav / "cam1" / "data").iterdir())[25]
    spoil(image)
    out = tmp_path / "out.txt"
    assert main(["vio", str(mav), "--kind", "ekf", "--json", "--out", str(out)]) == 1
    printed = capfd.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"skyhaul: {image}: is no image of 128 x 96 px: {message}")
    assert printed.err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["mav0"]


@pytest.mark.parametrize("kind", ["smoother", "ekf"])
def test_json_alone_is_on_stdout_and_nothing_on_stderr(mav, tmp_path, capfd, kind):
    out = tmp_path / "out.txt"
    assert main(["vio", str(mav), "--kind", kind, "--json", "--out", str(out)]) == 0
    printed = capfd.readouterr()
    assert json.loads(printed.out)["frames"] == 41
    assert printed.err == ""
    assert len(read_trajectory(out).time_ns) > 10


def test_two_cameras_that_see_the_same_from_one_place_are_refused(mav, capfd):
    tree = yaml.safe_load((mav / "cam0" / "sensor.yaml").read_text())
    T = np.array(tree["T_BS"])
    T[:3, :3] = T[:3, :3] @ so3_exp(np.array([0.0, 0.05, 0.0]))
    (mav / "cam1" / "sensor.yaml").write_text(yaml.safe_dump(sensor(T)))
    assert main(["vio", str(mav)]) == 1
    text = capfd.readouterr().err
    assert "cam0 and cam1 see the same and have the same place in T_BS" in text
    assert text.count("\n") == 1


def test_cameras_in_one_place_may_look_away_from_each_other(mav, capfd):
    tree = yaml.safe_load((mav / "cam0" / "sensor.yaml").read_text())
    T = np.array(tree["T_BS"])
    T[:3, :3] = T[:3, :3] @ so3_exp(np.array([0.0, 3.0, 0.0]))
    (mav / "cam1" / "sensor.yaml").write_text(yaml.safe_dump(sensor(T)))
    assert main(["vio", str(mav), "--kind", "ekf", "--json"]) == 0
    assert capfd.readouterr().err == ""


def recorded(mav, folder, ahead_us):
    """The same as `skyhaul record` writes it, by an IMU whose clock is ahead."""
    read = read_folder(mav)
    mounts = (
        CameraCalibration(
            f"camera {i}", c.known.model, c.known.T_IC[:3, 3], c.known.T_IC[:3, :3], 20.0
        )
        for i, c in enumerate(read.cameras)
    )
    imu = Imu(clock_offset_us=ahead_us).calibration()
    with EurocWriter(
        folder, VehicleCalibration(imu, RigCalibration(tuple(mounts), None), None), "x"
    ) as writer:
        stamp_us = (read.imu_ns - EPOCH) // 1000 + ahead_us
        writer.add_imu(ImuReading(stamp_us, read.gyro_I, read.accel_I))
        for k, ns in enumerate(read.cameras[0].time_ns.tolist()):
            t_us = (ns - EPOCH) // 1000
            frames = tuple(
                CameraFrame(t_us, i, read_png(c.files[k], c.known.model.size_px))
                for i, c in enumerate(read.cameras)
            )
            writer.add(
                VehicleReading(t_us, 0, NO_SAMPLES, frames, None, None),
                SensorTruth(None, np.zeros(6)),
            )
    return folder


@pytest.mark.parametrize("ahead_us", [20_000, -20_000])
@pytest.mark.parametrize("part", [".", "mav0"])
def test_a_recording_by_a_clock_that_is_off_gives_the_same_way(mav, tmp_path, ahead_us, part):
    ways = []
    for name, offset_us in (("right", 0), ("off", ahead_us)):
        folder, out = recorded(mav, tmp_path / name, offset_us), tmp_path / f"{name}.txt"
        assert main(["vio", str(folder / part), "--kind", "ekf", "--out", str(out)]) == 0
        ways.append(read_trajectory(out))
    np.testing.assert_array_equal(ways[0].time_ns, ways[1].time_ns)
    np.testing.assert_array_equal(ways[0].p, ways[1].p)


def test_a_time_shift_gives_the_same_way_by_the_cameras_clock(mav, tmp_path, capfd):
    assert main(["vio", str(mav), "--kind", "ekf", "--out", str(tmp_path / "a.txt")]) == 0
    file = mav / "imu0" / "data.csv"
    head, *lines = file.read_text().splitlines()
    rows = [line.partition(",") for line in lines]
    late = [f"{int(t) + 20_000_000},{values}" for t, _, values in rows]
    file.write_text("\n".join([head, *late]))
    for c in range(2):
        about = mav / f"cam{c}" / "sensor.yaml"
        about.write_text(about.read_text() + "timeshift_cam_imu: 0.02\n")
    assert main(["vio", str(mav), "--kind", "ekf", "--out", str(tmp_path / "b.txt")]) == 0
    assert capfd.readouterr().err == ""
    a, b = (read_trajectory(tmp_path / name) for name in ("a.txt", "b.txt"))
    np.testing.assert_array_equal(a.time_ns, b.time_ns)
    np.testing.assert_array_equal(a.p, b.p)
