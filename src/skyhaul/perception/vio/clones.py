# SPDX-License-Identifier: Apache-2.0
"""The filter's state with its clones of past poses: propagation, cloning, update, forgetting.

A filter is never changed: each function returns a new one. Its error is that of the state (15,)
followed by (p, R) of each clone, the oldest first.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyhaul.geometry.quaternion import quat_exp, quat_mul, quat_normalize, quat_to_R
from skyhaul.geometry.so3 import hat, so3_exp, so3_log
from skyhaul.perception.vio.api import BA, BG, NE, NavState, P, R, V
from skyhaul.perception.vio.imu import GRAVITY_W
from skyhaul.types import Array


@dataclass(frozen=True, eq=False)
class CloneFilter:
    """State, clones and their joint covariance.

    Derivatives are taken at the first estimate of each pose, not at the newest: otherwise the
    filter would believe to learn its heading from its own corrections.
    """

    state: NavState
    first: NavState  # first estimate of the state at its own time
    covariance: Array  # (15 + 6 m, 15 + 6 m)
    clone_k: tuple[int, ...]  # keyframes of the clones
    clone_p: Array  # (m, 3) [m]
    clone_R: Array  # (m, 3, 3)
    first_p: Array  # (m, 3) first estimates
    first_R: Array  # (m, 3, 3)


def start_filter(state: NavState, covariance: Array) -> CloneFilter:
    """A filter without clones."""
    none_p, none_R = np.zeros((0, 3)), np.zeros((0, 3, 3))
    return CloneFilter(state, state, covariance, (), none_p, none_R, none_p, none_R)


def move(
    filter_: CloneFilter, predicted: NavState, Phi: Array, Q: Array, dt_s: float
) -> CloneFilter:
    """Take a prediction over: the state moves, the clones stay.

    Source:    Paper eq. (16); first estimates: Li and Mourikis, IJRR 2013.
    Deviation: Additive in the tangent space, not in the quaternion (PAPER_NOTES 47).
    """
    Phi = _first_estimate_transition(Phi, filter_.first, predicted, dt_s)
    old = filter_.covariance
    new = old.copy()
    new[:NE, :NE] = Phi @ old[:NE, :NE] @ Phi.T + Q
    new[:NE, NE:] = Phi @ old[:NE, NE:]
    new[NE:, :NE] = new[:NE, NE:].T
    return replace(filter_, state=predicted, first=predicted, covariance=_symmetric(new))


def _first_estimate_transition(Phi: Array, first: NavState, to: NavState, dt_s: float) -> Array:
    """Phi with the blocks by the attitude taken from first estimates at both ends."""
    R_i, R_j, out = quat_to_R(first.q_WI), quat_to_R(to.q_WI), Phi.copy()
    dv = to.v_WI - first.v_WI - dt_s * GRAVITY_W
    dp = to.p_WI - first.p_WI - dt_s * first.v_WI - 0.5 * dt_s**2 * GRAVITY_W
    out[R, R] = R_j.T @ R_i
    out[V, R] = -hat(dv) @ R_i
    out[P, R] = -hat(dp) @ R_i
    return out


def clone(filter_: CloneFilter, k: int) -> CloneFilter:
    """Remember the pose of now as that of keyframe k."""
    f, rows = filter_, np.r_[0 : len(filter_.covariance), 0:6]
    pose, first = quat_to_R(f.state.q_WI)[None], quat_to_R(f.first.q_WI)[None]
    return replace(
        f,
        covariance=f.covariance[np.ix_(rows, rows)],
        clone_k=(*f.clone_k, k),
        clone_p=np.vstack([f.clone_p, f.state.p_WI]),
        clone_R=np.concatenate([f.clone_R, pose]),
        first_p=np.vstack([f.first_p, f.first.p_WI]),
        first_R=np.concatenate([f.first_R, first]),
    )


def forget_clone(filter_: CloneFilter, index: int) -> CloneFilter:
    """Drop a clone."""
    f, at = filter_, NE + 6 * index
    keep = np.r_[0:at, at + 6 : len(f.covariance)]
    return replace(
        f,
        covariance=f.covariance[np.ix_(keep, keep)],
        clone_k=f.clone_k[:index] + f.clone_k[index + 1 :],
        clone_p=np.delete(f.clone_p, index, axis=0),
        clone_R=np.delete(f.clone_R, index, axis=0),
        first_p=np.delete(f.first_p, index, axis=0),
        first_R=np.delete(f.first_R, index, axis=0),
    )


def correct(filter_: CloneFilter, residual: Array, H: Array, sigma: float) -> CloneFilter:
    """Kalman update with independent measurements of one standard deviation, Joseph form.

    Args:
        filter_: Before.
        residual: Measured minus predicted, (r,).
        H: Derivative of the prediction by the error, (r, 15 + 6 m).
        sigma: Standard deviation of each measurement.

    Source:    Paper eqs (17), (18).
    Deviation: (I - K H) P alone loses symmetry: Joseph form (PAPER_NOTES 47).
    """
    before = filter_.covariance
    if len(residual) > H.shape[1]:  # many measurements: an equal set of fewer
        Q, H = np.linalg.qr(H)
        residual = Q.T @ residual
    noise = sigma**2 * np.eye(len(residual))
    K = np.linalg.solve(H @ before @ H.T + noise, H @ before).T
    I_KH = np.eye(len(before)) - K @ H
    after = I_KH @ before @ I_KH.T + sigma**2 * (K @ K.T)
    return _shift(replace(filter_, covariance=_symmetric(after)), K @ residual)


def rebased(filter_: CloneFilter, state: NavState, covariance: Array) -> CloneFilter:
    """The filter once its state turned out to be another: the clones go along as they depend on it.

    With c = G x + n of what is known of clones and state, G = P_cx P_xx^-1, n stays as it was:
    c += G (x' - x), P_cx' = G P_xx', P_cc' = P_cc - G (P_xx - P_xx') G^T. All first estimates are
    those of now: the old ones are as far off as the state was.

    Args:
        filter_: Before.
        state: What the state is instead.
        covariance: Of its error, (15, 15).
    """
    old, s = filter_.covariance, filter_.state
    G = np.linalg.solve(old[:NE, :NE], old[:NE, NE:]).T
    turn = so3_log(quat_to_R(s.q_WI).T @ quat_to_R(state.q_WI))
    parts = (state.p_WI - s.p_WI, turn, state.v_WI - s.v_WI)
    e = np.concatenate([*parts, state.gyro_bias - s.gyro_bias, state.accel_bias - s.accel_bias])
    new = old.copy()
    new[:NE, :NE] = covariance
    new[NE:, :NE] = G @ covariance
    new[:NE, NE:] = new[NE:, :NE].T
    new[NE:, NE:] -= G @ (old[:NE, :NE] - covariance) @ G.T
    f = _shift(replace(filter_, covariance=_symmetric(new)), np.concatenate([e, G @ e]))
    return replace(f, state=state, first=state, first_p=f.clone_p, first_R=f.clone_R)


def _shift(filter_: CloneFilter, error: Array) -> CloneFilter:
    """Add an error to state and clones."""
    f, s = filter_, filter_.state
    state = NavState(
        s.p_WI + error[P],
        quat_normalize(quat_mul(s.q_WI, quat_exp(error[R]))),
        s.v_WI + error[V],
        s.gyro_bias + error[BG],
        s.accel_bias + error[BA],
    )
    clones = error[NE:].reshape(-1, 6)
    return replace(
        f,
        state=state,
        clone_p=f.clone_p + clones[:, :3],
        clone_R=f.clone_R @ so3_exp(clones[:, 3:]),
    )


def _symmetric(M: Array) -> Array:
    return 0.5 * (M + M.T)
