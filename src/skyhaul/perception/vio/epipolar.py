# SPDX-License-Identifier: Apache-2.0
"""Which pairs of rays agree with one motion of a camera, or with two cameras of a rig."""

import math

import cv2
import numpy as np

from skyhaul.jit import njit
from skyhaul.types import Array, Mask

ROUNDS = 60
"""Pairs of pairs that are tried: with half of the pairs wrong all fail once in 3e7."""


def five_point(a: Array, b: Array, threshold: float) -> Mask:
    """Pairs on the essential matrix that most agree with, (k,): x_b^T E x_a = 0.

    Args:
        a: Rays before, (k, 3), z > 0.
        b: Rays now, (k, 3).
        threshold: Distance from the epipolar line in the normalised image.

    Source:    Nister's five-point method in OpenCV's RANSAC.
    """
    cv2.setRNGSeed(0)
    x_a, x_b = a[:, :2] / a[:, 2:], b[:, :2] / b[:, 2:]
    E, mask = cv2.findEssentialMat(
        x_a, x_b, np.eye(3), method=cv2.RANSAC, prob=0.99, threshold=threshold
    )
    if E is None or mask is None:
        return np.ones(len(a), dtype=np.bool_)
    agree: Mask = np.ravel(mask) == 1
    return agree


def one_translation(a: Array, b: Array, threshold: float) -> Mask:
    """Pairs that agree with the translation that most agree with, (k,): E = [t]x, turn known.

    A pair agrees when b lies within `threshold` of the half plane through a that t opens: on
    the epipolar line, and on the side to which points in front of a moving camera shift.

    Args:
        a: Unit rays before, turned into the axes of now, (k, 3).
        b: Unit rays now, (k, 3).
        threshold: [rad].
    """
    return _one_translation(np.ascontiguousarray(a), np.ascontiguousarray(b), threshold)


def matches_agree(a: Array, b: Array, p: Array, threshold: float) -> Mask:
    """Pairs that two cameras of a rig may have of one point in front of both, (k,).

    Args:
        a: Unit rays of the one camera, turned into the axes of the other, (k, 3).
        b: Unit rays of the other camera, (k, 3).
        p: Place of the one camera in the other one's axes, (3,) [m].
        threshold: [rad].
    """
    t = p / np.linalg.norm(p)
    mask = np.empty(len(a), np.bool_)
    _agree(np.ascontiguousarray(a), np.ascontiguousarray(b), t[0], t[1], t[2], threshold, mask)
    return mask


@njit
def _one_translation(a: Array, b: Array, threshold: float) -> Mask:
    k = len(a)
    best, best_count = np.ones(k, np.bool_), -1
    mask = np.empty(k, np.bool_)
    dice = 12345
    for _ in range(ROUNDS):
        dice = (dice * 1103515245 + 12345) % 2147483648
        i = (dice >> 8) % k
        dice = (dice * 1103515245 + 12345) % 2147483648
        j = (dice >> 8) % k
        if i == j:
            continue
        n0, n1, n2 = _cross(a[i, 0], a[i, 1], a[i, 2], b[i, 0], b[i, 1], b[i, 2])
        m0, m1, m2 = _cross(a[j, 0], a[j, 1], a[j, 2], b[j, 0], b[j, 1], b[j, 2])
        t0, t1, t2 = _cross(n0, n1, n2, m0, m1, m2)
        far = math.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
        if far < 1e-12:
            continue
        for sign in (1.0, -1.0):
            s = sign / far
            count = _agree(a, b, s * t0, s * t1, s * t2, threshold, mask)
            if count > best_count:
                best_count = count
                best[:] = mask
    return best


@njit
def _agree(
    a: Array, b: Array, t0: float, t1: float, t2: float, threshold: float, mask: Mask
) -> int:
    """How many pairs agree with b = a + (something > 0) t, up to length, and which."""
    count = 0
    for i in range(len(a)):
        n0, n1, n2 = _cross(t0, t1, t2, a[i, 0], a[i, 1], a[i, 2])
        far = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        if far < threshold:  # along the translation: nothing can be said
            mask[i] = True
            count += 1
            continue
        off = abs(n0 * b[i, 0] + n1 * b[i, 1] + n2 * b[i, 2]) / far
        # Direction in which the ray shifts: t without its part along a.
        d = t0 * a[i, 0] + t1 * a[i, 1] + t2 * a[i, 2]
        along = (
            (t0 - d * a[i, 0]) * b[i, 0]
            + (t1 - d * a[i, 1]) * b[i, 1]
            + (t2 - d * a[i, 2]) * b[i, 2]
        ) / far
        mask[i] = off <= threshold and along >= -threshold
        count += mask[i]
    return count


@njit
def _cross(
    a0: float, a1: float, a2: float, b0: float, b1: float, b2: float
) -> tuple[float, float, float]:
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
