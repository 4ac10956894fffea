# SPDX-License-Identifier: Apache-2.0
"""The load over one interval of the horizon, with its exact first derivatives.

The cables enter only through the force F on the load (W axes) and the moment inputs y = (G, m):
M_L = vee(R^T G - (R^T G)^T) + m with G = sum_i f_i r_i^T (f_i in W, r_i in L axes), so the cost of
a step does not grow with the number of cables. F and y run linearly over the interval.
Translation is integrated in closed form. Rotation is integrated by a kick-drift-kick scheme on
SO(3), free of drift for the stiff swing of the load under its hooks and of second order but for
the gyroscopic term; its derivatives are those of the scheme itself. Drag and wind are not here:
whoever gives the cable forces adds what makes up for them.
"""

import math
from typing import NamedTuple

import numpy as np

from skyhaul.geometry.kernels import quat_exp, quat_mul, quat_to_R
from skyhaul.jit import njit
from skyhaul.types import Array

N_MOMENT = 12
"""Entries of y: G by rows (world axis, load axis), then m."""
SUBSTEP_S = 0.025
"""Longest rotation sub-step [s]."""


class LoadParams(NamedTuple):
    """The load as the kernels see it."""

    m: float  # [kg]
    J: Array  # (3,) principal inertia, L axes [kg m^2]
    rigid: bool  # False: the attitude stays as it is
    g: float  # [m/s^2]


class LoadStep(NamedTuple):
    """Result of `load_step`, reused from call to call."""

    x: Array  # (13,) load state after the interval
    A: Array  # (12, 12) by the load error before it
    y: Array  # (6, 24) attitude and rate error by y at its start and by the rate of y


def empty_load_step() -> LoadStep:
    """Memory for `load_step`."""
    return LoadStep(np.zeros(13), np.zeros((12, 12)), np.zeros((6, 2 * N_MOMENT)))


@njit
def angular_acceleration(load: LoadParams, R: Array, w: Array, y: Array, out: Array) -> None:
    """dw/dt = J^-1 (M_L - w x J w) into `out`, (3,) [rad/s^2]."""
    J, g = load.J, y
    b21 = R[0, 2] * g[1] + R[1, 2] * g[4] + R[2, 2] * g[7]
    b12 = R[0, 1] * g[2] + R[1, 1] * g[5] + R[2, 1] * g[8]
    b02 = R[0, 0] * g[2] + R[1, 0] * g[5] + R[2, 0] * g[8]
    b20 = R[0, 2] * g[0] + R[1, 2] * g[3] + R[2, 2] * g[6]
    b10 = R[0, 1] * g[0] + R[1, 1] * g[3] + R[2, 1] * g[6]
    b01 = R[0, 0] * g[1] + R[1, 0] * g[4] + R[2, 0] * g[7]
    out[0] = (b21 - b12 + y[9] - (J[2] - J[1]) * w[1] * w[2]) / J[0]
    out[1] = (b02 - b20 + y[10] - (J[0] - J[2]) * w[2] * w[0]) / J[1]
    out[2] = (b10 - b01 + y[11] - (J[1] - J[0]) * w[0] * w[1]) / J[2]


@njit
def moment_by_attitude(R: Array, y: Array, out: Array) -> None:
    """dM_L/dphi = B - tr(B) 1 with B = R^T G, for R Exp(phi), into `out`, (3, 3)."""
    for a in range(3):
        for b in range(3):
            out[a, b] = R[0, a] * y[b] + R[1, a] * y[3 + b] + R[2, a] * y[6 + b]
    trace = out[0, 0] + out[1, 1] + out[2, 2]
    for a in range(3):
        out[a, a] -= trace


@njit
def moment_by_input(R: Array, out: Array) -> None:
    """dM_L/dy into `out`, (3, 12)."""
    out[:] = 0.0
    for c in range(3):
        out[0, 3 * c + 1], out[0, 3 * c + 2] = R[c, 2], -R[c, 1]
        out[1, 3 * c + 2], out[1, 3 * c] = R[c, 0], -R[c, 2]
        out[2, 3 * c], out[2, 3 * c + 1] = R[c, 1], -R[c, 0]
        out[c, 9 + c] = 1.0


@njit
def _kick(
    load: LoadParams, R: Array, w: Array, y: Array, t: float, h: float, S: Array, work: Array
) -> None:
    """W += h dw/dt in place, with its derivatives S, (6, 30): by phi, w, y and the rate of y."""
    J = load.J
    D, By, rate = work[:3, :3], work[3:6, :12], work[6, :3]
    moment_by_attitude(R, y, D)
    moment_by_input(R, By)
    angular_acceleration(load, R, w, y, rate)
    k0, k1, k2 = h / J[0], h / J[1], h / J[2]
    g0, g1, g2 = J[2] - J[1], J[0] - J[2], J[1] - J[0]
    for c in range(S.shape[1]):
        f0, f1, f2, s0, s1, s2 = S[0, c], S[1, c], S[2, c], S[3, c], S[4, c], S[5, c]
        m0 = D[0, 0] * f0 + D[0, 1] * f1 + D[0, 2] * f2 - g0 * (w[2] * s1 + w[1] * s2)
        m1 = D[1, 0] * f0 + D[1, 1] * f1 + D[1, 2] * f2 - g1 * (w[0] * s2 + w[2] * s0)
        m2 = D[2, 0] * f0 + D[2, 1] * f1 + D[2, 2] * f2 - g2 * (w[1] * s0 + w[0] * s1)
        if c >= 18:
            m0 += t * By[0, c - 18]
            m1 += t * By[1, c - 18]
            m2 += t * By[2, c - 18]
        elif c >= 6:
            m0 += By[0, c - 6]
            m1 += By[1, c - 6]
            m2 += By[2, c - 6]
        S[3, c], S[4, c], S[5, c] = s0 + k0 * m0, s1 + k1 * m1, s2 + k2 * m2
    for a in range(3):
        w[a] += h * rate[a]


