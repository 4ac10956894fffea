# SPDX-License-Identifier: Apache-2.0
"""Compiles the kernels, so that the first frame is as quick as the others."""

import numpy as np

from skyhaul.perception.vio.api import CameraRig, NavState
from skyhaul.perception.vio.imu import ImuNoise, advance
from skyhaul.perception.vio.pose_update import Sights, TukeyPose, bearings, update_pose
from skyhaul.perception.vio.triangulation import locate


def warm_up(rig: CameraRig) -> None:
    """Call every kernel once, on made-up numbers."""
    nothing = NavState(np.zeros(3), np.array([1.0, 0, 0, 0]), *np.zeros((3, 3)))
    advance(nothing, np.array([[0.01, 0, 0, 0, 0, 0, 9.81]]), ImuNoise().densities())
    xy = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [-0.1, 0.1]])
    points = (np.column_stack([xy, np.ones(4)]) - rig.p_IC[0]) @ rig.R_IC[0].T
    sights = Sights(points, bearings(xy), np.zeros(4, dtype=np.int64), np.full(4, 1e-3))
    update_pose(TukeyPose(), rig, (np.zeros(3), np.eye(3)), sights)
    locate(np.stack([np.eye(3)] * 2), np.array([[0.0, 0, 0], [1.0, 0, 0]]), xy[:2])
