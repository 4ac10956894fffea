# SPDX-License-Identifier: Apache-2.0
"""The window's factors in GTSAM, and the two eliminations it needs.

GTSAM's tangents are (turn, shift in body axes) of a pose and (accelerometer, gyroscope) of a bias;
`to_gtsam` changes our errors (p, R, v, b_g, b_a) into those.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

from skyhaul.geometry.quaternion import R_to_quat, quat_to_R
from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.vio import api
from skyhaul.perception.vio.api import CameraRig, NavState
from skyhaul.perception.vio.imu import ImuNoise
from skyhaul.perception.vio.pose_update import CUTOFF_2D
from skyhaul.types import GRAVITY_MPS2, Array

Robust = Literal["tukey", "huber", "none"]
HUBER_2D = 1.345
_PLANE = gtsam.Cal3_S2(1.0, 1.0, 0.0, 0.0, 0.0)
_POINT_PRIOR = gtsam.noiseModel.Isotropic.Sigma(3, 5.0)
_INTEGRATION = 1e-8 * np.eye(3)


def pose_of(state: NavState) -> gtsam.Pose3:
    """T_WI."""
    return gtsam.Pose3(gtsam.Rot3(quat_to_R(state.q_WI)), state.p_WI)


def bias_of(state: NavState) -> gtsam.imuBias.ConstantBias:
    """Accelerometer's and gyroscope's bias."""
    return gtsam.imuBias.ConstantBias(state.accel_bias, state.gyro_bias)


def insert_state(values: gtsam.Values, k: int, state: NavState) -> None:
    """Add a keyframe's variables."""
    values.insert(X(k), pose_of(state))
    values.insert(V(k), state.v_WI)
    values.insert(B(k), bias_of(state))


def state_in(values: gtsam.Values, k: int) -> NavState:
    """The state of a keyframe."""
    pose, bias = values.atPose3(X(k)), values.atConstantBias(B(k))
    return NavState(
        np.array(pose.translation()),
        R_to_quat(pose.rotation().matrix()),
        np.array(values.atVector(V(k))),
        np.array(bias.gyroscope()),
        np.array(bias.accelerometer()),
    )


def to_gtsam(state: NavState) -> Array:
    """M: our error is M times GTSAM's error (turn, shift, v, accelerometer, gyroscope)."""
    M = np.zeros((15, 15))
    M[api.R, 0:3] = M[api.V, 6:9] = M[api.BA, 9:12] = M[api.BG, 12:15] = np.eye(3)
    M[api.P, 3:6] = quat_to_R(state.q_WI)
    return M


def state_prior(k: int, state: NavState, covariance: Array) -> gtsam.NonlinearFactor:
    """What is known of a keyframe, as one factor over pose, velocity and biases."""
    M = to_gtsam(state)
    information = M.T @ np.linalg.inv(covariance) @ M
    root = np.linalg.cholesky(0.5 * (information + information.T)).T
    gaussian = gtsam.JacobianFactor(
        X(k),
        root[:, :6],
        V(k),
        root[:, 6:9],
        B(k),
        root[:, 9:15],
        np.zeros(15),
        gtsam.noiseModel.Unit.Create(15),
    )
    here = gtsam.Values()
    insert_state(here, k, state)
    return gtsam.LinearContainerFactor(gaussian, here)


def imu_parameters(noise: ImuNoise) -> gtsam.PreintegrationCombinedParams:
    """Noise as GTSAM takes it."""
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(GRAVITY_MPS2)
    params.setGyroscopeCovariance(noise.gyro_rad_s_rthz**2 * np.eye(3))
    params.setAccelerometerCovariance(noise.accel_mps2_rthz**2 * np.eye(3))
    params.setBiasOmegaCovariance(noise.gyro_walk_rad_s2_rthz**2 * np.eye(3))
    params.setBiasAccCovariance(noise.accel_walk_mps3_rthz**2 * np.eye(3))
    params.setIntegrationCovariance(_INTEGRATION)
    return params


