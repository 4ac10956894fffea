# SPDX-License-Identifier: Apache-2.0
"""Optical flow against where the points of a frame go in a short time."""

import numpy as np
import pytest

from skyhaul.geometry.camera import Equidistant, RadTan, pixel_rays, project_points
from skyhaul.geometry.so3 import so3_exp
from skyhaul.sensors.imaging.arrays import SKY
from skyhaul.sensors.imaging.flow import optical_flow
from skyhaul.sensors.imaging.lens import make_lens
from skyhaul.sensors.rig import mount_rotation

MODELS = [
    RadTan.from_fov((60, 44), 84.0, (-0.28, 0.07, 2e-4, 1e-4)),
    Equidistant.from_fov((60, 44), 150.0, (-0.02, 0.003, 0.0, 0.0)),
]
DT = 1e-5


def moved(points, ids, objects, dt):
    """Where points of objects are a time later."""
    out = points.copy()
    for o in np.unique(ids[ids >= 0]):
        on, p = ids == o, objects.p_WO[o]
        turn = so3_exp(dt * objects.w_WO[o])
        out[on] = p + dt * objects.v_WO[o] + (points[on] - p) @ turn.T
    return out


@pytest.mark.parametrize("model", MODELS, ids=["pinhole", "fisheye"])
def test_flow_is_where_the_points_of_a_frame_go(scene, hovering, see, model):
    rng = np.random.default_rng(1)
    truth = hovering(p_WL=(1.6, 0.0, 1.3), turn=(0.5, -0.4, 0.9))
    scene.pose(truth)
    objects = scene.arrays.objects
    objects.v_WO[9:] = rng.normal(size=(9, 3))  # load, vehicles and cables fly about
    objects.w_WO[9:] = rng.normal(size=(9, 3))
    lens, p, R = make_lens(model), np.array([-0.6, 0.1, 2.2]), mount_rotation(5.0, -4.0, 10.0)
    frame = see(scene, model, p, R, lens=lens)
    motion = rng.normal(size=(2, 3))
    largest = optical_flow(scene.arrays, lens, R, p, motion, frame)

    solid = frame.object_id != SKY
    points = p + frame.range[solid][:, None] * (pixel_rays(model) @ R.T)[solid]
    images = []
    for dt in (DT, -DT):
        at = moved(points, frame.object_id[solid], objects, dt)
        R_later = so3_exp(dt * motion[1]) @ R
        images.append(project_points(model, (at - p - dt * motion[0]) @ R_later)[0])
    expected = (images[0] - images[1]) / (2.0 * DT)
    np.testing.assert_allclose(frame.flow[solid], expected, rtol=2e-5, atol=2e-3)
    lengths = np.linalg.norm(frame.flow, axis=2)
    assert largest == pytest.approx(lengths.max(), rel=1e-5)
    assert len({*np.unique(frame.object_id).tolist()} & set(range(6, 18))) > 6


def test_the_sky_only_turns(scene, hovering, see):
    model, R = MODELS[0], mount_rotation(0.0, 89.0, 0.0)
    scene.pose(hovering())
    lens, p = make_lens(model), np.array([0.5, 0.0, 3.6])
    frame = see(scene, model, p, R, lens=lens)
    sky = frame.object_id == SKY
    optical_flow(scene.arrays, lens, R, p, np.array([[3.0, 2.0, 1.0], [0.0, 0.0, 0.0]]), frame)
    assert sky.sum() > 50
    assert np.all(frame.flow[sky] == 0.0)
    assert np.abs(frame.flow[~sky]).max() > 10.0
    turn = np.array([0.0, 0.3, 0.2])
    optical_flow(scene.arrays, lens, R, p, np.array([[0.0, 0.0, 0.0], turn]), frame)
    d = pixel_rays(model)[sky] @ R.T
    ahead = project_points(model, d @ (so3_exp(DT * turn) @ R))[0]
    behind = project_points(model, d @ (so3_exp(-DT * turn) @ R))[0]
    np.testing.assert_allclose(frame.flow[sky], (ahead - behind) / (2 * DT), rtol=2e-5, atol=1e-3)
