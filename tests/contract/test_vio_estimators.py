# SPDX-License-Identifier: Apache-2.0
"""What every visual-inertial estimator must do. A new one adds one entry to ESTIMATORS."""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from simulated_tracks import GYRO_BIAS, ROOM_M, Flight, simulate

from skyhaul.errors import SensorDataError
from skyhaul.evaluation.trajectory_error import Trajectory, match, pose_nees, trajectory_error
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.so3 import rotation_z
from skyhaul.perception.vio.api import StartPose, TrackFrame, V, VioStatus
from skyhaul.perception.vio.ekf import EkfVio
from skyhaul.perception.vio.smoother import SmootherVio
from skyhaul.sensors.api import ImuReading

ESTIMATORS = [SmootherVio(), EkfVio()]

every_estimator = pytest.mark.parametrize("kind", ESTIMATORS, ids=lambda e: e.kind)

PLAIN = Flight(duration_s=9.0, still_s=1.5, pace=1.3)
FOUR = Flight(duration_s=5.0, still_s=1.5, cameras=4, tracks=10, pace=1.3)


@cache
def flown(flight):
    return simulate(flight)


def blind(frame):
    return TrackFrame(frame.stamp_us, frame.track_id[:0], frame.camera[:0], frame.xy[:0])


def first_camera(frame):
    one = frame.camera == 0
    return TrackFrame(frame.stamp_us, frame.track_id[one], frame.camera[one], frame.xy[one])


def as_measured(imu):
    return imu


def gap(imu):
    """Nothing for 0.3 s."""
    kept = (imu.stamp_us < 5_000_000) | (imu.stamp_us > 5_300_000)
    return ImuReading(imu.stamp_us[kept], imu.gyro_I[kept], imu.accel_I[kept])


