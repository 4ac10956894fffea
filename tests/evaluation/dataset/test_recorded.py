# SPDX-License-Identifier: Apache-2.0
"""EuRoC folders from outside: each fault is one sentence with file, line and key."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from skyhaul.errors import FileError
from skyhaul.evaluation.dataset.calibration import T_IC
from skyhaul.evaluation.dataset.euroc import EurocWriter
from skyhaul.evaluation.dataset.png import read_png
from skyhaul.evaluation.dataset.recorded import read_folder
from skyhaul.geometry.camera import Equidistant, RadTan
from skyhaul.geometry.so3 import so3_exp

EPOCH, N = 1_500_000_000_000_000_000, 200
IMU, CSV, YAML = "imu0/data.csv", "cam0/data.csv", "cam0/sensor.yaml"
R_IC = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def pose(y=0.0, turn=0.0):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R_IC @ so3_exp(np.array([0.0, turn, 0.0])), [0.1, y, 0.0]
    return T


def sensor(T):
    return {
        "T_BS": {"rows": 4, "cols": 4, "data": T.ravel().tolist()},
        "resolution": [64, 48],
        "intrinsics": [50.0, 51.0, 32.0, 24.0],
        "distortion_model": "radial-tangential",
        "distortion_coefficients": [-0.1, 0.01, 0.0, 0.0],
    }


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A second of two cameras and an IMU that stands."""
    mav = tmp_path_factory.mktemp("recorded") / "mav0"
    (mav / "imu0").mkdir(parents=True)
    rows = [f"{EPOCH + 5_000_000 * k},0.01,0.0,0.0,0.0,0.0,9.81" for k in range(N)]
    (mav / IMU).write_text("\n".join(["#timestamp [ns],w,w,w,a,a,a", *rows]) + "\n")
    image = np.zeros((48, 64), dtype=np.uint8)
    for c in range(2):
        (mav / f"cam{c}" / "data").mkdir(parents=True)
        times = [EPOCH + 50_000_000 * k for k in range(19)]
        for t in times:
            cv2.imwrite(str(mav / f"cam{c}" / "data" / f"{t}.png"), image)
        lines = ["#timestamp [ns],filename", *(f"{t},{t}.png" for t in times)]
        (mav / f"cam{c}" / "data.csv").write_text("\n".join(lines) + "\n")
        (mav / f"cam{c}" / "sensor.yaml").write_text(yaml.safe_dump(sensor(pose(-0.1 * c))))
    return mav


@pytest.fixture
def mav(good, tmp_path):
    return Path(shutil.copytree(good, tmp_path / "mav0"))


def refusal(mav):
    with pytest.raises(FileError) as caught:
        read_folder(mav.parent)
    text = str(caught.value)
    assert "\n" not in text
    return text


def edit(file, line, change):
    """Change the cells of a line (numbered from 1)."""
    lines = file.read_text().splitlines()
    lines[line - 1] = ",".join(change(lines[line - 1].split(",")))
    file.write_text("\n".join(lines) + "\n")


def edit_all(file, change):
    head, *lines = file.read_text().splitlines()
    file.write_text("\n".join([head, *(",".join(change(s.split(","))) for s in lines)]) + "\n")


def edit_yaml(mav, camera=0, **entries):
    file = mav / f"cam{camera}" / "sensor.yaml"
    tree = yaml.safe_load(file.read_text()) | entries
    file.write_text(yaml.safe_dump({k: v for k, v in tree.items() if v is not None}))


def test_a_folder_gives_back_what_was_written(mav):
    read = read_folder(mav.parent)
    np.testing.assert_array_equal(read.imu_ns, EPOCH + 5_000_000 * np.arange(N))
    np.testing.assert_array_equal(read.gyro_I[7], [0.01, 0.0, 0.0])
    np.testing.assert_array_equal(read.accel_I[7], [0.0, 0.0, 9.81])
    assert [len(c.files) for c in read.cameras] == [19, 19]
    np.testing.assert_allclose(read.cameras[1].known.T_IC, pose(-0.1), atol=1e-12)
    lens = read.cameras[0].known.model
    assert lens == RadTan(
        size_px=(64, 48), focal_px=(50.0, 51.0), center_px=(32.0, 24.0),
        distortion=(-0.1, 0.01, 0.0, 0.0),
    )  # fmt: skip


