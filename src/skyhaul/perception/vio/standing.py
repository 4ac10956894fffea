# SPDX-License-Identifier: Apache-2.0
"""Does the vehicle stand? And what an IMU that stands says of gravity and biases."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyhaul.geometry.quaternion import R_to_quat
from skyhaul.geometry.so3 import hat, rotation_z, so3_exp
from skyhaul.params import Params
from skyhaul.perception.vio.api import (
    BA,
    BG,
    NE,
    NavState,
    P,
    R,
    StartPose,
    TrackFrame,
    V,
)
from skyhaul.sensors.api import ImuReading
from skyhaul.types import GRAVITY_MPS2, US_PER_S, Array, IntArray

PIECE_S = 0.5
"""Least time over which the place of a track is averaged, where the window is longer [s]."""


@dataclass(frozen=True, kw_only=True)
class Standing(Params):
    """When a vehicle counts as standing, and how well."""

    window_s: float = 0.5
    """Time over which nothing may have moved [s]."""
    flow: float = 0.0015
    """Motion from the first half of that time to the second that counts as none, in the
    normalised image."""
    share: float = 0.4
    """Share of a camera's tracks that must not move; the others may be outliers."""
    least_tracks: int = 6
    """Tracks that must be seen in both halves; with fewer the IMU alone decides."""
    gyro_std_rad_s: float = 0.01
    """Without tracks: largest standard deviation of the angular rate [rad/s]."""
    accel_std_mps2: float = 0.1
    """Without tracks: largest standard deviation of the specific force [m/s^2]."""
    certain_s: float = 2.0
    """An estimate that moves is overruled by tracks and IMU that stand for this long [s]."""
    init_s: float = 1.0
    """Time to stand before gravity and biases are taken [s]."""
    speed_sigma_mps: float = 0.05
    """Standard deviation of the speed of a vehicle that stands [m/s]."""
    force_sigma_mps2: float = 0.05
    """Standard deviation of the mean force over `init_s`, vibration included [m/s^2]."""
    rate_sigma_rad_s: float = 0.005
    """The same of the mean rate [rad/s]."""
    gyro_bias_sigma_rad_s: float = 0.1
    """What a gyroscope's bias may be [rad/s]."""
    accel_bias_sigma_mps2: float = 0.1
    """What an accelerometer's bias may be [m/s^2]."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"{name} must be > 0, got {value}")
        if not self.share < 1.0:
            raise ValueError(f"share must lie between 0 and 1, got {self.share}")


def stands(
    params: Standing, frames: Sequence[TrackFrame], imu: ImuReading, window_s: float
) -> bool:
    """Whether nothing moved in a window that ends with the last frame.

    The tracks decide: rotors shake an IMU that stands. Where a track was on average in a piece of
    the window is held against where it was in the others; averages take the noise out. Pieces last
    half a second at least. Two would be too few for a long window: a vehicle that turns round is
    in the second half where it was in the first. Each camera with enough tracks must say so: what
    one sees may be far away.

    Args:
        params: Thresholds.
        frames: In order of time, the last one is now; they must reach back over all the window.
        imu: Samples of the window, for a vehicle that sees nothing.
        window_s: Length of the window [s].
    """
    now_us = frames[-1].stamp_us
    begin_us = now_us - round(window_s * US_PER_S)
    if frames[0].stamp_us > begin_us:
        return False
    count = max(2, int(window_s / PIECE_S))
    edges = now_us - np.round(np.linspace(window_s, 0.0, count + 1) * US_PER_S).astype(np.int64)
    pieces = [
        [f for f in frames if a < f.stamp_us <= b or f.stamp_us == begin_us == a]
        for a, b in itertools.pairwise(edges.tolist())
    ]
    moved, camera = flow(pieces)
    if len(moved) < params.least_tracks:
        return _imu_quiet(params, imu, begin_us)
    seen = [moved[camera == c] for c in np.unique(camera)]
    full = [m for m in seen if len(m) >= params.least_tracks] or [moved]
    return all(float(np.quantile(m, params.share)) <= params.flow for m in full)


def flow(pieces: Sequence[Sequence[TrackFrame]]) -> tuple[Array, IntArray]:
    """Motion of each track that all frames of its camera share, and its camera, (k,) each.

    The motion is the most between its means in two pieces.
    """
    every = list(itertools.chain.from_iterable(pieces))
    cameras = sorted({c for frame in every for c in np.unique(frame.camera).tolist()})
    none = np.zeros(0, dtype=np.int64)
    moved, camera = [np.zeros(0)], [none]
    for c in cameras:
        delivered = [[f for f in piece if c not in f.silent] for piece in pieces]
        motion = _flow_of(c, delivered) if all(delivered) else np.zeros(0)
        moved.append(motion)
        camera.append(np.full(len(motion), c, dtype=np.int64))
    return np.concatenate(moved), np.concatenate(camera)


def _flow_of(camera: int, pieces: Sequence[Sequence[TrackFrame]]) -> Array:
    """Motion of each track of a camera that all frames share, (k,)."""
    first = pieces[0][0]
    shared = first.sight_id[first.camera == camera]
    for frame in itertools.chain.from_iterable(pieces):
        shared = np.intersect1d(shared, frame.sight_id, assume_unique=True)
    means = [_mean_of(piece, shared) for piece in pieces]
    moved = [np.linalg.norm(a - b, axis=1) for a, b in itertools.combinations(means, 2)]
    most: Array = np.max(moved, axis=0)
    return most


def _mean_of(frames: Sequence[TrackFrame], tracks: IntArray) -> Array:
    """Where tracks were on average, (k, 2); `tracks` in growing order."""
    total = np.zeros((len(tracks), 2))
    for frame in frames:
        order = np.argsort(frame.sight_id)
        total += frame.xy[order[np.searchsorted(frame.sight_id, tracks, sorter=order)]]
    return total / len(frames)


def _imu_quiet(params: Standing, imu: ImuReading, begin_us: int) -> bool:
    inside = imu.stamp_us >= begin_us
    if np.count_nonzero(inside) < 10:
        return False
    return bool(
        np.all(np.std(imu.gyro_I[inside], axis=0) <= params.gyro_std_rad_s)
        and np.all(np.std(imu.accel_I[inside], axis=0) <= params.accel_std_mps2)
    )


def level(accel_I: Array, yaw_rad: float) -> Array:
    """R_WI of a body that stands: its specific force points up, its heading is given, (3, 3)."""
    up = accel_I / np.linalg.norm(accel_I)
    axis, cosine = np.cross(up, [0.0, 0.0, 1.0]), up[2]
    sine = np.linalg.norm(axis)
    flip = np.array([1.0, 0.0, 0.0]) if sine < 1e-9 else axis / sine
    R_tilt = so3_exp(np.arctan2(sine, cosine) * flip)
    forward = R_tilt[:, 0] if abs(R_tilt[2, 0]) < 0.9 else R_tilt[:, 1]
    turn = yaw_rad - np.arctan2(forward[1], forward[0])
    leveled: Array = rotation_z(turn) @ R_tilt
    return leveled


def start_covariance(params: Standing, start: StartPose, R_WI: Array) -> Array:
    """What is known before anything was measured: the start pose, (15, 15)."""
    P0 = np.zeros((NE, NE))
    P0[P, P] = start.sigma_m**2 * np.eye(3)
    tilt = np.diag([1.0, 1.0, start.sigma_yaw_rad**2])
    P0[R, R] = R_WI.T @ tilt @ R_WI
    P0[V, V] = np.eye(3)
    P0[BG, BG] = params.gyro_bias_sigma_rad_s**2 * np.eye(3)
    P0[BA, BA] = params.accel_bias_sigma_mps2**2 * np.eye(3)
    return P0


def static_start(params: Standing, imu: ImuReading, start: StartPose) -> tuple[NavState, Array]:
    """State and covariance of a vehicle that stood during all the samples.

    One Kalman update of the start pose with three measurements: the mean rate is the gyroscope's
    bias, the mean force is -g turned into the body plus the accelerometer's bias, the speed is
    zero. Tilt and bias stay correlated: the force cannot tell them apart.

    Returns:
        State and covariance (15, 15).
    """
    force, rate = imu.accel_I.mean(axis=0), imu.gyro_I.mean(axis=0)
    up = force / np.linalg.norm(force)
    R_WI = level(force, start.yaw_rad)
    prior = start_covariance(params, start, R_WI)
    H = np.zeros((9, NE))
    H[0:3, BG] = np.eye(3)
    H[3:6, R] = hat(GRAVITY_MPS2 * up)
    H[3:6, BA] = np.eye(3)
    H[6:9, V] = np.eye(3)
    sigma = np.repeat([params.rate_sigma_rad_s, params.force_sigma_mps2, params.speed_sigma_mps], 3)
    S = H @ prior @ H.T + np.diag(sigma**2)
    K = np.linalg.solve(S, H @ prior).T
    I_KH = np.eye(NE) - K @ H
    covariance = I_KH @ prior @ I_KH.T + K @ np.diag(sigma**2) @ K.T
    # The bias along the vertical is seen: the rest of the force went into the tilt.
    residual = np.concatenate([rate, force - GRAVITY_MPS2 * up, np.zeros(3)])
    dx = K @ residual
    state = NavState(start.p_WI, R_to_quat(R_WI @ so3_exp(dx[R])), np.zeros(3), dx[BG], dx[BA])
    return state, 0.5 * (covariance + covariance.T)
