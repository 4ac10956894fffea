# SPDX-License-Identifier: Apache-2.0
"""Dual active-set quadratic programming for the tension distribution; cuts come one by one."""

from typing import NamedTuple

import numpy as np

from skyhaul.jit import njit
from skyhaul.types import Array, IntArray

MAX_ACTIVE = 24
_TINY = 1e-12


class Cuts(NamedTuple):
    """The problem min 1/2 d^T H d under the cuts added so far, and the state of its solver.

    H = I + P^T W P over the components of the active cables, d = f - f_0.
    """

    arm: Array  # (n, 3) hooks from the centre of mass, W axes [m]
    active: Array  # (n,) 1 or 0
    core: Array  # (6, 6) (W^-1 + P P^T)^-1: H^-1 = I - P^T core P
    normal: Array  # (MAX_ACTIVE, 3n) gradients of the active cuts
    step: Array  # (MAX_ACTIVE, 3n) H^-1 times them
    gram: Array  # (MAX_ACTIVE, MAX_ACTIVE) normal H^-1 normal^T, lower triangle
    dual: Array  # (MAX_ACTIVE,) their multipliers
    used: IntArray  # (1,) how many are active


@njit
def new_cuts(arm: Array, weight: Array, active: Array) -> Cuts:
    """The problem without cuts; weight (6,) is the diagonal of W."""
    n = arm.shape[0]
    core = np.zeros((6, 6))
    for j in range(6):
        core[j, j] = 1.0 / weight[j]
    for i in range(n):
        if active[i] != 0.0:
            _add_outer(core, arm[i])
    _invert(core)
    return Cuts(
        arm,
        active,
        core,
        np.zeros((MAX_ACTIVE, 3 * n)),
        np.zeros((MAX_ACTIVE, 3 * n)),
        np.zeros((MAX_ACTIVE, MAX_ACTIVE)),
        np.zeros(MAX_ACTIVE),
        np.zeros(1, dtype=np.int64),
    )


@njit
def _add_outer(M: Array, r: Array) -> None:
    """Add P_i P_i^T of one cable: [I, -hat(r); hat(r), -hat(r)^2]."""
    x, y, z = r[0], r[1], r[2]
    for j in range(3):
        M[j, j] += 1.0
    M[0, 4] += z
    M[0, 5] -= y
    M[1, 3] -= z
    M[1, 5] += x
    M[2, 3] += y
    M[2, 4] -= x
    M[4, 0] += z
    M[5, 0] -= y
    M[3, 1] -= z
    M[5, 1] += x
    M[3, 2] += y
    M[4, 2] -= x
    M[3, 3] += y * y + z * z
    M[4, 4] += x * x + z * z
    M[5, 5] += x * x + y * y
    M[3, 4] -= x * y
    M[4, 3] -= x * y
    M[3, 5] -= x * z
    M[5, 3] -= x * z
    M[4, 5] -= y * z
    M[5, 4] -= y * z


@njit
def _invert(A: Array) -> None:
    """Invert a symmetric positive definite matrix in place (Gauss-Jordan)."""
    n = A.shape[0]
    for k in range(n):
        pivot = 1.0 / A[k, k]
        A[k, k] = 1.0
        for j in range(n):
            A[k, j] *= pivot
        for i in range(n):
            if i != k:
                factor = A[i, k]
                A[i, k] = 0.0
                for j in range(n):
                    A[i, j] -= factor * A[k, j]


@njit
def _inverse_hessian(cuts: Cuts, g: Array, out: Array) -> None:
    """H^-1 g into `out`; both (3n,), zero at idle cables."""
    n = cuts.arm.shape[0]
    w0 = w1 = w2 = w3 = w4 = w5 = 0.0
    for i in range(n):
        a, b, c = g[3 * i], g[3 * i + 1], g[3 * i + 2]
        x, y, z = cuts.arm[i, 0], cuts.arm[i, 1], cuts.arm[i, 2]
        w0, w1, w2 = w0 + a, w1 + b, w2 + c
        w3, w4, w5 = w3 + y * c - z * b, w4 + z * a - x * c, w5 + x * b - y * a
    C = cuts.core
    v0 = C[0, 0] * w0 + C[0, 1] * w1 + C[0, 2] * w2 + C[0, 3] * w3 + C[0, 4] * w4 + C[0, 5] * w5
    v1 = C[1, 0] * w0 + C[1, 1] * w1 + C[1, 2] * w2 + C[1, 3] * w3 + C[1, 4] * w4 + C[1, 5] * w5
    v2 = C[2, 0] * w0 + C[2, 1] * w1 + C[2, 2] * w2 + C[2, 3] * w3 + C[2, 4] * w4 + C[2, 5] * w5
    v3 = C[3, 0] * w0 + C[3, 1] * w1 + C[3, 2] * w2 + C[3, 3] * w3 + C[3, 4] * w4 + C[3, 5] * w5
    v4 = C[4, 0] * w0 + C[4, 1] * w1 + C[4, 2] * w2 + C[4, 3] * w3 + C[4, 4] * w4 + C[4, 5] * w5
    v5 = C[5, 0] * w0 + C[5, 1] * w1 + C[5, 2] * w2 + C[5, 3] * w3 + C[5, 4] * w4 + C[5, 5] * w5
    for i in range(n):
        on = cuts.active[i]
        x, y, z = cuts.arm[i, 0], cuts.arm[i, 1], cuts.arm[i, 2]
        out[3 * i] = on * (g[3 * i] - v0 - (v4 * z - v5 * y))
        out[3 * i + 1] = on * (g[3 * i + 1] - v1 - (v5 * x - v3 * z))
        out[3 * i + 2] = on * (g[3 * i + 2] - v2 - (v3 * y - v4 * x))


