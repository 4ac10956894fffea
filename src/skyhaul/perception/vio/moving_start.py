# SPDX-License-Identifier: Apache-2.0
"""The first state of a vehicle that already moves: structure, alignment, one joint solution."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L

from skyhaul.geometry.quaternion import R_to_quat, quat_to_R
from skyhaul.geometry.so3 import rotation_z
from skyhaul.params import Params
from skyhaul.perception.vio.alignment import Alignment, align_poses, gyro_bias_step
from skyhaul.perception.vio.api import CameraRig, NavState, P, StartPose, TrackFrame, V
from skyhaul.perception.vio.factors import (
    camera_poses,
    imu_factor,
    imu_parameters,
    insert_state,
    optimize,
    point_prior,
    sight_factor,
    sight_noise,
    state_in,
    state_prior,
)
from skyhaul.perception.vio.imu import ImuNoise, segments
from skyhaul.perception.vio.intake import Intake
from skyhaul.perception.vio.preintegration import Preintegrated, preintegrate
from skyhaul.perception.vio.standing import Standing, level, start_covariance
from skyhaul.perception.vio.structure import Sighted, Structure, build_structure, sighted
from skyhaul.types import GRAVITY_MPS2, US_PER_S, Array


@dataclass(frozen=True, kw_only=True)
class MovingStart(Params):
    """When the first state of a moving vehicle is taken."""

    span_s: float = 2.0
    """Time that the structure covers [s]."""
    step_s: float = 0.15
    """Time between its frames [s]."""
    retry_s: float = 0.25
    """Time between attempts [s]."""
    least_tracks: int = 8
    """Tracks that its first pair must share."""
    parallax_rad: float = 0.06
    """Median angle between the bearings of its first pair [rad]."""
    gravity_error: float = 0.1
    """Largest error of the length of gravity that the alignment finds, as a share."""
    scale_sigma: float = 0.2
    """Largest standard deviation of the scale, as a share."""
    speed_sigma_mps: float = 0.15
    """Largest standard deviation of the speed in the joint solution [m/s]."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"{name} must be > 0, got {value}")


@dataclass(frozen=True, eq=False)
class Stretch:
    """Frames of one camera, and the IMU between them."""

    camera: int
    seen: tuple[Sighted, ...]
    samples: tuple[Array, ...]  # segments between neighbours, (k, 7) each


def moving_start(
    params: MovingStart,
    standing: Standing,
    intake: Intake,
    start: StartPose,
    rig: CameraRig,
    noise: ImuNoise,
    sigma: float,
) -> tuple[NavState, Array] | None:
    """State and covariance (15, 15) now, or None where frames and IMU show too little yet.

    The newest pose stands at the start pose: shift and heading are free to choose.
    """
    stretch = _stretch(params, intake)
    if stretch is None:
        return None
    structure = build_structure(stretch.seen, sigma, params.least_tracks, params.parallax_rad)
    if structure is None:
        return None
    R_IC, p_IC = rig.R_IC[stretch.camera], rig.p_IC[stretch.camera]
    R_SI = structure.R_SC @ R_IC.T
    bias, motions = _gyro_bias(stretch, R_SI, noise)
    found = align_poses(motions, R_SI, structure.p_SC, p_IC)
    if found is None or not _sound(params, found):
        return None
    states, turn, shift = _metric(structure, found, R_SI, p_IC, bias, start)
    points = {i: turn @ (found.scale * x) + shift for i, x in structure.points.items()}
    return _joint(params, standing, stretch, states, points, start, (rig, noise, sigma))


