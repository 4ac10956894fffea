# SPDX-License-Identifier: Apache-2.0
"""Optical flow of a rendered frame, from poses, velocities and ranges."""

import math

from skyhaul.geometry.kernels import mat_t_vec
from skyhaul.jit import njit_ieee
from skyhaul.sensors.imaging.arrays import SceneArrays
from skyhaul.sensors.imaging.lens import TILE_H, TILE_W, Lens
from skyhaul.sensors.imaging.raycast import Frame
from skyhaul.types import Array

# mypy: disable-error-code="no-any-return"


@njit_ieee
def optical_flow(
    scene: SceneArrays, lens: Lens, R_WC: Array, p_WC: Array, motion: Array, frame: Frame
) -> float:
    """Fill `flow` of a frame that `render` has filled, and return its largest length [px/s].

    A point p of an object moves with v_WO + w_WO x (p - p_WO); its image with
    J(ray) R_WC^T (v_p - v_WC - w_WC x (p - p_WC)) / range. Of the sky only the turn is left.

    Args:
        scene: Posed as it was for the frame, velocities included.
        lens: Of the camera.
        R_WC: Axes of the camera, (3, 3).
        p_WC: Where it is, (3,) [m].
        motion: v_WC [m/s] and w_WC [rad/s] of the camera, W axes, (2, 3).
        frame: `flow` is written.
    """
    largest, objects = 0.0, scene.objects
    v, w = motion[0], motion[1]
    for t in range(lens.corner.shape[0]):
        y0, x0 = lens.corner[t, 0], lens.corner[t, 1]
        for i in range(TILE_H * TILE_W):
            row, column = y0 + i // TILE_W, x0 + i % TILE_W
            if row >= lens.height or column >= lens.width:
                continue
            x, y, z = lens.rays[t, 0, i], lens.rays[t, 1, i], lens.rays[t, 2, i]
            d0 = R_WC[0, 0] * x + R_WC[0, 1] * y + R_WC[0, 2] * z
            d1 = R_WC[1, 0] * x + R_WC[1, 1] * y + R_WC[1, 2] * z
            d2 = R_WC[2, 0] * x + R_WC[2, 1] * y + R_WC[2, 2] * z
            # the camera's turn; per metre of range
            g0, g1, g2 = w[2] * d1 - w[1] * d2, w[0] * d2 - w[2] * d0, w[1] * d0 - w[0] * d1
            o = frame.object_id[row, column]
            if o >= 0:
                far = frame.range[row, column]
                p, u = objects.p_WO[o], objects.w_WO[o]
                e0 = p_WC[0] + far * d0 - p[0]
                e1 = p_WC[1] + far * d1 - p[1]
                e2 = p_WC[2] + far * d2 - p[2]
                g0 += (objects.v_WO[o, 0] + u[1] * e2 - u[2] * e1 - v[0]) / far
                g1 += (objects.v_WO[o, 1] + u[2] * e0 - u[0] * e2 - v[1]) / far
                g2 += (objects.v_WO[o, 2] + u[0] * e1 - u[1] * e0 - v[2]) / far
            c0, c1, c2 = mat_t_vec(R_WC, (g0, g1, g2))
            J = lens.jacobian[row, column]
            flow_u = J[0, 0] * c0 + J[0, 1] * c1 + J[0, 2] * c2
            flow_v = J[1, 0] * c0 + J[1, 1] * c1 + J[1, 2] * c2
            frame.flow[row, column, 0], frame.flow[row, column, 1] = flow_u, flow_v
            largest = max(largest, flow_u * flow_u + flow_v * flow_v)
    return math.sqrt(largest)
