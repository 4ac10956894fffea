# SPDX-License-Identifier: Apache-2.0
"""A place that is seen again takes the drift out of a state: one Kalman update."""

from dataclasses import dataclass

import numpy as np

from skyhaul.geometry.quaternion import quat_exp, quat_mul, quat_normalize, quat_to_R
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


@dataclass(frozen=True, eq=False)
class Shared:
    """The errors of a pose that a closure finds: one that the state of now has too, one that not.

    Both are errors of (p, R) as those of a state.
    """

    held: Array  # (15, 15) covariance of what the state of now is off since it was at the place
    own: Array  # (6, 6) covariance of the rest

    @property
    def covariance(self) -> Array:
        """Of the pose found, (6, 6)."""
        return self.held[POSE, POSE] + self.own


def shared(place: Place, state: NavState, closure: Closure) -> Shared:
    """The error of a place, carried to now, and that of the closure.

    Position and heading are never measured: what the odometry was off in them at the place it is
    off ever since. Shifted by e_p and turned by phi = z z^T R_a e_R about the place, p is off by
    e_p + phi x (p - p_a), v by phi x v. Roll and pitch are measured anew all the time: theirs at
    the place turns the pose found, not the state of now.

    Args:
        place: The place a.
        state: Of now; its velocity is looked at.
        closure: The pose of now in the place's axes.
    """
    R_WI, p_WI = found_pose(place, closure)
    turn = np.zeros((NE, 3))  # by phi
    turn[P], turn[R], turn[V] = -hat(p_WI - place.p_WI), R_WI.T, -hat(state.v_WI)
    up = np.diag([0.0, 0.0, 1.0])
    J, tilt = np.zeros((NE, 6)), np.zeros((NE, 6))
    J[P, :3] = np.eye(3)
    J[:, 3:] = turn @ up @ place.R_WI
    tilt[:, 3:] = turn @ (np.eye(3) - up) @ place.R_WI
    S, tilt, axes = place.covariance, tilt[POSE], np.eye(6)
    axes[:3, :3] = R_WI
    own = tilt @ S @ tilt.T + axes @ closure.covariance @ axes.T
    return Shared(J @ S @ J.T, own)


def without_drift(
    state: NavState, covariance: Array, place: Place, closure: Closure
) -> tuple[NavState, Array]:
    """State and covariance (15, 15) after a place was seen again.

    The error since the place, d, has the covariance that is not held from then, D = S - S_a, and
    the closure measures it: z = d + e_c. K = D H^T (H D H^T + C)^-1,
    S' = (I - K H) D (I - K H)^T + K C K^T + S_a. In the tangent at the state z is linear, so that
    a large correction needs no iteration; S' is moved to the tangent at the new state. If z is
    further off than D allows, D is widened by as much: dead reckoning did not know its error.

    Args:
        state: Of now, with the drift in it.
        covariance: Of its error, (15, 15).
        place: The place, by the same odometry.
        closure: The pose of now in its axes.
    """
    common = shared(place, state, closure)
    C, D = common.own, _positive(covariance - common.held)
    z = off_by(state, found_pose(place, closure))
    D = D * max(1.0, float(z @ np.linalg.solve(D[POSE, POSE] + C, z)) / len(z))
    K = np.linalg.solve(D[POSE, POSE] + C, D[POSE]).T
    I_KH = np.eye(NE)
    I_KH[:, POSE] -= K
    after = I_KH @ D @ I_KH.T + K @ C @ K.T + common.held
    e, turn, Jr = K @ z, np.eye(NE), np.empty((3, 3))
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
