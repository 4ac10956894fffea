# SPDX-License-Identifier: Apache-2.0
"""Made-up flights for the odometry: exact truth, IMU with noise and biases, tracks with outliers.

A body swings through a room on sums of sines after it stood for a while; cameras around it follow
points on the walls. A share of the tracks slides away from its point at a random constant speed,
as trackers do that took hold of an edge or of a shadow.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skyhaul.evaluation.trajectory_error import Trajectory
from skyhaul.geometry.quaternion import R_to_quat
from skyhaul.geometry.so3 import euler_to_R, so3_exp, so3_log
from skyhaul.perception.vio.api import CameraRig, TrackFrame
from skyhaul.perception.vio.recording import Recording
from skyhaul.sensors.api import ImuReading
from skyhaul.types import GRAVITY_MPS2, US_PER_S, Array, IntArray

FOCAL_PX = 460.0
HALF_VIEW = 0.7  # tangent of half the field of view
POINTS = 1500
ROOM_M = np.array([4.0, 4.0, 2.0])  # half sizes
GYRO_BIAS = np.array([0.01, -0.02, 0.03])
ACCEL_BIAS = np.array([0.06, -0.04, 0.05])
_H = 1e-3


@dataclass(frozen=True, kw_only=True)
class Flight:
    """What is made up."""

    seed: int = 0
    duration_s: float = 15.0
    still_s: float = 2.0  # standing before the flight
    cameras: int = 1
    tracks: int = 25  # followed by each camera
    outliers: float = 0.0  # share of the tracks that slide
    pace: float = 1.0  # of the swinging; accelerations grow with its square
    noise_px: float = 0.7
    gyro_rad_s_rthz: float = 2e-4
    accel_mps2_rthz: float = 2e-3


@dataclass(frozen=True, eq=False)
class Simulated:
    """A recording and what is true of it."""

    recording: Recording
    truth: Trajectory  # at the frames
    v_WI: Array  # (n, 3) [m/s]
    p_WP: Array  # (k, 3) points on the walls [m]
    point: IntArray  # (t,) the point of each track


def motion(flight: Flight) -> Callable[[Array], tuple[Array, Array]]:
    """Poses as a function of times [s], (n,): p_WI (n, 3) and R_WI (n, 3, 3)."""
    rng = np.random.default_rng([flight.seed, 1])
    rate = flight.pace * rng.uniform(0.5, 1.3, (2, 6))
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, 6))
    size = np.array([0.8, 0.8, 0.35, 0.15, 0.15, 0.4]) / 2.0

    def poses(t_s: Array) -> tuple[Array, Array]:
        late = np.maximum(0.0, t_s - flight.still_s)
        tau = late**4 / (late**3 + 1.0)  # rises smoothly from standing to t
        sines = np.sin(rate * tau[:, None, None] + phase) - np.sin(phase)
        x = size * np.sum(sines, axis=1)
        return x[:, :3], euler_to_R(x[:, 3:])

    return poses


def rig_of(cameras: int) -> CameraRig:
    """Cameras that look around the body: forward, left, back, right."""
    forward = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    turns = [so3_exp(np.array([0.0, 0.0, 0.5 * np.pi * c])) for c in range(cameras)]
    arm = np.array([0.1, 0.0, 0.02])
    return CameraRig(np.array([R @ forward for R in turns]), np.array([R @ arm for R in turns]))


def simulate(flight: Flight) -> Simulated:
    """Make a flight up; the same flight, the same bytes."""
    poses = motion(flight)
    stamps = np.arange(0, round(flight.duration_s * 20) + 1) * (US_PER_S // 20)
    t = stamps / US_PER_S
    p_WI, R_WI = poses(t)
    truth = Trajectory(1000 * stamps, p_WI, R_to_quat(R_WI))
    v_WI = (poses(t + _H)[0] - poses(t - _H)[0]) / (2.0 * _H)
    rig = rig_of(flight.cameras)
    points = _walls(np.random.default_rng([flight.seed, 3]), POINTS)
    made, point = _frames(flight, rig, stamps, list(zip(p_WI, R_WI, strict=True)))
    frames = tuple(made)
    sigma = max(flight.noise_px, 0.1) / FOCAL_PX
    recording = Recording(rig, _imu(flight, poses), lambda: iter(frames), sigma, 0)
    return Simulated(recording, truth, v_WI, points, point)


def _imu(flight: Flight, poses: Callable[[Array], tuple[Array, Array]]) -> ImuReading:
    rng = np.random.default_rng([flight.seed, 2])
    stamps = np.arange(0, round(flight.duration_s * 200) + 2) * (US_PER_S // 200)
    t = stamps / US_PER_S
    (p0, R0), (p1, R1), (p2, R2) = poses(t - _H), poses(t), poses(t + _H)
    gyro = so3_log(np.swapaxes(R0, 1, 2) @ R2) / (2.0 * _H)
    force_W = (p2 - 2.0 * p1 + p0) / _H**2 + [0.0, 0.0, GRAVITY_MPS2]
    accel = np.einsum("nji,nj->ni", R1, force_W)
    root_hz = np.sqrt(200.0)
    gyro += GYRO_BIAS + flight.gyro_rad_s_rthz * root_hz * rng.normal(size=gyro.shape)
    accel += ACCEL_BIAS + flight.accel_mps2_rthz * root_hz * rng.normal(size=accel.shape)
    return ImuReading(stamps, gyro, accel)


def _walls(rng: np.random.Generator, count: int) -> Array:
    """Points on the walls, the floor and the ceiling of the room, (count, 3)."""
    points = rng.uniform(-1.0, 1.0, (count, 3))
    axis = rng.integers(0, 3, count)
    points[np.arange(count), axis] = np.sign(points[np.arange(count), axis])
    walls: Array = points * ROOM_M
    return walls


def _frames(
    flight: Flight, rig: CameraRig, stamps: Array, poses: list[tuple[Array, Array]]
) -> tuple[list[TrackFrame], IntArray]:
    rng = np.random.default_rng([flight.seed, 3])
    points = _walls(rng, POINTS)
    held: list[dict[int, int]] = [{} for _ in rig.p_IC]  # per camera: point -> track
    slide: dict[int, Array] = {}
    born: dict[int, int] = {}
    point_of: list[int] = []
    following, frames = 0, []
    for t, (p_WI, R_WI) in zip(stamps.tolist(), poses, strict=True):
        rows = []
        for c, mine in enumerate(held):
            seen = (R_WI @ rig.R_IC[c]).T @ (points - p_WI - R_WI @ rig.p_IC[c]).T
            xy = (seen[:2] / np.where(seen[2] > 0.1, seen[2], np.inf)).T
            inside = (seen[2] > 0.1) & np.all(np.abs(xy) < HALF_VIEW, axis=1)
            for point in [i for i in mine if not inside[i]]:
                del mine[point]
            fresh = rng.permutation(np.flatnonzero(inside))
            for point in [int(i) for i in fresh if int(i) not in mine]:
                if len(mine) >= flight.tracks:
                    break
                mine[point], born[following] = following, t
                bad = rng.random() < flight.outliers
                heading = rng.uniform(0.0, 2.0 * np.pi)
                speed = rng.uniform(0.03, 0.3) * bad  # of the normalised image, per second
                slide[following] = speed * np.array([np.cos(heading), np.sin(heading)])
                point_of.append(point)
                following += 1
            for point, track in mine.items():
                error = flight.noise_px / FOCAL_PX * rng.normal(size=2)
                drift = slide[track] * (t - born[track]) / US_PER_S
                rows.append((track, c, *(xy[point] + error + drift)))
        table = np.array(rows).reshape(-1, 4)
        ids, cameras = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
        frames.append(TrackFrame(t, ids, cameras, table[:, 2:].copy()))
    return frames, np.array(point_of, dtype=np.int64)