def test_what_skyhaul_records_is_read_back(made, tmp_path):
    with EurocWriter(tmp_path / "own", made.known, "vehicle 0") as writer:
        for reading, beside in made.readings:
            writer.add(reading, beside)
    read = read_folder(tmp_path / "own")
    np.testing.assert_array_equal(read.gyro_I, made.imu("gyro_I"))
    ahead_us = made.known.imu.clock_offset_us
    np.testing.assert_array_equal(read.imu_ns, 1000 * (made.imu("stamp_us") - ahead_us))
    for i, camera in enumerate(read.cameras):
        known = made.known.rig.cameras[i]
        np.testing.assert_allclose(camera.known.T_IC, T_IC(made.known.imu, known), atol=1e-12)
        assert camera.known.model == known.model
        for file, frame in zip(camera.files, made.frames(i), strict=True):
            np.testing.assert_array_equal(read_png(file, known.model.size_px), frame.image)


@pytest.mark.parametrize(
    ("line", "change", "message"),
    [
        (20, lambda c: c[:5], "line 20 is no IMU sample: it has 5 columns, not 7"),
        (20, lambda c: [*c, "1"], "line 20 is no IMU sample: it has 8 columns, not 7"),
        (20, lambda c: [*c[:3], "nan", *c[4:]], "line 20 is no IMU sample: w z is 'nan'"),
        (20, lambda c: [*c[:3], "1e160", *c[4:]], "w z is 1e+160, at most 100 is possible"),
        (20, lambda c: [*c[:6], "-1e160"], "a z is -1e+160, at most 4000 is possible"),
        (20, lambda c: [*c[:3], "1e999", *c[4:]], "w z is '1e999', not finite"),
        (20, lambda c: [*c[:3], "x", *c[4:]], "w z is 'x', no number"),
        (2, lambda c: ["1500000000.0", *c[1:]], "line 2 is no IMU sample: '1500000000.0' is no ti"),
        (2, lambda c: ["9" * 25, *c[1:]], "is beyond the year 2262"),
        (2, lambda c: ["--5", *c[1:]], "'--5' is no time in whole nanoseconds"),
        (2, lambda c: ["-1000000001", *c[1:]], "'-1000000001' ns is more than a second before"),
        (9, lambda c: [str(EPOCH), *c[1:]], "line 9: the time 1500000000000000000 ns comes -30"),
        (1, lambda c: ["timestamp", *c[1:]], "line 1 is no IMU sample: 'timestamp' is no time"),
    ],
)
def test_a_wrong_line_of_the_imu_is_named(mav, line, change, message):
    edit(mav / IMU, line, change)
    text = refusal(mav)
    assert str(mav / IMU) in text
    assert message in text


def test_a_sample_that_stands_twice_is_refused(mav):
    edit(mav / IMU, 30, lambda c: [str(EPOCH + 5_000_000 * 27), *c[1:]])
    assert "line 30: the time 1500000000135000000 ns comes 0 ns after that of line 29" in refusal(
        mav
    )


