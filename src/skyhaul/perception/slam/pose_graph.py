# SPDX-License-Identifier: Apache-2.0
"""Graph of the poses of keyframes: odometry between neighbours, loops between places."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from skyhaul.types import Array

CAUCHY = 1.0
"""Where a loop begins to lose weight, in standard deviations."""
_FIRST = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)


@dataclass(frozen=True, eq=False)
class Relation:
    """Pose of keyframe j seen from keyframe i, as measured."""

    i: int
    j: int
    R_ij: Array  # (3, 3)
    p_ij: Array  # (3,) [m], axes of i
    covariance: Array  # (6, 6) of the error (p, R) in axes of j


def optimize_poses(
    poses: tuple[Array, Array], odometry: Sequence[Relation], loops: Sequence[Relation]
) -> tuple[Array, Array]:
    """Poses that agree best with all relations; the first one stays.

    Minimises the squares of the odometry's errors and Cauchy's loss of those of the loops, so
    that a wrong loop is outvoted.

    Args:
        poses: R_WI (n, 3, 3) and p_WI (n, 3) [m] to start from.
        odometry: Relations that hold.
        loops: Relations that may be wrong.

    Returns:
        R_WI (n, 3, 3) and p_WI (n, 3) [m].
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, (R, p) in enumerate(zip(*poses, strict=True)):
        values.insert(k, gtsam.Pose3(gtsam.Rot3(R), p))
    graph.add(gtsam.PriorFactorPose3(0, values.atPose3(0), _FIRST))
    for relation in odometry:
        graph.add(_factor(relation, robust=False))
    for relation in loops:
        graph.add(_factor(relation, robust=True))
    best = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    found = [best.atPose3(k) for k in range(len(poses[1]))]
    return (
        np.array([x.rotation().matrix() for x in found]),
        np.array([x.translation() for x in found]),
    )


def correction(old: tuple[Array, Array], new: tuple[Array, Array]) -> tuple[Array, Array]:
    """R_MW and p_MW that take a keyframe's odometry pose to its place on the map.

    T_MW = T_MI T_WI^-1: what is added to the odometry, which itself stays smooth and causal.

    Args:
        old: R_WI (3, 3), p_WI (3,) [m] of the odometry.
        new: R_MI, p_MI of the graph.
    """
    R_MW = new[0] @ old[0].T
    return R_MW, new[1] - R_MW @ old[1]


def _factor(relation: Relation, *, robust: bool) -> gtsam.BetweenFactorPose3:
    order = np.r_[3:6, 0:3]  # GTSAM's tangent is (R, p)
    noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(
        relation.covariance[np.ix_(order, order)]
    )
    if robust:
        noise = gtsam.noiseModel.Robust.Create(
            gtsam.noiseModel.mEstimator.Cauchy.Create(CAUCHY), noise
        )
    pose = gtsam.Pose3(gtsam.Rot3(relation.R_ij), relation.p_ij)
    return gtsam.BetweenFactorPose3(relation.i, relation.j, pose, noise)