@njit
def add_cut(cuts: Cuts, gradient: Array, value: float, f: Array) -> bool:
    """Move the optimum f to that with one more cut: value + gradient . (f' - f) >= 0.

    Args:
        cuts: The problem; its active set is changed.
        gradient: Gradient of the cut, (n, 3).
        value: Its value at f, negative [N].
        f: The optimum so far, (n, 3); changed.

    Returns:
        False if no point keeps the cuts together (f is then where the method stopped).

    Source: Goldfarb, Idnani, Mathematical Programming 27 (1983), algorithm 1.
    """
    n3 = 3 * f.shape[0]
    g = gradient.reshape(n3).copy()
    hg, z = np.empty(n3), np.empty(n3)
    r, along = np.zeros(MAX_ACTIVE), np.zeros(MAX_ACTIVE)
    _inverse_hessian(cuts, g, hg)
    scale = _dot(g, hg)
    for j in range(cuts.used[0]):
        along[j] = _dot(cuts.normal[j], hg)
    flat = f.reshape(n3)
    dual_new = 0.0
    for _ in range(4 * MAX_ACTIVE):
        m = cuts.used[0]
        _coefficients(cuts, along, r)
        for c in range(n3):
            z[c] = hg[c]
            for j in range(m):
                z[c] -= cuts.step[j, c] * r[j]
        gain = _dot(z, g)
        t_dual, drop = np.inf, -1
        for j in range(m):
            if r[j] > _TINY and cuts.dual[j] / r[j] < t_dual:
                t_dual, drop = cuts.dual[j] / r[j], j
        solvable = gain > 1e-9 * scale and m < MAX_ACTIVE
        t_full = -value / gain if solvable else np.inf
        t = min(t_dual, t_full)
        if t == np.inf:
            return False
        for j in range(m):
            cuts.dual[j] -= t * r[j]
        dual_new += t
        if solvable:
            for c in range(n3):
                flat[c] += t * z[c]
            value += t * gain
        if t == t_full:
            cuts.normal[m], cuts.step[m] = g, hg
            cuts.gram[m, :m], cuts.gram[m, m] = along[:m], scale
            cuts.dual[m] = dual_new
            cuts.used[0] = m + 1
            return True
        _drop(cuts, along, drop)
    return False


@njit
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for c in range(a.shape[0]):
        total += a[c] * b[c]
    return total


@njit
def _coefficients(cuts: Cuts, along: Array, r: Array) -> None:
    """Into `r`: (N^T H^-1 N)^-1 N^T H^-1 g, by Cholesky; `along` is N^T H^-1 g."""
    m = cuts.used[0]
    L = np.empty((m, m))
    for a in range(m):
        for b in range(a + 1):
            s = cuts.gram[a, b]
            for k in range(b):
                s -= L[a, k] * L[b, k]
            L[a, b] = np.sqrt(max(s, 1e-18)) if a == b else s / L[b, b]
    for a in range(m):
        r[a] = along[a]
        for k in range(a):
            r[a] -= L[a, k] * r[k]
        r[a] /= L[a, a]
    for a in range(m - 1, -1, -1):
        for k in range(a + 1, m):
            r[a] -= L[k, a] * r[k]
        r[a] /= L[a, a]


@njit
def _drop(cuts: Cuts, along: Array, j: int) -> None:
    """Take one cut out of the active set; the last one takes its place."""
    last = cuts.used[0] - 1
    cuts.normal[j], cuts.step[j] = cuts.normal[last], cuts.step[last]
    cuts.dual[j], along[j] = cuts.dual[last], along[last]
    for k in range(last):
        if k < j:
            cuts.gram[j, k] = cuts.gram[last, k]
        elif k > j:
            cuts.gram[k, j] = cuts.gram[last, k]
    cuts.gram[j, j] = cuts.gram[last, last]
    cuts.used[0] = last
