# SPDX-License-Identifier: Apache-2.0
"""Feedback along a plan: from the error of the load to a correction of its wrench.

Cable forces are held in world axes, so translation is three double integrators and its optimal
gains are closed forms; rotation swings under the hooks with the planned moments, and its gains
come from a Riccati recursion backwards along the plan.
"""

import numpy as np

from skyhaul.control.nmpc.forces import InputMap, StageParams, multiply
from skyhaul.control.nmpc.load_step import moment_by_attitude
from skyhaul.geometry.kernels import quat_to_R
from skyhaul.jit import njit
from skyhaul.types import Array

RICCATI_STEP_S = 0.02
"""Step of the recursion [s]; about the rate at which feedback can act."""
SETTLE_STEPS = 80
"""Steps spent at the end of the plan, where the recursion becomes stationary."""


def translation_gains(bandwidth: Array, damping: float, mass: float) -> tuple[Array, Array]:
    """Stiffness [N/m] and damping [N s/m] of the load's position, (3,) each.

    They are the gains of the regulator that minimises w^4 e^2 + (4 z^2 - 2) w^2 de^2 + dde^2.
    """
    return mass * bandwidth**2, 2.0 * damping * mass * bandwidth


@njit
def rotation_gains(
    s: StageParams,
    im: InputMap,
    x: Array,
    z: Array,
    node: Array,
    weights: tuple[Array, Array],
    out: Array,
) -> None:
    """Gains K of the moment, M_L = K (e_R, e_w), at every node into `out`, (K, 3, 6).

    Minimises the sum of w_R e_R^2 + w_w e_w^2 + |J^-1 M|^2 for d e_R = e_w - w x e_R,
    d e_w = J^-1 (dM/dphi e_R + M) + gyroscopic terms.

    Args:
        s: Parameters of the stages.
        im: How z acts.
        x: Planned load states, (K, 13).
        z: Planned controlled forces, (K, nz).
        node: Times of the nodes, (K,) [s].
        weights: w_R (3,) [1/s^4] and w_w (3,) [1/s^2].
        out: Gains, [N m] per rad and per rad/s.
    """
    last = node.shape[0] - 1
    h = RICCATI_STEP_S
    P, A, B = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 3))
    K, work = np.zeros((3, 6)), (np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((3, 9)))
    for a in range(3):
        P[a, a], P[3 + a, 3 + a] = weights[0][a], weights[1][a]
    _linear_rotation(s, im, x[last], z[last], h, A, B)
    for _ in range(SETTLE_STEPS):
        _riccati_step(P, A, B, h, weights, K, work)
    out[last] = K
    for k in range(last - 1, -1, -1):
        steps = max(1, round((node[k + 1] - node[k]) / h))
        _linear_rotation(s, im, x[k], z[k], (node[k + 1] - node[k]) / steps, A, B)
        for _ in range(steps):
            _riccati_step(P, A, B, (node[k + 1] - node[k]) / steps, weights, K, work)
        out[k] = K
    for k in range(last + 1):
        for a in range(3):
            for c in range(6):
                out[k, a, c] *= s.load.J[a]


@njit
def _linear_rotation(
    s: StageParams, im: InputMap, x: Array, z: Array, h: float, A: Array, B: Array
) -> None:
    """Exp of the error dynamics over h, to third order, and the action of a held dw."""
    C, R, D, y, J = np.zeros((6, 6)), np.empty((3, 3)), np.empty((3, 3)), np.empty(12), s.load.J
    w = x[10:13]
    quat_to_R(x[3:7], R)
    multiply(im.T_y, z, y)
    moment_by_attitude(R, y, D)
    C[0, 1], C[0, 2], C[1, 0], C[1, 2], C[2, 0], C[2, 1] = w[2], -w[1], -w[2], w[0], w[1], -w[0]
    for a in range(3):
        C[a, 3 + a] = 1.0
        for c in range(3):
            C[3 + a, c] = D[a, c] / J[a]
    g0, g1, g2 = (J[2] - J[1]) / J[0], (J[0] - J[2]) / J[1], (J[1] - J[0]) / J[2]
    C[3, 4], C[3, 5] = -g0 * w[2], -g0 * w[1]
    C[4, 3], C[4, 5] = -g1 * w[2], -g1 * w[0]
    C[5, 3], C[5, 4] = -g2 * w[1], -g2 * w[0]
    square, cube = np.zeros((6, 6)), np.zeros((6, 6))
    _product(C, C, square)
    _product(C, square, cube)
    for a in range(6):
        for c in range(6):
            one = 1.0 if a == c else 0.0
            A[a, c] = one + h * (C[a, c] + 0.5 * h * (square[a, c] + h / 3.0 * cube[a, c]))
        for c in range(3):
            one = 1.0 if a == 3 + c else 0.0
            B[a, c] = h * (one + 0.5 * h * (C[a, 3 + c] + h / 3.0 * square[a, 3 + c]))


@njit
def _product(X: Array, Y: Array, out: Array) -> None:
    for a in range(6):
        for c in range(6):
            total = 0.0
            for b in range(6):
                total += X[a, b] * Y[b, c]
            out[a, c] = total


@njit
def _riccati_step(
    P: Array,
    A: Array,
    B: Array,
    h: float,
    weights: tuple[Array, Array],
    K: Array,
    work: tuple[Array, Array, Array],
) -> None:
    """One step backwards: K = -(h + B'PB)^-1 B'PA, P <- h Q + A'P (A + B K)."""
    PA, closed, system = work
    _product(P, A, PA)
    for a in range(3):
        for c in range(6):
            total = 0.0
            for b in range(6):
                total += B[b, a] * PA[b, c]
            system[a, 3 + c] = -total
        for c in range(3):
            total = h if a == c else 0.0
            for i in range(6):
                for j in range(6):
                    total += B[i, a] * P[i, j] * B[j, c]
            system[a, c] = total
    for a in range(3):  # Gauss-Jordan; the matrix is positive definite
        pivot = 1.0 / system[a, a]
        for c in range(9):
            system[a, c] *= pivot
        for b in range(3):
            if b != a:
                factor = system[b, a]
                for c in range(9):
                    system[b, c] -= factor * system[a, c]
    for a in range(3):
        for c in range(6):
            K[a, c] = system[a, 3 + c]
    for a in range(6):
        for c in range(6):
            total = A[a, c]
            for b in range(3):
                total += B[a, b] * K[b, c]
            closed[a, c] = total
    # P (A + B K) = PA + P B K, and A' times that
    _product(P, closed, PA)
    for a in range(6):
        for c in range(a, 6):
            total = 0.0
            for b in range(6):
                total += A[b, a] * PA[b, c]
            if a == c:
                total += h * (weights[0][a] if a < 3 else weights[1][a - 3])
            P[a, c] = total
            P[c, a] = total