def absurd(imu):
    """Now and then what no IMU measures."""
    gyro, accel = imu.gyro_I.copy(), imu.accel_I.copy()
    odd = (imu.stamp_us > 3_000_000) & (imu.stamp_us // 1000 % 1000 < 5)
    second = imu.stamp_us // 1_000_000
    gyro[odd & (second % 2 == 0)] = 1e160
    accel[odd & (second % 3 == 0)] = np.nan
    accel[odd & (second % 3 == 1)] = -1e30
    return ImuReading(imu.stamp_us, gyro, accel)


def false_now_and_then(imu):
    """Single samples that an IMU can measure, and a vehicle cannot do."""
    gyro, accel = imu.gyro_I.copy(), imu.accel_I.copy()
    odd = (imu.stamp_us > 2_000_000) & (imu.stamp_us // 1000 % 300 < 5)
    gyro[odd & (imu.stamp_us // 300_000 % 2 == 0), 1] += 20.0
    accel[odd & (imu.stamp_us // 300_000 % 2 == 1), 0] -= 60.0
    return ImuReading(imu.stamp_us, gyro, accel)


@cache
def follow(kind, flight, dark=(0.0, 0.0), start=None, hide=blind, spoil=as_measured):
    """Estimates of a flight whose cameras see less in an interval [s], and their memories."""
    recording = flown(flight).recording
    estimator = kind.build(recording.rig, recording.sigma)
    memory, out = estimator.init(start or StartPose()), []
    for imu, frame in recording.readings():
        hidden = dark[0] <= frame.stamp_us / 1e6 < dark[1]
        memory, estimate = estimator.step(memory, spoil(imu), hide(frame) if hidden else frame)
        out.append(estimate)
    return out, memory


def known(estimates):
    return [e for e in estimates if e.state is not None]


def scored(estimates, flight):
    states = [e.state for e in known(estimates)]
    path = Trajectory(
        np.array([1000 * e.stamp_us for e in known(estimates)]),
        np.array([s.p_WI for s in states]),
        np.array([s.q_WI for s in states]),
    )
    return match(path, flown(flight).truth)


@every_estimator
def test_there_is_no_state_before_gravity_is_known_and_one_at_every_frame_after(kind):
    estimates, _ = follow(kind, PLAIN)
    statuses = [e.status for e in estimates]
    first = statuses.index(VioStatus.TRACKING)
    assert 19 <= first <= 30
    assert all(e.state is None and e.status is VioStatus.INITIALIZING for e in estimates[:first])
    assert all(e.state is not None for e in estimates[first:])


@every_estimator
def test_stamps_are_those_of_the_frames(kind):
    estimates, _ = follow(kind, PLAIN)
    assert [e.stamp_us for e in estimates] == list(range(0, 9_000_001, 50_000))


@every_estimator
def test_it_stays_within_centimetres(kind):
    matched = scored(follow(kind, PLAIN)[0], PLAIN)
    error = trajectory_error(matched)
    assert error.path_m > 3.0
    assert error.ate_m < 0.015 * error.path_m
    assert error.rpe_deg < 0.6
    assert trajectory_error(matched, "sim3").scale == pytest.approx(1.0, abs=0.03)


@every_estimator
def test_it_finds_the_gyroscopes_bias_and_stays_on_the_start_pose(kind):
    estimates, _ = follow(kind, PLAIN)
    np.testing.assert_allclose(estimates[-1].state.gyro_bias, GYRO_BIAS, atol=3e-3)
    first = known(estimates)[0].state
    np.testing.assert_allclose(first.p_WI, 0.0, atol=5e-3)


@every_estimator
def test_the_error_is_within_its_covariance(kind):
    estimates, _ = follow(kind, PLAIN)
    matched = scored(estimates, PLAIN)
    nees = pose_nees(matched, np.array([e.covariance[:6, :6] for e in known(estimates)]))
    assert 1.0 < np.mean(nees) < 9.0


@every_estimator
def test_a_gap_in_the_imu_widens_the_covariance_and_is_borne(kind):
    estimates = follow(kind, PLAIN, spoil=gap)[0]
    whole = {e.stamp_us: e for e in follow(kind, PLAIN)[0]}
    inside = [e for e in estimates if 5_100_000 <= e.stamp_us <= 5_300_000]
    for e in inside:
        assert np.trace(e.covariance[V, V]) > 2.0 * np.trace(whole[e.stamp_us].covariance[V, V])
    matched = scored(estimates, PLAIN)
    nees = pose_nees(matched, np.array([e.covariance[:6, :6] for e in known(estimates)]))
    assert np.mean(nees) < 9.0
    assert np.max(nees) < 22.5  # 99.9 %
    assert trajectory_error(matched).ate_m < 0.01 * 6.0


@every_estimator
def test_what_no_imu_measures_counts_as_missing(kind):
    estimates, whole = follow(kind, PLAIN, spoil=absurd)[0], follow(kind, PLAIN)[0]
    off = [
        np.linalg.norm(a.state.p_WI - b.state.p_WI)
        for a, b in zip(estimates, whole, strict=True)
        if a.state is not None and b.state is not None
    ]
    assert max(off) < 0.02


@every_estimator
def test_single_false_samples_are_not_believed(kind):
    estimates, whole = follow(kind, PLAIN, spoil=false_now_and_then)[0], follow(kind, PLAIN)[0]
    pairs = [(a, b) for a, b in zip(estimates, whole, strict=True) if a.state and b.state]
    assert max(np.linalg.norm(a.state.p_WI - b.state.p_WI) for a, b in pairs) < 0.02
    assert max(np.linalg.norm(a.state.v_WI - b.state.v_WI) for a, b in pairs) < 0.05


@every_estimator
def test_covariances_are_symmetric_and_positive(kind):
    for e in known(follow(kind, PLAIN)[0])[::10]:
        np.testing.assert_allclose(e.covariance, e.covariance.T, atol=1e-15)
        assert np.linalg.eigvalsh(e.covariance).min() > 0.0
        assert np.linalg.norm(e.state.q_WI) == pytest.approx(1.0, abs=1e-9)


@every_estimator
def test_all_cameras_are_used(kind):
    estimates, _ = follow(kind, FOUR)
    error = trajectory_error(scored(estimates, FOUR))
    assert error.ate_m < 0.02 * error.path_m + 0.01
    used = [e.used for e in estimates]
    assert max(used) > 12  # more than one camera's ten tracks


@every_estimator
def test_in_the_dark_it_says_lost_its_covariance_grows_and_it_comes_back(kind):
    dark = (5.0, 7.5)
    estimates, _ = follow(kind, PLAIN, dark)
    at = {round(e.stamp_us / 1e6, 2): e for e in estimates}
    assert at[4.9].status is VioStatus.TRACKING
    assert at[7.4].status is VioStatus.LOST
    sigma = [np.sqrt(np.trace(at[t].covariance[:3, :3])) for t in (4.9, 6.0, 7.4)]
    assert sigma[0] < sigma[1] < sigma[2]
    assert sigma[2] > 3.0 * sigma[0]
    assert at[9.0].status is VioStatus.TRACKING
    assert all(np.isfinite(e.covariance).all() for e in estimates)


@every_estimator
def test_nothing_to_see_at_all_is_a_status_not_an_exception(kind):
    estimates, _ = follow(kind, PLAIN, (1.4, 99.0))
    assert estimates[-1].status is VioStatus.LOST
    assert estimates[-1].state is not None


@every_estimator
def test_a_moving_start_needs_no_rest(kind):
    flight = Flight(duration_s=7.0, still_s=0.0, pace=1.8, seed=3)
    estimates, _ = follow(kind, flight)
    assert estimates[10].status is VioStatus.INITIALIZING
    assert estimates[-1].status is VioStatus.TRACKING
    matched = scored(estimates, flight)
    error = trajectory_error(matched)
    assert error.matched > 20
    assert error.ate_m < 0.05 * error.path_m
    assert trajectory_error(matched, "sim3").scale == pytest.approx(1.0, abs=0.1)


@every_estimator
def test_steps_are_pure(kind):
    recording = flown(PLAIN).recording
    estimator = kind.build(recording.rig, recording.sigma)
    memory = estimator.init(StartPose())
    readings = list(recording.readings())
    for imu, frame in readings[:80]:
        memory, _ = estimator.step(memory, imu, frame)
    a, b = (estimator.step(memory, *readings[80])[1] for _ in range(2))
    np.testing.assert_array_equal(a.state.p_WI, b.state.p_WI)
    np.testing.assert_array_equal(a.covariance, b.covariance)


@every_estimator
@pytest.mark.parametrize("frame_us", [5_000_000, 5_050_000])  # keyframes or not
@pytest.mark.parametrize("dark", [(0.0, 0.0), (2.5, 5.0)])
def test_it_goes_on_from_the_state_that_it_is_given(kind, dark, frame_us):
    recording = flown(PLAIN).recording
    estimator = kind.build(recording.rig, recording.sigma)
    memory, shift, out = estimator.init(StartPose()), np.array([3.0, -2.0, 1.0]), {}
    for imu, frame in recording.readings():
        hidden = dark[0] <= frame.stamp_us / 1e6 < dark[1]
        memory, e = estimator.step(memory, imu, blind(frame) if hidden else frame)
        out[frame.stamp_us] = e
        if frame.stamp_us == frame_us:
            there = replace(e.state, p_WI=e.state.p_WI + shift)
            memory = estimator.restart(memory, there, 0.5 * e.covariance)
    before = {e.stamp_us: e for e in follow(kind, PLAIN, dark)[0]}
    assert out[frame_us + 50_000].status is VioStatus.TRACKING
    for t_us in range(frame_us + 50_000, 6_500_000, 50_000):
        e, reference = out[t_us], before[t_us]
        spread = np.sqrt(np.trace(reference.covariance[:3, :3]))
        off = np.linalg.norm(e.state.p_WI - shift - reference.state.p_WI)
        assert off < 3.0 * spread + 0.02
        assert np.linalg.eigvalsh(e.covariance).min() > 0.0
    fresh = np.trace(out[frame_us + 50_000].covariance[:3, :3])
    assert fresh < 0.9 * np.trace(before[frame_us + 50_000].covariance[:3, :3])


@every_estimator
def test_time_must_not_go_back(kind):
    recording = flown(PLAIN).recording
    estimator = kind.build(recording.rig, recording.sigma)
    memory = estimator.init(StartPose())
    (imu, frame), *_ = recording.readings()
    memory, _ = estimator.step(memory, imu, frame)
    with pytest.raises(SensorDataError, match="stamps must grow"):
        estimator.step(memory, imu, frame)


@every_estimator
def test_what_is_handed_on_cannot_be_written_to(kind):
    estimate = known(follow(kind, PLAIN)[0])[-1]
    with pytest.raises(ValueError, match="read-only"):
        estimate.covariance[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        estimate.state.p_WI[0] = 1.0


@every_estimator
def test_with_three_of_four_cameras_blind_for_a_second_it_goes_on(kind):
    estimates, _ = follow(kind, FOUR, (3.0, 4.0), hide=first_camera)
    assert all(e.status is VioStatus.TRACKING for e in known(estimates))
    error = trajectory_error(scored(estimates, FOUR))
    assert error.ate_m < 0.03 * error.path_m + 0.01


def in_turn(frame):
    """The first two cameras and the last two, one after the other."""
    here = (0, 1) if frame.stamp_us % 100_000 == 0 else (2, 3)
    some = np.isin(frame.camera, here)
    silent = (2, 3) if here == (0, 1) else (0, 1)
    return TrackFrame(
        frame.stamp_us, frame.track_id[some], frame.camera[some], frame.xy[some], silent
    )


@every_estimator
def test_cameras_may_take_turns(kind):
    flight = replace(FOUR, duration_s=7.0)
    estimates, _ = follow(kind, flight, (0.0, 99.0), hide=in_turn)
    assert all(e.status is VioStatus.TRACKING for e in known(estimates))
    error = trajectory_error(scored(estimates, flight))
    assert error.ate_m < 0.02 * error.path_m + 0.01
    assert max(e.used for e in estimates) > 6


@every_estimator
def test_landmarks_lie_on_the_walls(kind):
    _, memory = follow(kind, PLAIN)
    recording = flown(PLAIN).recording
    points = kind.build(recording.rig, recording.sigma).landmarks(memory)
    assert len(points) > 5
    # W is the start's: the room is shifted by where the flight began, and turned by its heading.
    truth = flown(PLAIN).truth
    R = rotation_z(heading(quat_to_R(truth.q[0])))
    away = np.abs(np.array(list(points.values())) @ R.T + truth.p[0]) - ROOM_M
    assert np.median(np.min(np.abs(away), axis=1)) < 0.15


def heading(R):
    return np.arctan2(R[1, 0], R[0, 0])


STANDS = Flight(duration_s=9.0, still_s=99.0)


def plain_wall(frame):
    """What a tracker follows in the noise of an image: it stays where it is, however one flies."""
    at = np.random.default_rng(4).uniform(-0.5, 0.5, (25, 2))
    noise = np.random.default_rng(frame.stamp_us).normal(0.0, 5e-4, (25, 2))
    return TrackFrame(frame.stamp_us, 10_000 + np.arange(25), np.zeros(25, np.int64), at + noise)


@every_estimator
def test_before_a_plain_wall_a_flying_vehicle_is_not_taken_for_one_that_stands(kind):
    wall = (5.0, 7.5)
    estimates, _ = follow(kind, PLAIN, wall, hide=plain_wall)
    dark, _ = follow(kind, PLAIN, wall)
    at = {round(e.stamp_us / 1e6, 2): e for e in estimates}
    if kind.kind == "ekf":  # the smoother makes landmarks of the noise for a while
        assert at[7.4].status is VioStatus.LOST
    assert at[9.0].status is VioStatus.TRACKING
    worst, unaided = (trajectory_error(scored(out, PLAIN)).ate_max_m for out in (estimates, dark))
    assert worst < 1.1 * unaided + 0.02  # no worse than seeing nothing
    # Nothing is held to be known that the images did not show.
    unseen = next(e for e in dark if e.stamp_us == at[7.4].stamp_us)
    sigma = [np.trace(e.covariance[V, V]) for e in (at[7.4], unseen)]
    assert sigma[0] > 0.7 * sigma[1]


def stood(kind, dark, jolt_mps=0.0):
    """Estimates of a vehicle that stands, blind for a while, amidst which its accelerometer clips.

    What the clipped samples lack adds up to a velocity that the covariance knows nothing of.
    """
    recording = flown(STANDS).recording
    estimator = kind.build(recording.rig, recording.sigma)
    memory, out = estimator.init(StartPose()), {}
    for imu, frame in recording.readings():
        t_s = frame.stamp_us / 1e6
        if jolt_mps and 4.0 < t_s <= 4.2:
            kick = [0.0, jolt_mps / 0.2, 0.0]
            imu = ImuReading(imu.stamp_us, imu.gyro_I, imu.accel_I + kick)
        hidden = dark[0] <= t_s < dark[1]
        memory, estimate = estimator.step(memory, imu, blind(frame) if hidden else frame)
        out[round(t_s, 2)] = estimate
    return out


def speed(estimate):
    return np.linalg.norm(estimate.state.v_WI)


@every_estimator
def test_a_vehicle_that_stands_is_held(kind):
    last = stood(kind, (99.0, 99.0))[9.0]
    assert last.status is VioStatus.TRACKING
    assert speed(last) < 0.02
    assert np.sqrt(np.trace(last.covariance[V, V])) < 0.06
    assert np.linalg.norm(last.state.p_WI) < 0.03


@every_estimator
def test_after_long_dead_reckoning_it_comes_to_rest_where_it_stands(kind):
    at = stood(kind, (2.0, 6.0))
    assert np.sqrt(np.trace(at[6.0].covariance[V, V])) < 2.0
    assert speed(at[7.2]) < 0.03
    assert at[7.2].status is VioStatus.TRACKING


@every_estimator
def test_tracks_and_imu_that_stand_for_long_overrule_a_velocity_that_is_sure_of_itself(kind):
    at = stood(kind, (3.9, 4.5), jolt_mps=1.5)
    before, variance = at[4.6].state.v_WI, at[4.6].covariance[V, V]
    assert before @ np.linalg.solve(variance, before) > 100.0  # sure, and wrong
    assert speed(at[9.0]) < 0.03
