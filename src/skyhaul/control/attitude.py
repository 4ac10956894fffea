# SPDX-License-Identifier: Apache-2.0
"""Geometric attitude control of a quadrotor on SO(3)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skyhaul.control.vectors import scaled
from skyhaul.geometry.kernels import Vec, Vec3Out, cross, mat_t_vec, mat_vec, norm
from skyhaul.geometry.so3 import vee
from skyhaul.jit import njit
from skyhaul.params import Params
from skyhaul.types import Array


@dataclass(frozen=True, kw_only=True)
class AttitudeGains(Params):
    """Gains of `attitude_moment`."""

    k_R: float = 0.60
    """Stiffness [N m/rad]."""
    k_w: float = 0.06
    """Damping [N m s/rad]."""

    def __post_init__(self) -> None:
        if not (self.k_R > 0.0 and self.k_w > 0.0):
            raise ValueError(f"gains must be positive, got k_R={self.k_R}, k_w={self.k_w}")


class AttitudeRef(NamedTuple):
    """Desired attitude D and its motion. A leading (...) axis is one row per quadrotor."""

    R_WD: Array  # (..., 3, 3)
    w_WD_D: Array  # (..., 3) [rad/s]
    dw_WD_D: Array  # (..., 3) [rad/s^2]


def attitude_moment(
    R_WB: Array, w_WB_B: Array, ref: AttitudeRef, J_B: Array, gains: AttitudeGains
) -> Array:
    """Moment that turns the body B towards the desired attitude D.

    tau_B = -k_R e_R - k_w e_w + w x J w - J (w x R_BD w_D - R_BD dw_D)

    Args:
        R_WB: Attitude of the body, (..., 3, 3).
        w_WB_B: Angular velocity of the body, in body axes, (..., 3) [rad/s].
        ref: Desired motion, same leading axes.
        J_B: Inertia about the centre of mass, in body axes, (3, 3) [kg m^2].
        gains: Controller gains.

    Returns:
        Moment on the body, in body axes, (..., 3) [N m].

    Source:
        Paper eq. (29); Lee, Leok & McClamroch, CDC 2010.

    Deviation:
        Eq. (29) adds the two error terms; with these error definitions that is unstable.
        We subtract them, as Lee et al. do. See `test_moment_opposes_a_small_attitude_error`.
    """
    R_BD = np.swapaxes(R_WB, -1, -2) @ ref.R_WD
    w_D_B = _rotate(R_BD, ref.w_WD_D)
    dw_D_B = _rotate(R_BD, ref.dw_WD_D)

    e_R = 0.5 * vee(np.swapaxes(R_BD, -1, -2) - R_BD)
    e_w = w_WB_B - w_D_B

    gyroscopic = np.cross(w_WB_B, w_WB_B @ J_B.T)
    feedforward = (np.cross(w_WB_B, w_D_B) - dw_D_B) @ J_B.T
    moment: Array = -gains.k_R * e_R - gains.k_w * e_w + gyroscopic - feedforward
    return moment


def _rotate(R: Array, v: Array) -> Array:
    """R v for stacks: (..., 3, 3), (..., 3) -> (..., 3)."""
    return np.squeeze(R @ v[..., None], axis=-1)


@njit
def attitude_moment_kernel(
    R_WB: Array,
    w_WB_B: Vec,
    goal: tuple[Array, Vec3Out, Vec3Out],
    J_B: Vec,
    gains: tuple[Vec3Out, Vec3Out],
) -> Vec3Out:
    """`attitude_moment` for one body with principal axes, in numba.

    Args:
        R_WB: Attitude of the body, (3, 3).
        w_WB_B: Angular velocity, body axes [rad/s].
        goal: R_WD (3, 3), w_WD_D [rad/s], dw_WD_D [rad/s^2].
        J_B: Principal inertia [kg m^2].
        gains: k_R [N m/rad] and k_w [N m s/rad], one of each per axis.
    """
    R_WD, w_D, dw_D = goal
    k_R, k_w = gains
    w_D_B = mat_t_vec(R_WB, mat_vec(R_WD, w_D))
    dw_D_B = mat_t_vec(R_WB, mat_vec(R_WD, dw_D))
    # e_R = 1/2 vee(R_D^T R - R^T R_D) = 1/2 sum of the cross products of D's axes with B's, in B
    ex = cross(_column(R_WD, 0), _column(R_WB, 0))
    ey = cross(_column(R_WD, 1), _column(R_WB, 1))
    ez = cross(_column(R_WD, 2), _column(R_WB, 2))
    e_R = mat_t_vec(R_WB, (ex[0] + ey[0] + ez[0], ex[1] + ey[1] + ez[1], ex[2] + ey[2] + ez[2]))
    gyroscopic = cross(w_WB_B, (J_B[0] * w_WB_B[0], J_B[1] * w_WB_B[1], J_B[2] * w_WB_B[2]))
    turn = cross(w_WB_B, w_D_B)
    return (
        _moment(e_R[0], w_WB_B[0] - w_D_B[0], k_R[0], k_w[0], J_B[0] * (dw_D_B[0] - turn[0]))
        + gyroscopic[0],
        _moment(e_R[1], w_WB_B[1] - w_D_B[1], k_R[1], k_w[1], J_B[1] * (dw_D_B[1] - turn[1]))
        + gyroscopic[1],
        _moment(e_R[2], w_WB_B[2] - w_D_B[2], k_R[2], k_w[2], J_B[2] * (dw_D_B[2] - turn[2]))
        + gyroscopic[2],
    )


@njit
def _moment(e_R: float, e_w: float, k_R: float, k_w: float, feedforward: float) -> float:
    """One axis: -k_R e_R - k_w e_w + feedforward."""
    return -0.5 * k_R * e_R - k_w * e_w + feedforward


@njit
def _column(R: Array, j: int) -> Vec3Out:
    return R[0, j], R[1, j], R[2, j]


@njit
def desired_attitude(b3: Vec3Out, yaw: float, out: Array) -> None:
    """Attitude whose z axis is b3 and whose x axis points to a heading, into `out`, (3, 3).

    b2 = b3 x h / |b3 x h|, b1 = b2 x b3, h = (cos yaw, sin yaw, 0)

    Args:
        b3: Direction of the thrust, unit, W axes; not along h.
        yaw: Heading [rad].
        out: R_WD, written.
    """
    side = cross(b3, (np.cos(yaw), np.sin(yaw), 0.0))
    b2 = scaled(1.0 / max(norm(side), 1e-6), side)
    b1 = cross(b2, b3)
    for j in range(3):
        out[j, 0], out[j, 1], out[j, 2] = b1[j], b2[j], b3[j]
