# SPDX-License-Identifier: Apache-2.0
"""Recordings of `skyhaul vio`: files that were read and checked, as the estimators take them."""

import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyhaul.errors import FileError, SensorDataError
from skyhaul.evaluation.dataset.png import read_png
from skyhaul.evaluation.dataset.recorded import (
    TOGETHER_NS,
    RecordedCamera,
    RecordedFolder,
    read_folder,
)
from skyhaul.evaluation.dataset.table_file import NS_PER_US
from skyhaul.evaluation.dataset.tracks_file import RecordedTracks, read_tracks
from skyhaul.perception.vio.api import CameraRig, TrackFrame
from skyhaul.perception.vio.front_end import FeatureTracker, FrontEnd
from skyhaul.perception.vio.imu import ImuNoise, segments
from skyhaul.perception.vio.imu_check import check_imu, coherence
from skyhaul.perception.vio.preintegration import preintegrate
from skyhaul.perception.vio.recording import Images, Recording, Views, part
from skyhaul.sensors.api import CameraFrame, ImuReading
from skyhaul.types import US_PER_S, Array, IntArray

BASELINE_M = 1e-3
"""Cameras that share their view and stand closer than this show no depth to each other."""
SPIN_RAD_S, SPIN_COHERENCE, SPIN_SHARE = 6.0, 0.9, 0.25
"""A body that turns this fast for more than this share of its seconds spins: then about the
force, with this coherence at least (see `imu_check`)."""
MOST_SPINS = 60
"""So many seconds tell."""
CHECK_US = US_PER_S
"""Length of the IMU data that is checked."""


@dataclass(frozen=True, eq=False)
class Source:
    """A recording, and when its frames are."""

    recording: Recording
    time_ns: IntArray  # (m,) growing, by the clock of the recording


