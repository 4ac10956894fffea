# SPDX-License-Identifier: Apache-2.0
"""A place that is seen again takes the drift out of a state: one Kalman update."""

import numpy as np

from skyhaul.geometry.quaternion import R_to_quat, quat_exp, quat_mul, quat_normalize, quat_to_R
from skyhaul.geometry.so3 import hat, so3_log
from skyhaul.perception.slam.closure import Closure
from skyhaul.perception.slam.places import Place
from skyhaul.perception.vio.api import BA, BG, NE, NavState, P, R, V
from skyhaul.perception.vio.propagation import right_jacobian
from skyhaul.types import Array

POSE = slice(0, 6)


def found_pose(place: Place, closure: Closure) -> tuple[Array, Array]:
    """R_WI (3, 3) and p_WI (3,) [m] that a closure says of now."""
    return place.R_WI @ closure.R, place.p_WI + place.R_WI @ closure.p


def off_by(state: NavState, pose: tuple[Array, Array]) -> Array:
    """Error (p, R) of a state whose pose is found to be R_WI, p_WI, (6,) [m, rad]."""
    R_WI, p_WI = pose
    return np.concatenate([p_WI - state.p_WI, so3_log(quat_to_R(state.q_WI).T @ R_WI)])


def in_world(closure: Closure, R_WI: Array) -> Array:
    """Covariance of a closure's error (p, R), (6, 6): p from the body's axes to those of W."""
    turn = np.eye(6)
    turn[:3, :3] = R_WI
    covariance: Array = turn @ closure.covariance @ turn.T
    return covariance


def carried(place: Place, state: NavState, pose: tuple[Array, Array]) -> Array:
    """The part of a state's covariance that is the error of a place, (15, 15).

    What the odometry was off at the place it is off ever since: shifted by e_p, turned by
    phi = R_a e_R about the place, so p is off by e_p + phi x (p - p_a), v by phi x v.

    Args:
        place: The place a.
        state: Of now; its velocity is looked at.
        pose: R_WI and p_WI of now.
    """
    R_WI, p_WI = pose
    J = np.zeros((NE, 6))
    J[P, :3] = np.eye(3)
    J[P, 3:] = -hat(p_WI - place.p_WI) @ place.R_WI
    J[R, 3:] = R_WI.T @ place.R_WI
    J[V, 3:] = -hat(state.v_WI) @ place.R_WI
    covariance: Array = J @ place.covariance @ J.T
    return covariance


def without_drift(
    state: NavState, covariance: Array, place: Place, closure: Closure
) -> tuple[NavState, Array]:
    """State and covariance (15, 15) after a place was seen again.

    The error since the place, d, has the covariance that is not carried from the place,
    D = S - J S_a J^T, and the closure measures it: z = d + e_c. K = D H^T (H D H^T + C)^-1,
    S' = (I - K H) D (I - K H)^T + K C K^T + J S_a J^T. In the tangent at the state z is linear, so
    that a large correction needs no iteration; S' is moved to the tangent at the new state. If z
    is further off than D allows, D is widened by as much: dead reckoning did not know its error.

    Args:
        state: Of now, with the drift in it.
        covariance: Of its error, (15, 15).
        place: The place, by the same odometry.
        closure: The pose of now in its axes.
    """
    pose = found_pose(place, closure)
    held, C = carried(place, state, pose), in_world(closure, pose[0])
    D, z = _positive(covariance - held), off_by(state, pose)
    D = D * max(1.0, z @ np.linalg.solve(D[POSE, POSE] + C, z) / 6.0)
    K = np.linalg.solve(D[POSE, POSE] + C, D[POSE]).T
    I_KH = np.eye(NE)
    I_KH[:, POSE] -= K
    after = I_KH @ D @ I_KH.T + K @ C @ K.T + held
    e = K @ z
    turn = np.eye(NE)
    Jr = np.empty((3, 3))
    right_jacobian(e[R], Jr)
    turn[R, R] = Jr
    after = turn @ after @ turn.T
    moved = NavState(
        state.p_WI + e[P],
        quat_normalize(quat_mul(state.q_WI, quat_exp(e[R]))),
        state.v_WI + e[V],
        state.gyro_bias + e[BG],
        state.accel_bias + e[BA],
    )
    return moved, 0.5 * (after + after.T)


def _positive(covariance: Array) -> Array:
    """The nearest that is positive semidefinite, in units of its own standard deviations."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 1e-18))
    values, vectors = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    good: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(sigma, sigma)
    return good
