# SPDX-License-Identifier: Apache-2.0
"""Images to tracks, and a whole recording in the layout of EuRoC."""

import json

import cv2
import numpy as np
import pytest
import yaml
from simulated_tracks import Flight, rig_of, simulate

from skyhaul.cli.main import main
from skyhaul.cli.vio_source import open_source
from skyhaul.evaluation.trajectory_file import write_tum
from skyhaul.geometry.camera import RadTan, unproject_pixels
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.vio.api import CameraRig
from skyhaul.perception.vio.front_end import FrontEnd
from skyhaul.sensors.api import CameraFrame

LENS = RadTan(size_px=(320, 240), focal_px=(230.0, 230.0), center_px=(160.0, 120.0))
STEADY = np.eye(3)


def texture(seed=0, size=2000):
    """Blobs of all sizes."""
    rng, image = np.random.default_rng(seed), np.zeros((size, size), dtype=np.float32)
    for sigma, gain in ((2, 1.0), (6, 2.0), (20, 4.0)):
        layer = cv2.GaussianBlur(rng.normal(size=(size, size)).astype(np.float32), (0, 0), sigma)
        image += gain * layer / layer.std()
    low, high = np.percentile(image, [1, 99])
    return np.clip(255 * (image - low) / (high - low), 0, 255).astype(np.uint8)


WALL = texture()


def look(p_WC, R_WC):
    """Image of a wall of 10 x 10 m, 4 m north of the origin in x, through the lens."""
    scale = 10.0 / len(WALL)
    corner = np.array([4.0, 5.0, 5.0]) - p_WC
    axes = np.column_stack([[0, -scale, 0], [0, 0, -scale], corner])
    K = np.array([[230.0, 0, 160.0], [0, 230.0, 120.0], [0, 0, 1]])
    return cv2.warpPerspective(WALL, K @ R_WC.T @ axes, (320, 240), flags=cv2.INTER_LINEAR)


def noisy(image, seed=0):
    """The same view in another image: a camera never delivers the same bytes twice."""
    return np.clip(image + np.random.default_rng(seed).normal(0, 1, image.shape), 0, 255).astype(
        np.uint8
    )


def frame(image, stamp_us=0, camera=0):
    return CameraFrame(stamp_us, camera, image)


def run(images, turns, params=None):
    tracker = (params or FrontEnd()).build([LENS], rig_of(1))
    memory, out = tracker.init(), []
    for k, (image, turn) in enumerate(zip(images, turns, strict=True)):
        memory, tracks = tracker.step(memory, [frame(image, 50_000 * k)], 50_000 * k, turn)
        out.append(tracks)
    return out


def shared(a, b):
    _, i, j = np.intersect1d(a.track_id, b.track_id, return_indices=True)
    return a.xy[i], b.xy[j]


R_IC = rig_of(1).R_IC[0]


@pytest.mark.parametrize("detector", ["gftt", "fast", "orb", "sift"])
def test_corners_are_followed_to_a_tenth_of_a_pixel(detector):
    shifts = [np.array([0.0, 0.02 * k, 0.01 * k]) for k in range(6)]
    images = [look(p, R_IC) for p in shifts]
    out = run(images, [STEADY] * 6, FrontEnd(detector=detector, fast_threshold=10))
    a, b = shared(out[0], out[5])
    assert len(a) > 60
    # A wall 4 m away that moves by 0.1 and 0.05 m.
    error = 230.0 * (b - a - np.array([0.1, 0.05]) / 4.0)
    assert np.median(np.linalg.norm(error, axis=1)) < 0.1
    assert np.quantile(np.linalg.norm(error, axis=1), 0.95) < 0.5


def test_the_gyroscope_finds_corners_again_that_jumped():
    turn = so3_exp(np.array([0.0, 0.0, 0.2]))  # 46 px to the side
    images = [look(np.zeros(3), R_IC), look(np.zeros(3), turn @ R_IC)]
    small = FrontEnd(levels=0)
    blind, told = run(images, [STEADY] * 2, small), run(images, [STEADY, turn], small)
    assert len(shared(*told)[0]) > 40
    assert len(shared(*blind)[0]) < 0.2 * len(shared(*told)[0])
    a, b = shared(*told)
    rays = np.column_stack([a, np.ones(len(a))]) @ (R_IC.T @ turn @ R_IC)
    error = 230.0 * (b - rays[:, :2] / rays[:, 2:])
    assert np.median(np.linalg.norm(error, axis=1)) < 0.2