def _stretch(params: MovingStart, intake: Intake) -> Stretch | None:
    """Frames `step_s` apart that end now and reach back `span_s`."""
    now, span_us = intake.now_us, round(params.span_s * US_PER_S)
    if intake.frames[0].stamp_us > now - span_us or len(intake.imu.stamp_us) < 2:
        return None
    picked: list[TrackFrame] = [intake.frames[-1]]
    for frame in reversed(intake.frames):
        apart = picked[-1].stamp_us - frame.stamp_us
        if apart >= round(0.99 * params.step_s * US_PER_S) and frame.stamp_us >= now - span_us:
            picked.append(frame)
    picked.reverse()
    if len(picked) < 5:
        return None
    camera = int(np.argmax(np.bincount(picked[-1].camera, minlength=1)))
    samples = tuple(segments(intake.imu, a.stamp_us, b.stamp_us) for a, b in pairwise(picked))
    return Stretch(camera, tuple(sighted(f, camera) for f in picked), samples)


def _gyro_bias(
    stretch: Stretch, R_SI: Array, noise: ImuNoise
) -> tuple[Array, Sequence[Preintegrated]]:
    """The gyroscope's bias that the poses show, and the motions without it."""
    bias, densities = np.zeros(3), noise.densities()
    motions = [preintegrate(s, bias, np.zeros(3), densities) for s in stretch.samples]
    for _ in range(3):
        bias = bias + gyro_bias_step(motions, R_SI)
        motions = [preintegrate(s, bias, np.zeros(3), densities) for s in stretch.samples]
    return bias, motions


def _sound(params: MovingStart, found: Alignment) -> bool:
    off = abs(found.gravity_free_mps2 / GRAVITY_MPS2 - 1.0)
    return (
        found.scale > 0.0 and off < params.gravity_error and found.scale_sigma < params.scale_sigma
    )


def _metric(
    structure: Structure, found: Alignment, R_SI: Array, p_IC: Array, bias: Array, start: StartPose
) -> tuple[list[NavState], Array, Array]:
    """States in W, and what takes points there: x_W = turn (scale x_S) + shift."""
    turn = level(-found.gravity_S, 0.0)
    R_WI = turn @ R_SI[-1]
    heading = start.yaw_rad - np.arctan2(R_WI[1, 0], R_WI[0, 0])
    turn = rotation_z(heading) @ turn
    p_SI = found.scale * structure.p_SC - R_SI @ p_IC
    shift = start.p_WI - turn @ p_SI[-1]
    states = [
        NavState(turn @ p + shift, R_to_quat(turn @ R_k), turn @ v, bias, np.zeros(3))
        for p, R_k, v in zip(p_SI, R_SI, found.v_SI, strict=True)
    ]
    return states, turn, shift


def _joint(
    params: MovingStart,
    standing: Standing,
    stretch: Stretch,
    states: Sequence[NavState],
    points: dict[int, Array],
    start: StartPose,
    about: tuple[CameraRig, ImuNoise, float],
) -> tuple[NavState, Array] | None:
    """All states, points and biases solved together; the newest state and its covariance."""
    rig, noise, sigma = about
    newest, values = len(states) - 1, gtsam.Values()
    for k, state in enumerate(states):
        insert_state(values, k, state)
    prior = start_covariance(standing, start, quat_to_R(states[-1].q_WI))
    prior[V, V] = 25.0 * np.eye(3)
    prior[P, P] = start.sigma_m**2 * np.eye(3)
    factors = [state_prior(newest, states[-1], prior)]
    imu = imu_parameters(noise)
    factors += [
        imu_factor(imu, k, k + 1, samples, states[k]) for k, samples in enumerate(stretch.samples)
    ]
    robust, T_IC = sight_noise("tukey", sigma), camera_poses(rig)[stretch.camera]
    for track, point in points.items():
        values.insert(L(track), point)
        factors.append(point_prior(L(track), point))
        factors += [
            sight_factor(seen[track], robust, k, L(track), T_IC)
            for k, seen in enumerate(stretch.seen)
            if track in seen
        ]
    try:
        values, covariance = optimize(factors, values, newest, 8)
    except RuntimeError:
        return None
    if not np.sqrt(np.diag(covariance)[V]).max() < params.speed_sigma_mps:
        return None
    return state_in(values, newest), covariance
