# SPDX-License-Identifier: Apache-2.0
"""Camera models: round trips over whole images, finite differences, and OpenCV's own maths."""

import cv2
import numpy as np
import pytest

from skyhaul.geometry.camera import (
    Equidistant,
    RadTan,
    in_frame,
    pixel_rays,
    project,
    project_jacobian,
    project_points,
    unproject,
    unproject_pixels,
)

MODELS = [
    RadTan.from_fov((64, 48), 84.0, (-0.283, 0.074, 0.0002, 0.00002)),
    RadTan(size_px=(80, 60), focal_px=(70.0, 64.0), center_px=(41.0, 28.0),
           distortion=(0.05, -0.01, 0.003, -0.002)),
    Equidistant.from_fov((64, 48), 150.0, (-0.02, 0.003, 0.0, 0.0)),
    Equidistant.from_fov((60, 60), 220.0),
]  # fmt: skip
IDS = ["euroc", "tangential", "fisheye", "beyond 180 deg"]


def points_in_view(model, count=200):
    """Points at 0.3 to 9 m along rays through random places of the image."""
    rng = np.random.default_rng(3)
    uv = rng.uniform(-0.5, np.array(model.size_px) - 0.5, (count, 2))
    return uv, unproject_pixels(model, uv) * rng.uniform(0.3, 9.0, (count, 1))


@pytest.mark.parametrize("model", MODELS, ids=IDS)
def test_every_pixel_goes_out_and_comes_back(model):
    rays = pixel_rays(model)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=2), 1.0, atol=1e-14)
    uv, ok = project_points(model, rays)
    u, v = np.meshgrid(np.arange(model.size_px[0]), np.arange(model.size_px[1]))
    assert ok.all()
    np.testing.assert_allclose(uv, np.column_stack([u.ravel(), v.ravel()]), atol=1e-9)


@pytest.mark.parametrize("model", MODELS, ids=IDS)
def test_images_do_not_depend_on_distance(model):
    uv, points = points_in_view(model)
    np.testing.assert_allclose(project_points(model, points)[0], uv, atol=1e-9)


@pytest.mark.parametrize("model", MODELS, ids=IDS)
def test_jacobian_matches_finite_differences(model):
    camera, J, step = model.arrays(), np.empty((2, 3)), 1e-6
    for p in points_in_view(model, 40)[1]:
        u, v, ok = project_jacobian(camera, *p, J)
        assert ok
        assert (u, v, ok) == project(camera, *p)
        for c, e in enumerate(step * np.eye(3)):
            ahead, behind = project(camera, *(p + e))[:2], project(camera, *(p - e))[:2]
            slope = (np.array(ahead) - behind) / (2.0 * step)
            np.testing.assert_allclose(J[:, c], slope, rtol=1e-5, atol=1e-4)


def test_jacobian_on_the_axis_is_that_of_a_pinhole():
    for model in MODELS:
        camera, J = model.arrays(), np.empty((2, 3))
        project_jacobian(camera, 0.0, 0.0, 2.0, J)
        expected = [[camera.fx / 2.0, 0.0, 0.0], [0.0, camera.fy / 2.0, 0.0]]
        np.testing.assert_allclose(J, expected, atol=1e-9)


@pytest.mark.parametrize("model", MODELS, ids=IDS)
def test_jacobian_of_what_has_no_image_is_zero(model):
    camera, J = model.arrays(), np.full((2, 3), np.nan)
    assert not project_jacobian(camera, 0.0, 0.0, 0.0, J)[2]
    np.testing.assert_array_equal(J, 0.0)
    _, _, ok = project_jacobian(camera, 0.3, -0.2, 0.0, J)  # a wide fisheye sees it
    assert ok == project(camera, 0.3, -0.2, 0.0)[2]
    assert np.any(J != 0.0) == isinstance(model, Equidistant)


@pytest.mark.parametrize("model", MODELS[:2], ids=IDS[:2])
def test_radtan_is_that_of_opencv(model):
    _, points = points_in_view(model)
    K = np.array([[model.focal_px[0], 0, model.center_px[0]],
                  [0, model.focal_px[1], model.center_px[1]], [0, 0, 1.0]])  # fmt: skip
    theirs = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(model.distortion))[0]
    np.testing.assert_allclose(project_points(model, points)[0], theirs[:, 0], atol=1e-9)


def test_equidistant_is_that_of_opencv():
    model = MODELS[2]
    points = points_in_view(model)[1]
    points = points[points[:, 2] > 0.1]
    K = np.array([[model.focal_px[0], 0, model.center_px[0]],
                  [0, model.focal_px[1], model.center_px[1]], [0, 0, 1.0]])  # fmt: skip
    d = np.array(model.distortion)
    theirs = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, d)[0]
    assert len(points) > 100
    np.testing.assert_allclose(project_points(model, points)[0], theirs[:, 0], atol=1e-6)


@pytest.mark.parametrize("model", MODELS, ids=IDS)
@pytest.mark.parametrize("fov_deg", [40.0, 100.0, 170.0])
def test_field_of_view_runs_from_edge_to_edge(model, fov_deg):
    again = type(model).from_fov((640, 480), fov_deg)
    left = np.array(unproject(again.arrays(), -0.5, 239.5))
    right = np.array(unproject(again.arrays(), 639.5, 239.5))
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(fov_deg)


def test_what_lies_behind_or_beyond_the_model_has_no_image():
    pinhole, fisheye = MODELS[0].arrays(), MODELS[3].arrays()
    assert not project(pinhole, 0.1, 0.0, -1.0)[2]
    assert not project(pinhole, 0.1, 0.0, 0.0)[2]
    assert project(fisheye, 1.0, 0.0, -0.3)[2]
    # 1 - 3 r^2 vanishes at r = 0.577: rays beyond would fold back into the image
    folding = RadTan.from_fov((64, 48), 40.0, (-1.0, 0.0, 0.0, 0.0)).arrays()
    assert project(folding, 0.57, 0.0, 1.0)[2]
    assert not project(folding, 0.58, 0.0, 1.0)[2]


def test_the_frame_ends_half_a_pixel_beyond_the_outermost_centres():
    camera = MODELS[0].arrays()
    assert in_frame(camera, -0.5, 47.49)
    assert not in_frame(camera, -0.51, 0.0)
    assert not in_frame(camera, 63.5, 0.0)


def test_impossible_cameras_are_refused():
    with pytest.raises(ValueError, match="fov_deg must lie in"):
        RadTan.from_fov((64, 48), 180.0)
    with pytest.raises(ValueError, match="size_px must be > 0, got"):
        RadTan(size_px=(0, 48), focal_px=(1.0, 1.0), center_px=(0.0, 0.0))
    with pytest.raises(ValueError, match="focal_px must be > 0, got"):
        Equidistant(size_px=(64, 48), focal_px=(0.0, 1.0), center_px=(0.0, 0.0))
