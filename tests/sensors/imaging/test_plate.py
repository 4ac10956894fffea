# SPDX-License-Identifier: Apache-2.0
"""The tag that is published is the one on the load: one, in the middle, of that size."""

import cv2
import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan, project_points
from skyhaul.model.team import PointPayload, RigidPayload, Team
from skyhaul.sensors.imaging.plate import tag_on
from skyhaul.sensors.imaging.scene import build_scene

FROM_ABOVE = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
CAMERA = RadTan(size_px=(320, 320), focal_px=(600.0, 600.0), center_px=(159.5, 159.5))


@pytest.mark.parametrize(
    "size_m",
    [(0.2, 0.2, 0.08), (0.5, 0.44, 0.02), (0.3, 0.55, 0.1)],
    ids=["square", "wide", "long"],
)
def test_the_published_tag_is_the_one_that_is_seen(size_m, world, hovering, see) -> None:
    load = Team(payload=RigidPayload(size_m=size_m))
    scene = build_scene(load, world)
    scene.pose(hovering(p_WL=(0.0, 0.0, 1.0)))
    arrays, tag = scene.arrays, scene.tag
    arrays.objects.present[:] = np.array(scene.kinds) == "payload"
    arrays.objects.R_WO[9] = np.eye(3)
    scene.arrays.parts.R_WP[arrays.parts.object == 9] = np.eye(3)
    above = 3.0 * max(size_m)
    eye = np.array([0.0, 0.0, 1.0 + tag.p_LT[2] + above])
    grey = see(scene, CAMERA, eye, FROM_ABOVE).grey
    image = np.clip(255.0 * grey, 0, 255).astype(np.uint8)
    assert tag.family == "tag25h9"
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 3
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_25h9)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    assert ids is not None
    assert ids.ravel().tolist() == [tag.id]
    h = 0.5 * tag.edge_m
    corners_T = np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])
    corners_W = corners_T @ tag.R_LT.T + tag.p_LT + [0.0, 0.0, 1.0]
    expected, _ = project_points(CAMERA, (corners_W - eye) @ FROM_ABOVE)
    np.testing.assert_allclose(corners[0][0], expected, atol=0.4)


def test_a_point_has_no_tag() -> None:
    assert tag_on(PointPayload()) is None
