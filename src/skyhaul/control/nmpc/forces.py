# SPDX-License-Identifier: Apache-2.0
"""Cable forces and thrusts of the team, given the load and the controlled forces z.

The forces of the cables are f = Z z + R (L [R^T F; m] + f_L) with F = T_F z, m the last rows of
T_y z: with Z = 1 every cable force is free, with Z = 0 they are the shares of a wrench.
"""

from typing import NamedTuple

import numpy as np

from skyhaul.control.nmpc.load_step import (
    LoadParams,
    LoadStep,
    angular_acceleration,
    empty_load_step,
)
from skyhaul.jit import njit
from skyhaul.types import Array


class InputMap(NamedTuple):
    """How the controlled forces z act, see the module."""

    T_F: Array  # (3, nz) force on the load, W axes
    T_y: Array  # (12, nz) moment inputs of `load_step`
    Z: Array  # (3n, nz)
    L: Array  # (3n, 6)
    f_L: Array  # (3n,) [N]
    shares: bool  # whether L and f_L act at all
    moves: Array  # (nz,) 1, or 0 where z stays as it is


class StageParams(NamedTuple):
    """Model, limits and weights of every stage."""

    load: LoadParams
    m_B: Array  # (n,) [kg]
    length: Array  # (n,) [m]
    p_LA: Array  # (n, 3) [m]
    thrust_max: Array  # (n,) [N]
    tension_min: float  # [N]
    cos_cone: float
    cos_tilt: float
    speed_max: float  # [m/s]
    w_x: Array  # (12,) weight of the load error, per second
    w_z: Array  # (nz,) of z - z_ref, per second
    w_u: Array  # (nz,) of the rate - its reference, per second
    w_bend: float  # of the second derivative of the force on the load, per second
    w_end: Array  # (12,) weight of the load error at the end
    dt: Array  # (N,) [s]


class Scratch(NamedTuple):
    """Memory of `linearise`."""

    step: LoadStep
    S: Array
    work: Array
    R: Array
    y: Array
    y1: Array
    f: Array  # (n, 3)
    by_z: Array  # (3n, nz)
    by_phi: Array  # (3n, 3)
    g: Array  # (6, nz) of `cable_forces`
    Jr: Array
    J_e: Array  # (12, 12)


def make_scratch(n: int, nz: int) -> Scratch:
    """Memory for n cables and nz controlled forces."""
    return Scratch(
        step=empty_load_step(),
        S=np.zeros((6, 30)),
        work=np.zeros((7, 12)),
        R=np.zeros((3, 3)),
        y=np.zeros(12),
        y1=np.zeros(12),
        f=np.zeros((n, 3)),
        by_z=np.zeros((3 * n, nz)),
        by_phi=np.zeros((3 * n, 3)),
        g=np.zeros((6, nz)),
        Jr=np.zeros((3, 3)),
        J_e=np.zeros((12, 12)),
    )


@njit
def multiply(M: Array, v: Array, out: Array) -> None:
    """M v into `out`."""
    for a in range(M.shape[0]):
        total = 0.0
        for b in range(M.shape[1]):
            total += M[a, b] * v[b]
        out[a] = total


