# SPDX-License-Identifier: Apache-2.0
"""What is written is read back: tables, pictures, calibration, events; by ours and by others."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import yaml

from skyhaul.errors import FileError
from skyhaul.evaluation.dataset.calibration import T_IC, inverse
from skyhaul.evaluation.dataset.euroc import EurocWriter, read_frames, read_table
from skyhaul.evaluation.dataset.events_file import read_events
from skyhaul.evaluation.dataset.layout import IMU_HEAD, TRUTH_HEAD
from skyhaul.mission.config import RunConfig
from skyhaul.world.load import load_config

DATA = Path(os.environ.get("SKYHAUL_DATA", "../shared/data"))


@pytest.fixture(scope="module")
def written(made, tmp_path_factory):
    """The folder, and the ground truth that was given."""
    folder = tmp_path_factory.mktemp("set") / "vehicle_0"
    rng = np.random.default_rng(9)
    truth = 2_000 * np.arange(7), rng.normal(size=(7, 10)), rng.normal(size=(7, 6))
    with EurocWriter(folder, made.known, "vehicle_0") as writer:
        for reading, beside in made.readings:
            writer.add(reading, beside)
        writer.add_truth(*truth)
    return folder, truth


def load(path: Path):
    return yaml.safe_load(path.read_text("utf-8"))


def test_images_come_back_pixel_by_pixel_under_their_stamps(written, made) -> None:
    folder, _ = written
    for c in range(2):
        camera, frames = folder / "mav0" / f"cam{c}", made.frames(c)
        assert read_frames(camera / "data.csv") == [
            (1000 * f.stamp_us, f"{1000 * f.stamp_us:019d}.png") for f in frames
        ]
        assert sorted(p.name for p in (camera / "data").iterdir()) == sorted(
            f"{1000 * f.stamp_us:019d}.png" for f in frames
        )
        for frame in frames:
            image = cv2.imread(camera / "data" / f"{1000 * frame.stamp_us:019d}.png", -1)
            np.testing.assert_array_equal(image, frame.image)


def test_an_image_never_goes_over_another(made, tmp_path) -> None:
    first = made.readings[0]
    with EurocWriter(tmp_path / "set", made.known, "vehicle_0") as writer:
        writer.add(*first)
        with pytest.raises(FileError, match=r"0.png cannot be written: File exists$"):
            writer.add(*first)


def test_samples_come_back_to_the_last_bit(written, made) -> None:
    folder, (t_us, states, bias) = written
    stamps, values = read_table(folder / "mav0" / "imu0" / "data.csv")
    np.testing.assert_array_equal(stamps, 1000 * made.imu("stamp_us"))
    np.testing.assert_array_equal(values[:, :3], made.imu("gyro_I"))
    np.testing.assert_array_equal(values[:, 3:], made.imu("accel_I"))
    stamps, values = read_table(folder / "mav0" / "state_groundtruth_estimate0" / "data.csv")
    np.testing.assert_array_equal(stamps, 1000 * t_us)
    np.testing.assert_array_equal(values, np.column_stack([states, bias]))
    _, values = read_table(folder / "mav0" / "load_cell0" / "data.csv")
    np.testing.assert_array_equal(values[:, 0], made.tensions())


def test_the_heads_of_the_tables_are_those_of_euroc(written) -> None:
    folder, _ = written
    for name, head in (("imu0", IMU_HEAD), ("state_groundtruth_estimate0", TRUTH_HEAD)):
        assert (folder / "mav0" / name / "data.csv").read_text().startswith(head + "\n")


@pytest.mark.skipif(not (DATA / "euroc").is_dir(), reason=f"no EuRoC recordings in {DATA}")
def test_a_real_euroc_imu_table_is_read() -> None:
    truth = (DATA / "euroc" / "V1_02_medium_truth.csv").read_text().splitlines()[0]
    assert truth.strip() == TRUTH_HEAD
    assert (DATA / "euroc" / "V1_02_medium_imu.csv").read_text().startswith(IMU_HEAD)
    stamps, values = read_table(DATA / "euroc" / "V1_02_medium_imu.csv")
    assert np.median(np.diff(stamps)) == pytest.approx(5e6, rel=0.01)
    assert np.median(np.linalg.norm(values[:, 3:6], axis=1)) == pytest.approx(9.81, abs=0.5)


def test_a_sensors_description_gives_its_numbers_back(written, made) -> None:
    folder, known = written[0], made.known
    for c, camera in enumerate(known.rig.cameras):
        about = load(folder / "mav0" / f"cam{c}" / "sensor.yaml")
        T = np.array(about["T_BS"]["data"]).reshape(4, 4)
        point = np.array([0.3, -0.2, 1.7])  # in the camera
        in_body = camera.p_BC + camera.R_BC @ point
        in_imu = known.imu.R_BI.T @ (in_body - known.imu.p_BI)
        np.testing.assert_allclose(T @ [*point, 1.0], [*in_imu, 1.0], atol=1e-12)
        assert about["intrinsics"] == [*camera.model.focal_px, *camera.model.center_px]
        assert about["distortion_coefficients"] == list(camera.model.distortion)
        assert about["resolution"] == list(camera.model.size_px)
        assert about["rate_hz"] == camera.rate_hz
        assert about["timeshift_cam_imu"] == 250e-6
    imu = load(folder / "mav0" / "imu0" / "sensor.yaml")
    assert (imu["gyroscope_noise_density"], imu["accelerometer_random_walk"]) == (
        known.imu.gyro_noise,
        known.imu.accel_walk,
    )
    body = np.array(load(folder / "mav0" / "body.yaml")["T_carrier_imu"]["data"]).reshape(4, 4)
    np.testing.assert_array_equal(body[:3, :3], known.imu.R_BI)
    np.testing.assert_array_equal(body[:3, 3], known.imu.p_BI)
    assert load(folder / "mav0" / "body.yaml")["imu_clock_ahead_s"] == 250e-6


def test_kalibrs_chain_gives_every_pose_back(written, made) -> None:
    folder, known = written[0], made.known
    chain = load(folder / "camchain-imucam.yaml")
    assert list(chain) == ["cam0", "cam1", "cam2"]
    cameras, before = [*known.rig.cameras, known.rig.event_camera], None
    for entry, camera in zip(chain.values(), cameras, strict=True):
        T_CI = np.array(entry["T_cam_imu"])
        np.testing.assert_allclose(T_CI @ T_IC(known.imu, camera), np.eye(4), atol=1e-12)
        np.testing.assert_allclose(T_CI, np.linalg.inv(T_IC(known.imu, camera)), atol=1e-12)
        if before is not None:
            np.testing.assert_allclose(np.array(entry["T_cn_cnm1"]) @ before, T_CI, atol=1e-12)
        before = T_CI
        assert entry["camera_model"] == "pinhole"
        assert entry["distortion_model"] == camera.model.kind
        assert entry["distortion_coeffs"] == list(camera.model.distortion)
        assert entry["intrinsics"] == [*camera.model.focal_px, *camera.model.center_px]
        assert entry["resolution"] == list(camera.model.size_px)
        assert entry["timeshift_cam_imu"] == 250e-6
    assert chain["cam0"]["rostopic"] == "/vehicle_0/front_left/image"
    assert chain["cam2"]["rostopic"] == "/vehicle_0/events"
    imu = load(folder / "imu.yaml")
    assert imu["update_rate"] == 500.0
    assert imu["gyroscope_random_walk"] == known.imu.gyro_walk
    T = T_IC(known.imu, cameras[0])
    np.testing.assert_allclose(inverse(T) @ T, np.eye(4), atol=1e-12)


def test_events_come_back_from_hdf5(written, made) -> None:
    events = read_events(written[0] / "events.h5")
    for name in ("t_us", "x", "y", "p"):
        np.testing.assert_array_equal(getattr(events, name), made.events(name))
    with h5py.File(written[0] / "events.h5") as file:
        t, index = file["events/t"][:], file["ms_to_idx"][:]
        assert {k: v.dtype.str for k, v in file["events"].items()} == {
            "p": "|u1", "t": "<i8", "x": "<u2", "y": "<u2",
        }  # fmt: skip
        assert set(np.unique(file["events/p"][:])) == {0, 1}
        assert (file.attrs["width"], file.attrs["height"]) == (16, 12)
    assert len(index) == t[-1] // 1000 + 1
    for k, first in enumerate(index):
        assert np.all(t[:first] < 1000 * k)
        assert np.all(t[first:] >= 1000 * k)
    with h5py.File(written[0] / "events_labels.h5") as file:
        np.testing.assert_array_equal(file["object_id"][:], made.labels())


def test_the_labels_are_explained_beside_them(made, tmp_path) -> None:
    config = load_config(RunConfig, "paper", ())
    labels = config.sensors.label_names(config.team, config.world)
    with EurocWriter(tmp_path / "set", made.known, "vehicle_0", labels):
        pass
    with h5py.File(tmp_path / "set" / "events_labels.h5") as file:
        ids = file["ids"][:].tolist()
        names, kinds = (file[key].asstr()[:].tolist() for key in ("names", "kinds"))
    assert ids == list(range(-2, len(ids) - 2))
    assert (names[:2], kinds[:2]) == (["sky", "noise"], ["sky", "noise"])
    assert names[2:8] == ["wall -x", "wall +x", "wall -y", "wall +y", "floor", "ceiling"]
    assert [n for n, k in zip(names, kinds, strict=True) if k in ("static", "mover")] == [
        o.name for o in config.world.obstacles
    ]
    assert kinds[-9:] == ["payload", *["vehicle"] * 4, *["cable"] * 4]


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
sys.path.insert(0, {here!r})
from conftest import make_readings
from skyhaul.errors import FileError
from skyhaul.evaluation.dataset.euroc import EurocWriter

made = make_readings()
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
try:
    with EurocWriter(Path({folder!r}), made.known, "vehicle_0") as writer:
        for reading, beside in made.readings:
            writer.add(reading, beside)
except FileError as fault:
    print(fault)
"""