@pytest.mark.parametrize("detector", ["gftt", "fast", "orb", "sift"])
def test_corners_keep_their_distance_and_their_number(detector):
    still = look(np.zeros(3), R_IC)
    params = FrontEnd(detector=detector, features=50, spacing_px=20, fast_threshold=10)
    out = run([still, noisy(still)], [STEADY] * 2, params)
    for tracks in out:
        uv = 230.0 * tracks.xy
        apart = np.linalg.norm(uv[:, None] - uv[None], axis=2) + 1e3 * np.eye(len(uv))
        assert apart.min() > 18.0
        assert 40 <= len(uv) <= 50
    np.testing.assert_array_equal(out[0].track_id, out[1].track_id)


def test_a_patch_that_moves_on_its_own_is_dropped():
    first, second = look(np.zeros(3), R_IC), look(np.array([0.0, 0.04, 0.0]), R_IC)
    # Something in the middle slides upwards against the rest.
    second[60:140, 100:200] = first[66:146, 100:200]
    out = run([first, second], [STEADY] * 2)
    a, b = shared(*out)
    shift = 230.0 * (b - a)
    assert len(a) > 30
    assert np.mean(np.abs(shift[:, 1]) > 3.0) < 0.05


def test_a_camera_that_hangs_delivers_nothing_and_its_corners_are_found_again():
    images = [look(np.array([0.0, y, 0.0]), R_IC) for y in (0.0, 0.02, 0.02, 0.04)]
    tracker = FrontEnd().build([LENS], rig_of(1))
    memory, out = tracker.init(), []
    for k, image in enumerate(images):
        memory, tracks = tracker.step(memory, [frame(image, 50_000 * k)], 50_000 * k, STEADY)
        out.append(tracks)
    assert len(out[2].track_id) == 0
    assert [tracks.silent for tracks in out] == [(), (), (0,), ()]
    assert len(shared(out[1], out[3])[0]) > 60


def test_cameras_that_take_turns_keep_their_corners():
    tracker = FrontEnd(features=240).build([LENS] * 2, rig_of(2))
    memory, out = tracker.init(), []
    for k in range(8):
        view = look(np.array([0.0, 0.01 * k, 0.0]), R_IC)
        memory, tracks = tracker.step(memory, [frame(view, 50_000 * k, k % 2)], 50_000 * k, STEADY)
        out.append(tracks)
    assert [tracks.silent for tracks in out] == [(1,), (0,)] * 4
    for camera in (0, 1):
        assert len(shared(out[camera], out[6 + camera])[0]) > 60


def stereo():
    """Two cameras side by side, 0.1 m apart."""
    one = rig_of(1)
    return CameraRig(
        np.concatenate([one.R_IC] * 2), one.p_IC + np.array([[0.0, 0, 0], [0, -0.1, 0]])
    )


def test_cameras_side_by_side_find_each_others_corners():
    rig = stereo()
    tracker = FrontEnd().build([LENS, LENS], rig)
    assert tracker.pairs == ((0, 1),)
    images = [frame(look(rig.p_IC[c], rig.R_IC[c]), camera=c) for c in range(2)]
    _, out = tracker.step(tracker.init(), images, 0, STEADY)
    assert len(np.unique(out.sight_id)) == len(out.sight_id)
    left, right = (out.camera == c for c in range(2))
    both, i, j = np.intersect1d(out.track_id[left], out.track_id[right], return_indices=True)
    assert len(both) > 30
    error = out.xy[right][j] - out.xy[left][i] - [-0.1 / (4.0 - 0.1), 0.0]
    assert np.median(230.0 * np.linalg.norm(error, axis=1)) < 0.15


def test_cameras_back_to_back_do_not_look_for_each_others_corners():
    assert FrontEnd().build([LENS] * 3, rig_of(3)).pairs == ()


def test_a_black_image_loses_all_tracks_and_the_next_one_begins_anew():
    image = look(np.zeros(3), R_IC)
    out = run([image, np.zeros_like(image), image], [STEADY] * 3)
    assert len(out[1].track_id) == 0
    assert len(out[2].track_id) > 40
    assert out[2].track_id.min() > out[0].track_id.max()


def test_normalised_images_are_the_rays_of_the_lens():
    lens = RadTan.from_fov((320, 240), 90.0, (-0.2, 0.05, 1e-3, -5e-4))
    tracker = FrontEnd().build([lens], rig_of(1))
    memory, tracks = tracker.step(tracker.init(), [frame(look(np.zeros(3), R_IC))], 0, STEADY)
    rays = unproject_pixels(lens, memory.cameras[0].uv)
    np.testing.assert_allclose(tracks.xy, rays[:, :2] / rays[:, 2:], atol=1e-12)