@njit
def cable_forces(im: InputMap, R: Array, z: Array, mem: Scratch) -> None:
    """Forces on the load into `mem.f`, (n, 3) [N], derivatives into `mem.by_z`, `mem.by_phi`."""
    n, nz = mem.f.shape[0], z.shape[0]
    for j in range(3 * n):
        total = 0.0
        for c in range(nz):
            total += im.Z[j, c] * z[c]
            mem.by_z[j, c] = im.Z[j, c]
        mem.f[j // 3, j % 3] = total
        for a in range(3):
            mem.by_phi[j, a] = 0.0
    if not im.shares:
        return
    F, w, g = np.empty(3), np.empty(6), mem.g
    multiply(im.T_F, z, F)
    for a in range(3):
        w[a] = R[0, a] * F[0] + R[1, a] * F[1] + R[2, a] * F[2]
        w[3 + a] = 0.0
        for c in range(nz):
            g[a, c] = R[0, a] * im.T_F[0, c] + R[1, a] * im.T_F[1, c] + R[2, a] * im.T_F[2, c]
            g[3 + a, c] = im.T_y[9 + a, c]
            w[3 + a] += im.T_y[9 + a, c] * z[c]
    for i in range(n):
        _share(im, R, (w[0], w[1], w[2]), w, i, mem)


@njit
def _share(
    im: InputMap, R: Array, F_L: tuple[float, float, float], w: Array, i: int, mem: Scratch
) -> None:
    """Adds the part of cable i that turns with the load."""
    h, by_phi = np.empty(3), np.empty((3, 3))
    for a in range(3):
        L = im.L[3 * i + a]
        h[a] = im.f_L[3 * i + a]
        for j in range(6):
            h[a] += L[j] * w[j]
        # d(R^T F) = (R^T F) x phi
        by_phi[a, 0] = L[1] * F_L[2] - L[2] * F_L[1]
        by_phi[a, 1] = L[2] * F_L[0] - L[0] * F_L[2]
        by_phi[a, 2] = L[0] * F_L[1] - L[1] * F_L[0]
    # d(R h) = R (phi x h)
    by_phi[0, 1] += h[2]
    by_phi[0, 2] -= h[1]
    by_phi[1, 0] -= h[2]
    by_phi[1, 2] += h[0]
    by_phi[2, 0] += h[1]
    by_phi[2, 1] -= h[0]
    for a in range(3):
        row = 3 * i + a
        for b in range(3):
            mem.f[i, a] += R[a, b] * h[b]
            for c in range(3):
                mem.by_phi[row, c] += R[a, b] * by_phi[b, c]
            for c in range(mem.by_z.shape[1]):
                for j in range(6):
                    mem.by_z[row, c] += R[a, b] * im.L[3 * i + b, j] * mem.g[j, c]


@njit
def load_accelerations(
    s: StageParams, im: InputMap, x: Array, z: Array, R: Array, out: Array
) -> None:
    """Acceleration (W axes) and angular acceleration (L axes) of the load into `out`, (6,)."""
    y, F = np.empty(12), np.empty(3)
    multiply(im.T_F, z, F)
    multiply(im.T_y, z, y)
    out[3:6] = 0.0
    if s.load.rigid:
        angular_acceleration(s.load, R, x[10:13], y, out[3:6])
    for a in range(3):
        out[a] = F[a] / s.load.m
    out[2] -= s.load.g


@njit
def thrust_vector(
    s: StageParams, x: Array, R: Array, accel: Array, bend: Array, f: Array, i: int, out: Array
) -> None:
    """Thrust of vehicle i in W axes into `out`, (3,) [N]: m (a_hook + l bend + g e3) + f.

    `accel` is (6,) of `load_accelerations`, `bend` the second derivative of the direction of the
    cable force, (3,); the vehicle stands at hook + l f/|f|.
    """
    r, w = s.p_LA[i], x[10:13]
    wr0, wr1, wr2 = w[1] * r[2] - w[2] * r[1], w[2] * r[0] - w[0] * r[2], w[0] * r[1] - w[1] * r[0]
    h0 = accel[4] * r[2] - accel[5] * r[1] + w[1] * wr2 - w[2] * wr1
    h1 = accel[5] * r[0] - accel[3] * r[2] + w[2] * wr0 - w[0] * wr2
    h2 = accel[3] * r[1] - accel[4] * r[0] + w[0] * wr1 - w[1] * wr0
    for a in range(3):
        hook = accel[a] + R[a, 0] * h0 + R[a, 1] * h1 + R[a, 2] * h2
        out[a] = s.m_B[i] * (hook + s.length[i] * bend[a]) + f[a]
    out[2] += s.m_B[i] * s.load.g