def imu_factor(
    params: gtsam.PreintegrationCombinedParams, i: int, j: int, samples: Array, state: NavState
) -> gtsam.NonlinearFactor:
    """Motion between two keyframes; samples as `imu.segments` gives them, biases of the first.

    GTSAM turns a force by the attitude before its sample; turned by half the sample's own turn
    beforehand, it acts at the attitude of half time, as in `propagate`.
    """
    sums = gtsam.PreintegratedCombinedMeasurements(params, bias_of(state))
    half_turn = 0.5 * samples[:, :1] * (samples[:, 1:4] - state.gyro_bias)
    force = samples[:, 4:7] - state.accel_bias
    turned = (so3_exp(half_turn) @ force[:, :, None])[:, :, 0] + state.accel_bias
    for dt_s, gyro, accel in zip(samples[:, 0], samples[:, 1:4], turned, strict=True):
        sums.integrateMeasurement(accel, gyro, dt_s)
    return gtsam.CombinedImuFactor(X(i), V(i), X(j), V(j), B(i), B(j), sums)


def sight_noise(robust: Robust, sigma: float) -> gtsam.noiseModel.Base:
    """Noise of a track in the normalised image, with its M-estimator."""
    base = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
    estimators = gtsam.noiseModel.mEstimator
    match robust:
        case "tukey":
            return gtsam.noiseModel.Robust.Create(estimators.Tukey.Create(CUTOFF_2D), base)
        case "huber":
            return gtsam.noiseModel.Robust.Create(estimators.Huber.Create(HUBER_2D), base)
        case _:
            return base


def camera_poses(rig: CameraRig) -> tuple[gtsam.Pose3, ...]:
    """T_IC of every camera."""
    return tuple(gtsam.Pose3(gtsam.Rot3(R), p) for R, p in zip(rig.R_IC, rig.p_IC, strict=True))


def sight_factor(
    xy: Array, noise: gtsam.noiseModel.Base, k: int, landmark: int, T_IC: gtsam.Pose3
) -> gtsam.NonlinearFactor:
    """A landmark seen from a keyframe; behind the camera it counts nothing."""
    return gtsam.GenericProjectionFactorCal3_S2(
        xy, noise, X(k), landmark, _PLANE, False, False, T_IC
    )


def point_prior(landmark: int, p_WP: Array) -> gtsam.NonlinearFactor:
    """A weak hold on a landmark whose sights may all turn out wrong."""
    return gtsam.PriorFactorPoint3(landmark, p_WP, _POINT_PRIOR)


def speed_prior(k: int, sigma_mps: float) -> gtsam.NonlinearFactor:
    """The vehicle stands at a keyframe."""
    return gtsam.PriorFactorVector(
        V(k), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, sigma_mps)
    )