def test_times_in_milliseconds_are_refused(mav):
    edit_all(mav / IMU, lambda c: [str(int(c[0]) // 1_000_000), *c[1:]])
    assert "comes 5 ns after that of line 2; times must grow by 1000 ns at least" in refusal(mav)


def test_swapped_columns_of_gyroscope_and_accelerometer_are_told(mav):
    edit_all(mav / IMU, lambda c: [c[0], *c[4:], *c[1:4]])
    assert "columns of gyroscope and accelerometer are swapped" in refusal(mav)


@pytest.mark.parametrize("file", [IMU, CSV])
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read: No such file"),
        (b"", "holds no line of data"),
        (b"#only a comment\n", "holds no line of data"),
        (b"\xff\xfe\x00\x01", "is no text file"),
        (b"\0" * 99, "line 1 is no i"),
        (b"1;2;3;4;5;6;7\n", "it has 1 columns"),
    ],
)
def test_a_table_that_is_none_is_refused(mav, file, content, message):
    (mav / file).unlink() if content is None else (mav / file).write_bytes(content)
    text = refusal(mav)
    assert str(mav / file) in text
    assert message.lower() in text.lower()


def test_byte_order_mark_and_windows_line_ends_are_text(mav):
    data = (mav / IMU).read_bytes().replace(b"\n", b"\r\n")
    (mav / IMU).write_bytes(b"\xef\xbb\xbf" + data)
    assert len(read_folder(mav.parent).imu_ns) == N


@pytest.mark.parametrize(
    ("line", "change", "message"),
    [
        (5, lambda c: [c[0]], "line 5 is no image: it has 1 columns, not 2"),
        (5, lambda c: [str(EPOCH), c[1]], "line 5: the time 1500000000000000000 ns comes -100"),
        (5, lambda c: ["1500000000.15", c[1]], "nanoseconds, not seconds"),
        (5, lambda c: [c[0], "none.png"], "line 5: 'none.png' is no image of 64 x 48 px: there is"),
    ],
)
def test_a_wrong_line_of_a_camera_is_named(mav, line, change, message):
    edit(mav / CSV, line, change)
    text = refusal(mav)
    assert str(mav / CSV) in text
    assert message in text


def test_clocks_that_do_not_overlap_are_told_with_both_times(mav):
    edit_all(mav / CSV, lambda c: [str(int(c[0]) + 10**12), c[1]])
    text = refusal(mav)
    assert "from 1500001000.000 to 1500001000.900 s" in text
    assert "from 1500000000.000 to 1500000000.995 s" in text


def test_images_behind_the_end_of_the_imu_are_refused(mav):
    (mav / IMU).write_text("\n".join((mav / IMU).read_text().splitlines()[:100]))
    assert "leave out frames without IMU" in refusal(mav)


def test_cameras_that_never_fire_together_are_refused(mav):
    edit_all(mav / "cam1/data.csv", lambda c: [str(int(c[0]) + 25_000_000), c[1]])
    assert "its images are 25 ms (median) from those of cam0" in refusal(mav)


def test_a_camera_at_half_the_rate_may_be_there(mav):
    file = mav / "cam1/data.csv"
    head, *lines = file.read_text().splitlines()
    file.write_text("\n".join([head, *lines[::2]]))
    assert len(read_folder(mav).cameras[1].files) == 10


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"T_BS": None}, "needs T_BS (camera in IMU axes"),
        ({"T_BS": "identity"}, "T_BS needs 16 numbers"),
        ({"T_BS": {"data": [1.0] * 15}}, "T_BS needs 16 numbers"),
        ({"T_BS": {"data": [float("nan"), *[0.0] * 15]}}, "T_BS is 'nan', not finite"),
        ({"T_BS": {"data": [1e160, *[0.0] * 15]}}, "T_BS is 1e+160"),
        ({"T_BS": np.diag([2.0, 1, 1, 1]).tolist()}, "T_BS is no rigid motion"),
        ({"T_BS": np.diag([-1.0, 1, 1, 1]).tolist()}, "(a determinant of -1)"),
        ({"camera_model": "omni"}, "camera_model 'omni' is unknown; pinhole is allowed"),
        ({"distortion_model": "plumb_bob"}, "distortion_model 'plumb_bob' is unknown; allowed are"),
        ({"distortion_model": [1]}, "distortion_model [1] is unknown"),
        ({"distortion_coefficients": [0.0] * 5}, "distortion_coefficients needs 4 numbers, got a"),
        ({"distortion_coefficients": [1e160, 0, 0, 0]}, "distortion_coefficients is 1e+160"),
        ({"intrinsics": [50.0, 32.0, 24.0]}, "intrinsics needs 4 numbers, got a list of 3"),
        ({"intrinsics": [-50.0, 50.0, 32.0, 24.0]}, "are no fx fy cx cy [px]"),
        ({"intrinsics": [0.8, 1.1, 0.5, 0.5]}, "are no fx fy cx cy [px]"),
        ({"intrinsics": [50.0, 50.0, 700.0, 24.0]}, "are no fx fy cx cy [px]"),
        ({"intrinsics": [True, 50.0, 32.0, 24.0]}, "intrinsics is 'True', no number"),
        ({"resolution": "64x48"}, "resolution needs 2 numbers, got '64x48'"),
        ({"resolution": [-64, 48]}, "is no size of an image"),
        ({"resolution": [64.5, 48]}, "is no size of an image"),
        ({"timeshift_cam_imu": 1e160}, "timeshift_cam_imu is 1e+160"),
    ],
)
def test_a_wrong_entry_of_a_camera_is_named(mav, entries, message):
    edit_yaml(mav, **entries)
    text = refusal(mav)
    assert str(mav / YAML) in text
    assert message in text


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is no description of a sensor"),
        (b"\xff\0", "is no YAML file"),
        (b"a:\n\t- b", "is no YAML file at line 2"),
        (b"a: " + b"[" * 5000, "is no YAML file"),
        (b"T_BS: !!opencv-matrix\n", "is no YAML file at line 1: could not determine"),
        (None, "cannot be read: No such file"),
    ],
)
def test_a_description_that_is_none_is_refused(mav, content, message):
    (mav / YAML).unlink() if content is None else (mav / YAML).write_bytes(content)
    text = refusal(mav)
    assert str(mav / YAML) in text
    assert message in text