def test_parameters_are_checked():
    with pytest.raises(ValueError, match="features must be >= 1"):
        FrontEnd(features=0)
    with pytest.raises(ValueError, match="back_px must be > 0"):
        FrontEnd(back_px=0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A flight before the wall, written in the layout of EuRoC."""
    base = tmp_path_factory.mktemp("euroc")
    flown = simulate(Flight(duration_s=5.0, still_s=1.5, pace=1.5, tracks=1, seed=2))
    mav, epoch = base / "mav0", 1_500_000_000_000_000_000
    (mav / "cam0" / "data").mkdir(parents=True)
    (mav / "imu0").mkdir()
    rig, t = flown.recording.rig, flown.truth
    lines = ["#timestamp [ns],filename"]
    for ns, p, q in zip(t.time_ns.tolist(), t.p, t.q, strict=True):
        R = quat_to_R(q)
        name = f"{epoch + ns}.png"
        cv2.imwrite(str(mav / "cam0" / "data" / name), look(p + R @ rig.p_IC[0], R @ rig.R_IC[0]))
        lines.append(f"{epoch + ns},{name}")
    (mav / "cam0" / "data.csv").write_text("\n".join(lines) + "\n")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rig.R_IC[0], rig.p_IC[0]
    sensor = {
        "T_BS": {"rows": 4, "cols": 4, "data": T.ravel().tolist()},
        "resolution": [320, 240],
        "intrinsics": [230.0, 230.0, 160.0, 120.0],
        "distortion_model": "radial-tangential",
        "distortion_coefficients": [0.0, 0.0, 0.0, 0.0],
    }
    (mav / "cam0" / "sensor.yaml").write_text(yaml.safe_dump(sensor))
    imu, rows = flown.recording.imu, ["#timestamp [ns],w x,w y,w z,a x,a y,a z"]
    for us, w, a in zip(imu.stamp_us.tolist(), imu.gyro_I, imu.accel_I, strict=True):
        rows.append(",".join([str(epoch + 1000 * us), *(repr(float(v)) for v in (*w, *a))]))
    (mav / "imu0" / "data.csv").write_text("\n".join(rows) + "\n")
    write_tum(base / "truth.txt", type(t)(t.time_ns + epoch, t.p, t.q))
    return base


@pytest.mark.parametrize("kind", ["smoother", "ekf"])
def test_a_folder_of_images_is_followed_within_centimetres(folder, capsys, kind):
    truth = ["--truth", str(folder / "truth.txt")]
    assert main(["vio", str(folder), *truth, "--json", "--kind", kind]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["path_m"] > 1.0
    assert figures["ate_m"] < 0.02 * figures["path_m"] + 0.01
    assert figures["frames_lost"] == 0


def test_where_no_place_is_seen_again_the_map_is_the_odometry(folder, capsys):
    truth = ["--truth", str(folder / "truth.txt")]
    assert main(["vio", str(folder), *truth, "--json", "--kind", "ekf", "--loops"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["loops"] == 0  # it is over before a place counts as left
    assert figures["ate_m"] == pytest.approx(figures["ate_without_loops_m"], abs=1e-9)


def test_a_folder_may_be_mav0_itself(folder):
    a, b = (open_source(p, 1.0).recording for p in (folder, folder / "mav0"))
    np.testing.assert_array_equal(a.imu.stamp_us, b.imu.stamp_us)
    assert a.sigma == pytest.approx(1.0 / 230.0)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("imu0/data.csv", b"#only a header\n", "holds no line of data"),
        ("imu0/data.csv", b"\xff\xfe\x00", "is no text file"),
        ("imu0/data.csv", b"1,2,3\n", "is no IMU sample"),
        ("cam0/data.csv", b"x,y\n", "is no image"),
        ("cam0/sensor.yaml", b"resolution: [320]\n", "needs T_BS"),
        ("cam0/sensor.yaml", b"[1, 2", "is no YAML"),
        ("cam0/data.csv", b"1500000000000000000,none.png\n", "is no image of 320 x 240"),
    ],
)
def test_a_broken_folder_is_one_sentence(folder, tmp_path, capsys, file, content, message):
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(folder / "mav0", copy, ignore=shutil.ignore_patterns("*.png"))
    (copy / file).write_bytes(content)
    assert main(["vio", str(copy)]) == 1
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1


def test_a_folder_without_sensors_is_refused(tmp_path, capsys):
    assert main(["vio", str(tmp_path)]) == 1
    assert "is no EuRoC folder" in capsys.readouterr().err