def graph_of(factors: Sequence[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    """Factors as GTSAM takes them."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    return graph


def optimize(
    factors: Sequence[gtsam.NonlinearFactor], values: gtsam.Values, k: int, iterations: int
) -> tuple[gtsam.Values, Array]:
    """Gauss-Newton, a few steps; Levenberg-Marquardt should a step make things worse.

    Landmarks are eliminated first, keyframe k last, so that the last rows of the factorisation
    hold what all factors say of its state.

    Returns:
        The solved values, and the covariance (15, 15) of keyframe k as an error of our layout.

    Raises:
        RuntimeError: When the problem is singular.
    """
    graph, ordering = graph_of(factors), _ordering(values, k)
    tree, error = graph.linearize(values).eliminateMultifrontal(ordering), graph.error(values)
    for step in range(iterations):
        moved = values.retract(tree.optimize())
        after = graph.error(moved)
        if not after < error * (1.0 + 1e-6) + 1e-9:
            moved = _careful(graph, values, ordering)
            after = graph.error(moved)
        values, gain, error = moved, error - after, after
        if gain < 1e-3 * after or step == iterations - 1:
            break
        tree = graph.linearize(values).eliminateMultifrontal(ordering)
    return values, _newest_covariance(tree, state_in(values, k), k)


def adjust_bundle(
    poses: Mapping[int, gtsam.Pose3],
    points: Mapping[int, Array],
    sights: Sequence[tuple[int, int, Array]],
    fixed: tuple[int, int],
    sigma: float,
) -> tuple[dict[int, gtsam.Pose3], dict[int, Array]]:
    """Poses of a camera and points that fit all sights best, with Tukey's estimator.

    Args:
        poses: Of the camera by frame.
        points: By track, (3,).
        sights: Frame, track, (2,) each.
        fixed: A frame whose pose stays, and one whose distance from it stays: the free scale.
        sigma: Standard deviation of a sight in the normalised image.

    Raises:
        RuntimeError: When the problem is singular.
    """
    tight, loose = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6), np.r_[[1e2] * 3, [1e-6] * 3]
    factors: list[gtsam.NonlinearFactor] = [
        gtsam.PriorFactorPose3(X(fixed[0]), poses[fixed[0]], tight),
        gtsam.PriorFactorPose3(
            X(fixed[1]), poses[fixed[1]], gtsam.noiseModel.Diagonal.Sigmas(loose)
        ),
    ]
    values, noise = gtsam.Values(), sight_noise("tukey", sigma)
    for k, pose in poses.items():
        values.insert(X(k), pose)
    for track, point in points.items():
        values.insert(L(track), point)
        factors.append(point_prior(L(track), point))
    factors += [sight_factor(xy, noise, k, L(i), gtsam.Pose3()) for k, i, xy in sights]
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(15)
    values = gtsam.LevenbergMarquardtOptimizer(graph_of(factors), values, params).optimize()
    return (
        {k: values.atPose3(X(k)) for k in poses},
        {i: np.array(values.atPoint3(L(i))) for i in points},
    )


def _ordering(values: gtsam.Values, k: int) -> gtsam.Ordering:
    """Landmarks, then keyframes by time, k the last."""
    ordering = gtsam.Ordering()
    keys = values.keys()
    points = [key for key in keys if gtsam.Symbol(key).chr() == ord("l")]
    first = k + 1 - (len(keys) - len(points)) // 3
    for key in points:
        ordering.push_back(key)
    for i in range(first, k + 1):
        for key in (X(i), V(i), B(i)):
            ordering.push_back(key)
    return ordering


def _careful(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, ordering: gtsam.Ordering
) -> gtsam.Values:
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(3)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, ordering, params).optimize()


def _newest_covariance(tree: gtsam.GaussianBayesTree, state: NavState, k: int) -> Array:
    """Covariance of what was eliminated last: pose, velocity and bias of keyframe k."""
    root = tree.roots()[0].conditional()
    assert list(root.keys())[-3:] == [X(k), V(k), B(k)]
    inverse = np.linalg.inv(root.R()[-15:, -15:])
    M = to_gtsam(state)
    covariance: Array = M @ inverse @ inverse.T @ M.T
    if not np.all(np.isfinite(covariance)):
        raise RuntimeError("the state is not determined")
    return 0.5 * (covariance + covariance.T)


def marginalize(
    factors: Sequence[gtsam.NonlinearFactor], values: gtsam.Values, gone: Sequence[int]
) -> tuple[gtsam.NonlinearFactor, ...]:
    """Factors over the variables that stay: those that touch one that goes become one.

    Raises:
        RuntimeError: When the variables that go are not determined.
    """
    leaving = set(gone)
    touched = [f for f in factors if not leaving.isdisjoint(f.keys())]
    kept = tuple(f for f in factors if leaving.isdisjoint(f.keys()))
    if not touched:
        return kept
    linear = graph_of(touched).linearize(values)
    _, rest = linear.eliminatePartialMultifrontal(list(gone))
    if rest.size() == 0:
        return kept
    return (*kept, gtsam.LinearContainerFactor(gtsam.HessianFactor(rest), values))