def test_opencvs_header_numbers_as_text_and_rounded_rotations_are_read(mav):
    T = np.round(pose(turn=0.3), 4)
    edit_yaml(mav, T_BS={"data": T.ravel().tolist()})
    text = (mav / YAML).read_text().replace("- -0.1\n", "- -1e-1\n")
    (mav / YAML).write_text("%YAML:1.0\n" + text)
    known = read_folder(mav).cameras[0].known
    assert known.model.distortion[0] == -0.1
    R = known.T_IC[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(R, pose(turn=0.3)[:3, :3], atol=1e-4)


def test_an_equidistant_camera_is_one(mav):
    edit_yaml(mav, distortion_model="equidistant")
    assert isinstance(read_folder(mav).cameras[0].known.model, Equidistant)


def kalibr(poses, **more):
    """Kalibr's chain: the first camera by the IMU, the others by the one before."""
    to_imu, out = [np.linalg.inv(T) for T in poses], {}
    for i, T in enumerate(to_imu):
        place = {"T_cam_imu": T.tolist()}
        if i:
            place = {"T_cn_cnm1": (T @ poses[i - 1]).tolist()}
        out[f"cam{i}"] = place | {
            "camera_model": "pinhole",
            "intrinsics": [50.0, 51.0, 32.0, 24.0],
            "distortion_model": "radtan",
            "distortion_coeffs": [-0.1, 0.01, 0.0, 0.0],
            "resolution": [64, 48],
            **more,
        }
    return out


def with_chain(mav, tree):
    for c in range(2):
        (mav / f"cam{c}" / "sensor.yaml").unlink()
    (mav.parent / "camchain-imucam.yaml").write_text(yaml.safe_dump(tree))


def test_kalibrs_chain_is_the_same_rig(mav):
    with_chain(mav, kalibr([pose(0.0), pose(-0.1, 0.2)]))
    read = read_folder(mav.parent)
    np.testing.assert_allclose(read.cameras[0].known.T_IC, pose(0.0), atol=1e-12)
    np.testing.assert_allclose(read.cameras[1].known.T_IC, pose(-0.1, 0.2), atol=1e-12)


def test_a_sensor_file_may_be_kalibrs_entry(mav):
    tree = {"cam0": kalibr([pose(0.0)])["cam0"]}
    (mav / YAML).write_text(yaml.safe_dump(tree))
    np.testing.assert_allclose(read_folder(mav).cameras[0].known.T_IC, pose(0.0), atol=1e-12)


def test_kalibrs_time_shift_moves_the_imu_to_the_first_cameras_clock(mav):
    with_chain(mav, kalibr([pose(0.0), pose(-0.1)], timeshift_cam_imu=0.01))
    read = read_folder(mav.parent)
    assert read.imu_ns[0] == EPOCH - 10_000_000  # t_imu = t_cam + shift
    assert read.cameras[0].time_ns[0] == read.cameras[1].time_ns[0] == EPOCH


def test_a_camera_with_a_shift_of_its_own_moves_by_the_difference(mav):
    edit_yaml(mav, 1, timeshift_cam_imu=-0.001)
    read = read_folder(mav)
    assert read.imu_ns[0] == read.cameras[0].time_ns[0] == EPOCH
    assert read.cameras[1].time_ns[0] == EPOCH - 1_000_000


def test_the_time_shift_of_a_chain_counts_beside_sensor_files(mav):
    chain = kalibr([pose(0.0)], timeshift_cam_imu=0.01)  # of one camera, with other poses
    (mav.parent / "camchain-imucam.yaml").write_text(yaml.safe_dump(chain))
    edit_yaml(mav, 1, timeshift_cam_imu=0.01)
    read = read_folder(mav.parent)
    assert read.imu_ns[0] == EPOCH - 10_000_000
    assert read.cameras[0].time_ns[0] == read.cameras[1].time_ns[0] == EPOCH
    np.testing.assert_allclose(read.cameras[1].known.T_IC, pose(-0.1), atol=1e-12)


def test_files_that_disagree_on_the_time_shift_are_both_named(mav):
    chain = kalibr([pose(0.0), pose(-0.1)], timeshift_cam_imu=0.01)
    (mav.parent / "camchain-imucam.yaml").write_text(yaml.safe_dump(chain))
    edit_yaml(mav, 0, timeshift_cam_imu=0.01 + 1e-9)  # rounded, the same
    edit_yaml(mav, 1, timeshift_cam_imu=0.0)
    text = refusal(mav)
    assert "cam1/sensor.yaml and " in text
    assert "camchain-imucam.yaml disagree on timeshift_cam_imu of cam1: 0 s and 0.01 s" in text


def test_a_chain_must_have_every_camera(mav):
    with_chain(mav, kalibr([pose()]))
    assert "camchain-imucam.yaml: cam1 is missing" in refusal(mav)


def test_two_chains_are_one_too_many_and_none_is_too_few(mav):
    with_chain(mav, kalibr([pose(), pose(-0.1)]))
    (mav / "camchain-2.yaml").write_text("a: 1")
    assert "has several camera chains" in refusal(mav)
    (mav / "camchain-2.yaml").unlink()
    (mav.parent / "camchain-imucam.yaml").unlink()
    assert "no *camchain*.yaml" in refusal(mav)


def test_two_cameras_with_one_place_are_refused(mav):
    shutil.copy(mav / "cam0/sensor.yaml", mav / "cam1/sensor.yaml")
    assert "cam0 and cam1 have the same T_BS" in refusal(mav)


def test_an_imu_that_is_not_the_body_is_refused(mav):
    (mav / "imu0/sensor.yaml").write_text(yaml.safe_dump({"T_BS": pose().tolist()}))
    assert "imu0/sensor.yaml: T_BS is not the identity" in refusal(mav)
    (mav / "imu0/sensor.yaml").write_text(yaml.safe_dump({"T_BS": np.eye(4).tolist()}))
    assert len(read_folder(mav).cameras) == 2


@pytest.mark.parametrize(
    ("gone", "message"),
    [
        (["cam0", "cam1"], "is no EuRoC folder"),
        (["imu0"], "is no EuRoC folder"),
        (["cam0"], "has cam1, but no folder cam0"),
    ],
)
def test_missing_folders_are_named(mav, gone, message):
    for name in gone:
        shutil.rmtree(mav / name)
    assert message in refusal(mav)