def open_source(path: Path, sigma_px: float) -> Source:
    """A recording by its path.

    Args:
        path: EuRoC folder or feature-track file.
        sigma_px: Standard deviation of a track [px].

    Raises:
        FileError: When there is nothing, or nothing that we can read.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise FileError(
            f"{path}: does not exist; give a feature-track CSV or an EuRoC folder"
        ) from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error
    if stat.S_ISDIR(mode):
        return _of_folder(path, read_folder(path), sigma_px)
    if not stat.S_ISREG(mode):
        raise FileError(f"{path}: is no file; give a feature-track CSV or an EuRoC folder")
    return _of_tracks(path, read_tracks(path), sigma_px)


def _of_tracks(path: Path, read: RecordedTracks, sigma_px: float) -> Source:
    epoch_ns = int(read.imu_ns[0])
    imu = _imu(path, read.imu_ns - epoch_ns, read.gyro_I, read.accel_I)
    stamps = (read.sight_ns - epoch_ns) // NS_PER_US
    cuts = np.flatnonzero(np.diff(stamps)) + 1
    frames = tuple(
        TrackFrame(
            int(stamps[i[0]]), read.track_id[i], np.zeros(len(i), dtype=np.int64), read.xy[i]
        )
        for i in np.split(np.arange(len(stamps)), cuts)
    )
    sigma = sigma_px / read.focal_px
    rig = CameraRig(read.R_IC[None], read.p_IC[None])
    recording = Recording(rig, imu, lambda: iter(frames), sigma, epoch_ns)
    return Source(recording, np.array([epoch_ns + NS_PER_US * f.stamp_us for f in frames]))


def _of_folder(path: Path, read: RecordedFolder, sigma_px: float) -> Source:
    epoch_ns = int(read.imu_ns[0])
    imu = _imu(read.imu_file, read.imu_ns - epoch_ns, read.gyro_I, read.accel_I)
    T_IC = np.array([c.known.T_IC for c in read.cameras])
    models = [c.known.model for c in read.cameras]
    rig = CameraRig(T_IC[:, :3, :3].copy(), T_IC[:, :3, 3].copy())
    tracker = FrontEnd().build(models, rig)
    for a, b in tracker.pairs:
        if np.linalg.norm(rig.p_IC[a] - rig.p_IC[b]) < BASELINE_M:
            raise FileError(
                f"{path}: cam{a} and cam{b} see the same and have the same place in T_BS; give "
                f"each camera its own place, or leave one out"
            )
    groups = tuple(_together(read.cameras))

    def views() -> Iterator[tuple[TrackFrame, Views]]:
        return _tracks(tracker, groups, imu, epoch_ns)

    def frames() -> Iterator[TrackFrame]:
        return (frame for frame, _ in views())

    images = Images(tuple(m.arrays() for m in models), views)
    sigma = sigma_px / float(np.mean([m.focal_px for m in models]))
    recording = Recording(rig, imu, frames, sigma, epoch_ns, images)
    return Source(recording, np.array([t for t, _ in groups], dtype=np.int64))


def _imu(file: Path, time_ns: IntArray, gyro: Array, accel: Array) -> ImuReading:
    """Samples from time 0 on, their first second and their rates checked.

    Raises:
        FileError: When they are nonsense.
    """
    imu = ImuReading(time_ns // NS_PER_US, gyro.copy(), accel.copy())
    begin = part(imu, 0, int(np.searchsorted(imu.stamp_us, CHECK_US, side="right")))
    try:
        check_imu(begin)
    except SensorDataError as error:
        raise FileError(f"{file}: {error}") from None
    spins = _spins(imu)
    if spins > SPIN_SHARE:
        raise FileError(
            f"{file}: in {100.0 * spins:.0f} % of the seconds the gyroscope turns by more than "
            f"{SPIN_RAD_S:g} rad/s and contradicts the force; give angular rates in rad/s, in the "
            f"accelerometer's axes"
        )
    return imu


def _spins(imu: ImuReading) -> float:
    """Share of the seconds that spin, the force smeared out when turned back by the gyroscope.

    A body that stands at first hides rates in degrees from the check of its first second.
    """
    seconds = [
        part(imu, *(int(i) for i in np.searchsorted(imu.stamp_us, [t, t + CHECK_US])))
        for t in range(0, int(imu.stamp_us[-1]) - CHECK_US, CHECK_US)
    ]
    rates = [np.linalg.norm(s.gyro_I, axis=1) for s in seconds]
    fast = [
        s
        for s, rate in zip(seconds, rates, strict=True)
        if len(rate) > 1 and np.median(rate) > SPIN_RAD_S
    ]
    if not fast or np.median([coherence(s) for s in fast[:MOST_SPINS]]) > SPIN_COHERENCE:
        return 0.0
    return len(fast) / len(seconds)


Group = tuple[int, list[tuple[int, RecordedCamera, Path]]]
"""Time [ns]; number, camera and file of each image."""


def _together(cameras: Sequence[RecordedCamera]) -> Iterator[Group]:
    """Images that were taken together, with the time of the first one."""
    entries = sorted(
        (t, c, file)
        for c, camera in enumerate(cameras)
        for t, file in zip(camera.time_ns.tolist(), camera.files, strict=True)
    )
    group: list[tuple[int, RecordedCamera, Path]] = []
    began = 0
    for t, c, file in entries:
        if group and t - began > TOGETHER_NS:
            yield began, group
            group = []
        if not group:
            began = t
        group.append((c, cameras[c], file))
    if group:
        yield began, group


def _tracks(
    tracker: FeatureTracker, groups: Sequence[Group], imu: ImuReading, epoch_ns: int
) -> Iterator[tuple[TrackFrame, Views]]:
    memory, last_us, zero = tracker.init(), None, np.zeros(3)
    noise = ImuNoise().densities()
    for time_ns, images in groups:
        now_us = (time_ns - epoch_ns) // NS_PER_US
        turn = np.eye(3)
        if last_us is not None:
            turn = preintegrate(segments(imu, last_us, now_us), zero, zero, noise).R_ij
        frames = [
            CameraFrame(now_us, c, read_png(file, camera.known.model.size_px))
            for c, camera, file in images
        ]
        before = memory
        memory, tracks = tracker.step(memory, frames, now_us, turn)
        last_us = now_us
        yield tracks, memory.delivered_since(before)