@njit
def right_jacobian(phi: Array, out: Array) -> None:
    """Jr(phi): Exp(phi + d) = Exp(phi) Exp(Jr d), into `out`, (3, 3)."""
    a2 = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if a2 < 1e-6:
        b, c = 0.5 - a2 / 24.0, 1.0 / 6.0 - a2 / 120.0
    else:
        a = math.sqrt(a2)
        b, c = (1.0 - math.cos(a)) / a2, (a - math.sin(a)) / (a2 * a)
    _series(phi, -b, c, a2, out)


@njit
def right_jacobian_inverse(phi: Array, out: Array) -> None:
    """Jr(phi)^-1: Log(Exp(phi) Exp(d)) = phi + Jr^-1 d, into `out`, (3, 3)."""
    a2 = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if a2 < 1e-6:
        c = 1.0 / 12.0 + a2 / 720.0
    else:
        a = math.sqrt(a2)
        c = 1.0 / a2 - 0.5 * (1.0 + math.cos(a)) / (a * math.sin(a))
    _series(phi, 0.5, c, a2, out)


@njit
def _series(phi: Array, b: float, c: float, a2: float, out: Array) -> None:
    """1 + b hat(phi) + c hat(phi)^2."""
    for i in range(3):
        for j in range(3):
            out[i, j] = c * phi[i] * phi[j]
        out[i, i] += 1.0 - c * a2
    out[0, 1] -= b * phi[2]
    out[1, 0] += b * phi[2]
    out[0, 2] += b * phi[1]
    out[2, 0] -= b * phi[1]
    out[1, 2] -= b * phi[0]
    out[2, 1] += b * phi[0]


@njit
def _drift(q: Array, R: Array, w: Array, h: float, S: Array, work: Array) -> None:
    """Q <- q Exp(h w) in place, R likewise, with the derivatives S."""
    E, Jr, phi = work[:3, :3], work[:3, 3:6], work[3, :3]
    for a in range(3):
        phi[a] = h * w[a]
    step = quat_exp(phi)
    right_jacobian(phi, Jr)
    quat_to_R(step, E)
    turned = quat_mul(q, step)
    scale = 1.0 / math.sqrt(
        turned[0] * turned[0]
        + turned[1] * turned[1]
        + turned[2] * turned[2]
        + turned[3] * turned[3]
    )
    for a in range(4):
        q[a] = scale * turned[a]
    quat_to_R(q, R)
    for c in range(S.shape[1]):
        f0, f1, f2, s0, s1, s2 = S[0, c], S[1, c], S[2, c], S[3, c], S[4, c], S[5, c]
        for a in range(3):
            spin = Jr[a, 0] * s0 + Jr[a, 1] * s1 + Jr[a, 2] * s2
            S[a, c] = E[0, a] * f0 + E[1, a] * f1 + E[2, a] * f2 + h * spin


@njit
def load_step(
    load: LoadParams,
    x: Array,
    inputs: tuple[Array, Array, Array, Array],
    dt: float,
    work: tuple[Array, Array, Array, Array],
    out: LoadStep,
) -> None:
    """Load state after one interval and its derivatives, into `out`.

    Args:
        load: The load.
        x: Load state, (13,).
        inputs: F at the start (3,) [N], dF/dt (3,), y at the start (12,), dy/dt (12,).
        dt: Length of the interval [s].
        work: Memory: (6, 30), (7, 12), (3, 3), (12,).
        out: Result; errors are right-sided, q Exp(phi).
    """
    F, dF, y0, dy = inputs
    S, scratch, R, y = work
    c2, c3 = dt * dt / 2.0, dt * dt * dt / 6.0
    out.A[:] = 0.0
    for a in range(3):
        acceleration, jerk = F[a] / load.m, dF[a] / load.m
        if a == 2:
            acceleration -= load.g
        out.x[a] = x[a] + dt * x[7 + a] + c2 * acceleration + c3 * jerk
        out.x[7 + a] = x[7 + a] + dt * acceleration + c2 * jerk
        out.A[a, a], out.A[a, 6 + a], out.A[6 + a, 6 + a] = 1.0, dt, 1.0
    q, w = out.x[3:7], out.x[10:13]
    q[:] = x[3:7]
    w[:] = x[10:13]
    S[:] = 0.0
    for a in range(6):
        S[a, a] = 1.0
    if load.rigid:
        quat_to_R(q, R)
        n = math.ceil(dt / SUBSTEP_S - 1e-9)
        h = dt / n
        for i in range(n):
            for half in range(2):
                t = (i + half) * h
                for a in range(N_MOMENT):
                    y[a] = y0[a] + t * dy[a]
                _kick(load, R, w, y, t, 0.5 * h, S, scratch)
                if half == 0:
                    _drift(q, R, w, h, S, scratch)
    for a in range(3):
        for b in range(3):
            out.A[3 + a, 3 + b], out.A[3 + a, 9 + b] = S[a, b], S[a, 3 + b]
            out.A[9 + a, 3 + b], out.A[9 + a, 9 + b] = S[3 + a, b], S[3 + a, 3 + b]
    out.y[:] = S[:, 6:]
