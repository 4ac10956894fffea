# SPDX-License-Identifier: Apache-2.0
"""The joined log as the readers of others see it."""

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from skyhaul.evaluation.dataset.euroc import EurocWriter
from skyhaul.evaluation.dataset.sensor_log import Body, write_sensor_log
from skyhaul.evaluation.mcap_log import McapLog


@pytest.fixture(scope="module")
def joined(made, tmp_path_factory):
    """Messages of the log by topic, as (log time [ns], message), decoded by mcap_ros2."""
    root = tmp_path_factory.mktemp("joined")
    with EurocWriter(root / "vehicle_0", made.known, "vehicle_0") as writer:
        for reading, beside in made.readings:
            writer.add(reading, beside)
    flight = McapLog(root / "flight.mcap")
    for t_us in (0, 100_000, 200_000):
        flight.write(
            "/mission/phase", "skyhaul_msgs/Phase", t_us, 0, 0, "world", f"at {t_us}", True
        )
    flight.close()
    body = Body("vehicle_0", made.known)
    write_sensor_log(root / "log.mcap", root / "flight.mcap", root, [body])
    assert not (root / "log.mcap.part").exists()
    topics, times = {}, []
    with (root / "log.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            topics.setdefault(channel.topic, []).append((message.log_time, decoded))
            times.append(message.log_time)
    assert times == sorted(times)
    return topics


def test_the_flights_topics_are_in_it(joined) -> None:
    assert [m.name for _, m in joined["/mission/phase"]] == ["at 0", "at 100000", "at 200000"]


def test_imu_samples_are_in_it_to_the_last_bit(joined, made) -> None:
    seen = [m for _, m in joined["/vehicle_0/imu"]]
    w = [[m.angular_velocity.x, m.angular_velocity.y, m.angular_velocity.z] for m in seen]
    a = [[m.linear_acceleration.x, m.linear_acceleration.y, m.linear_acceleration.z] for m in seen]
    np.testing.assert_array_equal(w, made.imu("gyro_I"))
    np.testing.assert_array_equal(a, made.imu("accel_I"))
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in seen]
    np.testing.assert_array_equal(stamps, 1000 * made.imu("stamp_us"))
    assert [t for t, _ in joined["/vehicle_0/imu"]] == stamps
    assert seen[0].header.frame_id == "vehicle_0/imu"
    assert seen[0].orientation_covariance[0] == -1.0
    variance = (made.known.imu.gyro_noise**2) * 500
    np.testing.assert_allclose(
        np.reshape(seen[0].angular_velocity_covariance, (3, 3)), variance * np.eye(3)
    )


def test_images_are_in_it_pixel_by_pixel(joined, made) -> None:
    for c, name in enumerate(("front_left", "rear")):
        seen = [m for _, m in joined[f"/vehicle_0/{name}/image"]]
        assert len(seen) == len(made.frames(c)) == 3
        for message, frame in zip(seen, made.frames(c), strict=True):
            assert message.format == "png"
            image = cv2.imdecode(np.frombuffer(bytes(message.data), np.uint8), -1)
            np.testing.assert_array_equal(image, frame.image)
            assert message.header.stamp.nanosec == 1000 * frame.stamp_us


def test_camera_info_tells_the_calibration(joined, made) -> None:
    for camera, beside in (("front_left", "front_left/image"), ("events", "events")):
        ours, theirs = (
            [(m.header.stamp.sec, m.header.stamp.nanosec) for _, m in joined[f"/vehicle_0/{topic}"]]
            for topic in (f"{camera}/camera_info", beside)
        )
        assert ours == theirs
    (_, info), *_ = joined["/vehicle_0/front_left/camera_info"]
    model = made.known.rig.cameras[0].model
    assert (info.width, info.height) == model.size_px
    assert (info.distortion_model, list(info.d)) == ("plumb_bob", [*model.distortion, 0.0])
    assert (info.k[0], info.k[4]) == model.focal_px
    assert (info.p[2], info.p[6]) == model.center_px


def test_events_are_in_it(joined, made) -> None:
    seen = [m for _, m in joined["/vehicle_0/events"]]
    for ours, theirs in (("t_us", "t_us"), ("x", "x"), ("y", "y"), ("p", "p")):
        np.testing.assert_array_equal(
            np.concatenate([list(getattr(m, theirs)) for m in seen]), made.events(ours)
        )
    assert all(m.t_us[-1] - m.t_us[0] <= 10_000 for m in seen)
    assert (seen[0].width, seen[0].height) == (16, 12)


def test_tensions_are_in_it(joined, made) -> None:
    seen = [m.tension_n for _, m in joined["/vehicle_0/load_cell"]]
    np.testing.assert_array_equal(seen, made.tensions())


def test_the_places_of_the_sensors_are_in_it(joined, made) -> None:
    ((_, tree),) = joined["/tf_static"]
    frames = {f.child_frame_id: f for f in tree.transforms}
    assert set(frames) == {
        "vehicle_0/imu", "vehicle_0/front_left", "vehicle_0/rear", "vehicle_0/events",
    }  # fmt: skip
    place = frames["vehicle_0/front_left"].transform.translation
    np.testing.assert_array_equal([place.x, place.y, place.z], made.known.rig.cameras[0].p_BC)
    assert {f.header.frame_id for f in tree.transforms} == {"vehicle_0"}
