# SPDX-License-Identifier: Apache-2.0
"""Readings of a vehicle to its state: when estimates come, and which cameras they stand on."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_rotate
from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.vio.api import StartPose, VioStatus
from skyhaul.perception.vio.front_end import FrontEnd
from skyhaul.perception.vio.vehicle import VehicleVio, rig_of
from skyhaul.sensors.api import CameraFrame, ImuReading, VehicleReading
from skyhaul.sensors.config import SensorsConfig

CALIBRATION = SensorsConfig().calibration()
NONE = ImuReading(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))


def test_cameras_sit_where_they_are_on_the_body():
    rng = np.random.default_rng(0)
    imu = replace(CALIBRATION.imu, R_BI=so3_exp(rng.normal(size=3)), p_BI=rng.normal(size=3))
    calibration, rig = replace(CALIBRATION, imu=imu), rig_of(replace(CALIBRATION, imu=imu))
    for c, camera in enumerate(calibration.rig.cameras):
        np.testing.assert_allclose(imu.R_BI @ rig.R_IC[c], camera.R_BC, atol=1e-12)
        np.testing.assert_allclose(imu.p_BI + imu.R_BI @ rig.p_IC[c], camera.p_BC, atol=1e-12)


def readings(count):
    """A vehicle that stands: an IMU at 500 Hz, images of noise every 100 ms."""
    rng = np.random.default_rng(1)
    views = [
        cv2.GaussianBlur(rng.integers(0, 255, (240, 320), dtype=np.uint8), (0, 0), 2.0)
        for _ in CALIBRATION.rig.cameras
    ]
    views = [cv2.normalize(v, None, 0, 250, cv2.NORM_MINMAX) for v in views]
    for k in range(count):
        t_us = 2_000 * (k + 1)
        gyro = 1e-3 + 5e-3 * rng.normal(size=(1, 3))
        accel = np.array([[0.0, 0.0, 9.80665]]) + 0.04 * rng.normal(size=(1, 3))
        frames = ()
        if t_us % 100_000 == 0:
            noise = rng.integers(0, 3, (240, 320), dtype=np.uint8)
            frames = tuple(CameraFrame(t_us, c, v + noise) for c, v in enumerate(views))
        yield VehicleReading(
            t_us, 0, ImuReading(np.array([t_us - 1_000]), gyro, accel), frames, None, None
        )


@pytest.fixture(scope="module", params=["ekf", "smoother"])
def stood(request):
    """Readings and estimates of a vehicle that stands for 1.5 s."""
    start = StartPose(np.array([1.0, 2.0, 0.0]), 0.3, stands_until_us=100_000)
    odometry = VehicleVio(kind=request.param).build(CALIBRATION)
    memory, out = odometry.init(start), []
    for reading in readings(760):
        memory, estimate = odometry.step(memory, reading)
        out.append((reading.stamp_us, estimate))
    return out


def test_an_estimate_comes_with_the_first_sample_that_is_not_older_than_the_images(stood):
    came = [(t, e.stamp_us) for t, e in stood if e is not None]
    assert [stamp for _, stamp in came] == [100_000 * k for k in range(1, 16)]
    assert all(t == stamp + 2_000 for t, stamp in came)


def test_a_vehicle_that_stands_stays_where_it_is(stood):
    last = [e for _, e in stood if e is not None][-1]
    assert last.status is VioStatus.TRACKING
    np.testing.assert_allclose(last.state.p_WI, [1.0, 2.0, 0.0], atol=0.01)
    up = quat_rotate(last.state.q_WI, np.array([0.0, 0.0, 1.0]))
    assert up[2] > np.cos(np.radians(0.6))
    assert np.linalg.norm(last.state.v_WI) < 0.02


def test_without_an_imu_images_do_not_wait_for_ever():
    odometry = VehicleVio().build(CALIBRATION)
    memory, out = odometry.init(StartPose()), []
    for reading in readings(80):
        memory, estimate = odometry.step(memory, replace(reading, imu=NONE))
        out.append(estimate)
    known = [e for e in out if e is not None]
    assert [e.status for e in known] == [VioStatus.INITIALIZING]


def fired(offsets_us, count=100):
    """The same vehicle, its cameras firing so much later than the first."""
    held = []
    for reading in readings(count):
        held += [replace(f, stamp_us=f.stamp_us + offsets_us[f.camera]) for f in reading.frames]
        ready = tuple(f for f in held if f.stamp_us <= reading.stamp_us)
        held = [f for f in held if f.stamp_us > reading.stamp_us]
        yield replace(reading, frames=ready)


@pytest.mark.parametrize(
    ("offsets_us", "frames"),
    [
        ((0, 900, 1_800, 600), {0: (0, 1, 2, 3)}),
        ((0, 25_000, 26_000, 75_000), {0: (0,), 25_000: (1, 2), 75_000: (3,)}),
    ],
)
def test_images_taken_together_are_a_frame_and_others_are_frames_of_their_own(offsets_us, frames):
    odometry = VehicleVio().build(CALIBRATION)
    memory = odometry.init(StartPose(stands_until_us=100_000))
    seen, came = [], []
    for reading in fired(offsets_us):
        memory, estimate = odometry.step(memory, reading)
        if estimate is not None:
            frame = memory.estimator.intake.frames[-1]
            seen.append((frame.stamp_us - 100_000, tuple(np.unique(frame.camera))))
            came.append(reading.stamp_us - frame.stamp_us)
    assert seen == [(stamp, cameras) for stamp, cameras in frames.items()]
    assert max(came) <= 4_000


def test_images_that_come_late_together_are_frames_in_order_of_time():
    odometry = VehicleVio().build(CALIBRATION)
    memory, frames = odometry.init(StartPose(stands_until_us=100_000)), []
    for reading in fired((0, 25_000, 50_000, 75_000)):
        frames += reading.frames
        late = reading.stamp_us == 190_000
        reading = replace(reading, frames=tuple(frames[::-1]) if late else ())
        memory, estimate = odometry.step(memory, reading)
        assert (estimate is not None) == late
    stamps = [f.stamp_us for f in memory.estimator.intake.frames]
    assert stamps == [100_000, 125_000, 150_000, 175_000]


@pytest.mark.parametrize(
    ("key", "value"), [("sigma_px", 0.0), ("noise_margin", -1.0), ("accel_walk_margin", 0.0)]
)
def test_nonsense_is_refused(key, value):
    with pytest.raises(ValueError, match=f"{key} must be > 0"):
        VehicleVio(**{key: value})


def test_the_default_front_end_fits_small_images():
    assert VehicleVio().front_end.window_px < FrontEnd().window_px


def test_a_map_changes_no_estimate_of_a_vehicle_that_is_never_lost():
    start = StartPose(np.array([1.0, 2.0, 0.0]), 0.3, stands_until_us=100_000)
    odometry = VehicleVio(relocation=None).build(CALIBRATION)
    assert odometry.relocaliser is None
    with_map = VehicleVio().build(CALIBRATION)
    memory, other, came = odometry.init(start), with_map.init(start), 0
    for reading in readings(300):
        memory, alone = odometry.step(memory, reading)
        other, mapped = with_map.step(other, reading)
        if alone is None or alone.state is None:
            continue
        came += 1
        assert alone.state.p_WI.tobytes() == mapped.state.p_WI.tobytes()
        assert alone.covariance.tobytes() == mapped.covariance.tobytes()
    assert came > 3


class FoundAt:
    """Relocates a vehicle once, by a metre along x."""

    def __init__(self, stamp_us):
        self.stamp_us = stamp_us

    def follow(self, places, estimator, memory, estimate, views):
        assert len(views) == len(CALIBRATION.rig.cameras)
        if estimate.stamp_us != self.stamp_us:
            return places, memory, estimate
        state = replace(estimate.state, p_WI=estimate.state.p_WI + np.array([1.0, 0.0, 0.0]))
        memory = estimator.restart(memory, state, estimate.covariance)
        return places, memory, replace(estimate, state=state, relocated=True)


@pytest.mark.parametrize("kind", ["ekf", "smoother"])
def test_from_where_it_was_relocated_the_odometry_goes_on(kind):
    start = StartPose(np.zeros(3), 0.0, stands_until_us=100_000)
    odometry = replace(VehicleVio(kind=kind).build(CALIBRATION), relocaliser=FoundAt(800_000))
    memory, out = odometry.init(start), []
    for reading in readings(600):
        memory, estimate = odometry.step(memory, reading)
        if estimate is not None and estimate.state is not None:
            out.append(estimate)
    assert [e.stamp_us for e in out if e.relocated] == [800_000]
    for e in out:
        x = 1.0 if e.stamp_us >= 800_000 else 0.0
        np.testing.assert_allclose(e.state.p_WI, [x, 0.0, 0.0], atol=0.02)


class Views:
    """Keeps what it is shown."""

    def __init__(self):
        self.shown = []

    def follow(self, places, estimator, memory, estimate, views):
        self.shown.append([v is not None for v in views])
        return places, memory, estimate


def test_places_are_made_of_images_that_were_delivered_now():
    """Of a camera that drops images, or hangs, there is one of before: it shows another place."""
    views, held = Views(), {}
    odometry = replace(VehicleVio().build(CALIBRATION), relocaliser=views)
    memory = odometry.init(StartPose(stands_until_us=100_000))
    for reading in readings(260):
        frames = [f for f in reading.frames if f.camera != 2 or f.stamp_us <= 200_000]
        frames = [replace(f, image=held.setdefault(f.camera, f.image)) if f.camera == 3 else f
                  for f in frames]  # fmt: skip
        memory, _ = odometry.step(memory, replace(reading, frames=tuple(frames)))
    assert views.shown == [
        [True, True, True, True],
        [True, True, True, False],
        *[[True, True, False, False]] * 3,
    ]