@pytest.mark.parametrize("limit", [900, 4_000, 9_000])
def test_a_full_disk_is_one_sentence(limit, tmp_path) -> None:
    here, folder = str(Path(__file__).parent), str(tmp_path / "set")
    code = FULL_DISK.format(here=here, limit=limit, folder=folder)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("\n") == 1
    assert "cannot be written: File too large" in done.stdout


def test_the_text_has_the_same_events(written, made) -> None:
    path = written[0] / "events.txt"
    rows = np.loadtxt(path)
    np.testing.assert_array_equal(np.round(rows[:, 0] * 1e6), made.events("t_us"))
    np.testing.assert_array_equal(rows[:, 1], made.events("x"))
    np.testing.assert_array_equal(rows[:, 2], made.events("y"))
    np.testing.assert_array_equal(rows[:, 3], made.events("p") > 0)
    t, *rest = path.read_text().splitlines()[0].split(" ")
    assert len(t.split(".")[1]) == 6
    assert len(rest) == 3


def test_what_is_no_table_is_refused(tmp_path) -> None:
    with pytest.raises(FileError, match="no such file"):
        read_table(tmp_path / "data.csv")
    (tmp_path / "data.csv").write_text("#head\n1,a\n")
    with pytest.raises(FileError, match="no table of numbers"):
        read_table(tmp_path / "data.csv")
    (tmp_path / "frames.csv").write_text("#head\nx,y.png\n")
    with pytest.raises(FileError, match="no table of images"):
        read_frames(tmp_path / "frames.csv")
    (tmp_path / "events.h5").write_bytes(b"no")
    with pytest.raises(FileError, match="holds no events"):
        read_events(tmp_path / "events.h5")
    with pytest.raises(FileError, match="no such file"):
        read_events(tmp_path / "none.h5")
