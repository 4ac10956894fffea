# SPDX-License-Identifier: Apache-2.0
"""Each scripted fault does exactly what it says, to exactly what it names."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from skyhaul.errors import ConfigError
from skyhaul.mission.config import RunConfig
from skyhaul.sensors.api import CameraFrame, EventReading, ImuReading, VehicleReading
from skyhaul.sensors.faults import (
    ClockOffset,
    DroppedFrames,
    EventBurst,
    FrozenCamera,
    ImuGap,
    ImuSaturation,
    check_faults,
)
from skyhaul.sensors.flicker import Flicker
from skyhaul.sensors.script import script_of
from skyhaul.sensors.truth_api import EventLabels
from skyhaul.world.load import load_config

CAMERAS = ("front", "rear")
SIZE = (160, 120)
VEHICLE, BODY = 2, 3


def image(k):
    return np.full((2, 3), k % 256, dtype=np.uint8)


def frames(k):
    return tuple(CameraFrame(100_000 * k, c, image(10 * c + k)) for c in range(2))


def imu(t_us):
    return ImuReading(np.array([t_us]), np.array([[3.0, -4.0, 0.5]]), np.array([[1.0, 2.0, 30.0]]))


def events(t_us):
    t = np.array([t_us - 5_000, t_us], dtype=np.int64)
    x, y = np.array([1, 2], np.int16), np.array([3, 4], np.int16)
    return EventReading(t, x, y, np.array([1, -1], np.int8)), EventLabels(
        np.array([7, 8], np.int16)
    )


def play(faults, count=10, seed=0, vehicle=VEHICLE, period_us=100_000):
    """Readings (with two frames, one IMU sample, two events each) and labels, before and after."""
    script = script_of(faults, 1 + vehicle, CAMERAS, SIZE, 0)
    memory, out = script.init(seed), []
    for k in range(count):
        t_us = period_us * k
        seen, labels = events(t_us)
        clean = VehicleReading(t_us, vehicle, imu(t_us), frames(k), seen, None)
        memory, reading, labels = script.step(memory, clean, labels)
        out.append((clean, reading, labels))
    return out


def stamps(played, camera):
    return [f.stamp_us for _, r, _ in played for f in r.frames if f.camera == camera]


def pictures(played, camera):
    return [int(f.image[0, 0]) for _, r, _ in played for f in r.frames if f.camera == camera]


def test_without_faults_readings_pass_untouched() -> None:
    other = DroppedFrames(vehicle=0, camera="front", start_s=0.0, duration_s=9.0)
    for clean, reading, _ in play([other]):
        assert reading is clean


def test_dropped_frames_are_those_of_the_camera_and_the_time() -> None:
    played = play([DroppedFrames(vehicle=VEHICLE, camera="rear", start_s=0.3, duration_s=0.3)])
    assert stamps(played, 0) == [100_000 * k for k in range(10)]
    assert stamps(played, 1) == [100_000 * k for k in (0, 1, 2, 6, 7, 8, 9)]


def test_a_share_of_frames_is_lost_the_same_each_time() -> None:
    fault = DroppedFrames(vehicle=VEHICLE, camera="front", start_s=0.0, duration_s=99.0, share=0.3)
    kept = stamps(play([fault], count=500), 0)
    assert len(kept) == pytest.approx(350, abs=35)
    assert kept == stamps(play([fault], count=500), 0)
    assert kept != stamps(play([fault], count=500, seed=1), 0)


def test_a_frozen_camera_repeats_its_last_good_image_with_new_stamps() -> None:
    played = play([FrozenCamera(vehicle=VEHICLE, camera="rear", start_s=0.3, duration_s=0.4)])
    assert pictures(played, 1) == [10, 11, 12, 12, 12, 12, 12, 17, 18, 19]
    assert pictures(played, 0) == list(range(10))
    assert stamps(played, 1) == [100_000 * k for k in range(10)]


def test_an_imu_gap_leaves_nothing_and_only_then() -> None:
    played = play([ImuGap(vehicle=VEHICLE, start_s=0.2, duration_s=0.3)])
    assert [len(r.imu.stamp_us) for _, r, _ in played] == [1, 1, 0, 0, 0, 1, 1, 1, 1, 1]
    assert all(len(r.frames) == 2 for _, r, _ in played)


def test_a_saturated_imu_cuts_off_and_only_then() -> None:
    fault = ImuSaturation(
        vehicle=VEHICLE, start_s=0.2, duration_s=0.1, gyro_range_radps=2.0, accel_range_mps2=12.0
    )
    played = play([fault], count=4)
    np.testing.assert_array_equal(played[2][1].imu.gyro_I, [[2.0, -2.0, 0.5]])
    np.testing.assert_array_equal(played[2][1].imu.accel_I, [[1.0, 2.0, 12.0]])
    for k in (0, 1, 3):
        np.testing.assert_array_equal(played[k][1].imu.gyro_I, played[k][0].imu.gyro_I)


def test_the_loads_imu_has_faults_of_its_own() -> None:
    gap = ImuGap(vehicle="payload", start_s=0.0, duration_s=1.0)
    assert len(script_of([gap], 0, (), None, 0).imu(imu(0)).stamp_us) == 0
    assert len(script_of([gap], BODY, (), None, 0).imu(imu(0)).stamp_us) == 1


@pytest.mark.parametrize("ahead_us", [0, 7_000])
def test_samples_are_spoilt_by_when_they_are_measured(ahead_us) -> None:
    """Ten samples come at once, stamped by a clock that is ahead: a gap takes those of its time."""
    true_us = np.arange(200_000, 300_000, 10_000)
    clean = ImuReading(true_us + ahead_us, np.full((10, 3), 5.0), np.full((10, 3), 20.0))
    gap = ImuGap(vehicle=VEHICLE, start_s=0.25, duration_s=0.03)
    left = script_of([gap], BODY, (), None, ahead_us).imu(clean)
    assert (left.stamp_us - ahead_us).tolist() == [
        200_000,
        210_000,
        220_000,
        230_000,
        240_000,
        280_000,
        290_000,
    ]
    cut = ImuSaturation(
        vehicle=VEHICLE, start_s=0.25, duration_s=0.03, gyro_range_radps=2.0, accel_range_mps2=12.0
    )
    left = script_of([cut], BODY, (), None, ahead_us).imu(clean)
    assert left.gyro_I[:, 0].tolist() == [5.0] * 5 + [2.0] * 3 + [5.0] * 2
    assert left.accel_I[:, 2].tolist() == [20.0] * 5 + [12.0] * 3 + [20.0] * 2


def test_a_clock_that_runs_away_shifts_stamps_by_offset_and_drift() -> None:
    fault = ClockOffset(vehicle=VEHICLE, start_s=0.2, offset_us=-500, drift_ppm=100.0)
    played = play([fault], count=5)
    expected = [0, 100_000, 200_000 - 500, 300_000 - 500 + 10, 400_000 - 500 + 20]
    assert stamps(played, 0) == stamps(played, 1) == expected
    assert [r.imu.stamp_us[0] for _, r, _ in played] == [100_000 * k for k in range(5)]
    one = play([replace(fault, camera="rear")], count=5)
    assert stamps(one, 0) == [100_000 * k for k in range(5)]
    assert stamps(one, 1) == expected


def test_a_clock_set_back_drops_frames_until_it_is_past_the_last_stamp() -> None:
    back = ClockOffset(vehicle=VEHICLE, camera="front", start_s=0.35, offset_us=-100_000)
    played = play([back], count=8)
    assert stamps(played, 0) == [0, 100_000, 200_000, 300_000, 400_000, 500_000, 600_000]
    assert pictures(played, 0) == [0, 1, 2, 3, 5, 6, 7]
    assert stamps(played, 1) == [100_000 * k for k in range(8)]
    far = ClockOffset(vehicle=VEHICLE, camera="front", offset_us=-250_000)
    assert stamps(play([far], count=5), 0) == [50_000, 150_000]  # none from before the run


BURST = EventBurst(
    vehicle=VEHICLE, start_s=0.15, duration_s=0.4, rate_hz=20_000.0, flicker_hz=50.0,
    region_px=(40, 30, 10, 5),
)  # fmt: skip


def test_a_burst_adds_noise_events_in_its_region_time_and_rhythm() -> None:
    played = play([BURST], count=8)
    seen = [r.events for _, r, _ in played]
    t = np.concatenate([e.t_us for e in seen])
    x, y, p = (np.concatenate([getattr(e, k) for e in seen]) for k in ("x", "y", "p"))
    labels = np.concatenate([label.object_id for _, _, label in played])
    lamp = labels == -1
    assert (~lamp).sum() == 16
    assert lamp.sum() == pytest.approx(8_000, abs=4 * np.sqrt(8_000))
    assert np.all(np.diff(t) >= 0)
    assert t[lamp].min() >= 150_000
    assert t[lamp].max() < 550_000
    assert (x[lamp].min(), x[lamp].max()) == (40, 49)
    assert (y[lamp].min(), y[lamp].max()) == (30, 34)
    half = (t[lamp] - 150_000) // 10_000
    np.testing.assert_array_equal(p[lamp], np.where(half % 2 == 0, 1, -1))
    assert x[~lamp].tolist() == [1, 2] * 8


def test_a_burst_does_not_depend_on_how_its_time_is_cut() -> None:
    lamp = Flicker(BURST, 4, SIZE)
    whole = lamp.between(7, BODY, -1, 1_000_000)
    cuts = [-1, 0, 149_999, 150_000, 151_234, 160_000, 333_333, 549_999, 550_000, 1_000_000]
    parts = [lamp.between(7, BODY, a, b) for a, b in pairwise(cuts)]
    for name in ("t_us", "x", "y", "p"):
        glued = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(glued, getattr(whole, name))
    assert len(whole.t_us) > 7_000


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (ImuGap(vehicle=4, start_s=0, duration_s=1),
         r"sensors.faults\[0\].vehicle: there is no vehicle 4; allowed: 0 to 3 or payload"),
        (DroppedFrames(vehicle=-1, camera="front", start_s=0, duration_s=1),
         "there is no vehicle -1; allowed: 0 to 3$"),
        (FrozenCamera(vehicle=0, camera="top", start_s=0, duration_s=1),
         "there is no camera 'top'; allowed: front, rear"),
        (replace(BURST, region_px=(100, 0, 61, 5)), "must lie in the image of 160 x 120 px"),
    ],
)  # fmt: skip
def test_faults_of_what_does_not_exist_are_refused(fault, sentence) -> None:
    with pytest.raises(ValueError, match=sentence):
        check_faults([fault], 4, CAMERAS, SIZE)


def test_a_burst_needs_an_event_camera() -> None:
    with pytest.raises(ValueError, match="needs an event camera"):
        check_faults([BURST], 4, CAMERAS, None)


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        ("{kind: imu-gap, vehicle: 9, start_s: 1, duration_s: 1}", "there is no vehicle 9"),
        ("{kind: imu-gap, vehicle: payload, start_s: 1, duration_s: 0}", "duration_s must be > 0"),
        ("{kind: imu-gap, vehicle: 0, start_s: -1, duration_s: 1}", "start_s must be >= 0"),
        ("{kind: clock-offset, vehicle: 0}", "give at least one of them"),
        ("{kind: dropped-frames, vehicle: 0, camera: front, start_s: 0, duration_s: 1, share: 2}",
         r"share must lie in \(0, 1\], got 2"),
        ("{kind: blind, vehicle: 0}", "unknown kind 'blind'"),
        ("{kind: imu-gap, vehicle: x, start_s: 1, duration_s: 1}", r"faults\[0\]"),
        ("{kind: event-burst, vehicle: 0, start_s: 1, duration_s: 1, region_px: [-1, 0, 5, 5]}",
         "region_px must be"),
    ],
)  # fmt: skip
def test_a_bad_fault_in_a_scenario_is_one_sentence(entry, sentence) -> None:
    with pytest.raises(ConfigError, match=sentence) as error:
        load_config(RunConfig, "hover", [f"sensors.faults=[{entry}]"])
    assert "\n" not in str(error.value)
