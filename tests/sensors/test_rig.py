# SPDX-License-Identifier: Apache-2.0
"""The rig: where cameras point, what they share, and what the team sees together."""

import numpy as np
import pytest

from skyhaul.geometry.camera import in_frame, pixel_rays, project_points
from skyhaul.sensors.optics import LensParams
from skyhaul.sensors.rig import CameraMount, EventCameraMount, RigParams, mount_rotation

RIG = RigParams().calibration()
CAMERAS = {c.name: c for c in RIG.cameras}
SMALL = LensParams(size_px=(32, 24), fov_deg=60.0)


def sees(camera, d_B, distance=1e6):
    """Which points a distance away in directions (k, 3) of body axes are in a camera's image."""
    uv, ok = project_points(camera.model, (d_B * distance - camera.p_BC) @ camera.R_BC)
    inside = [in_frame(camera.model.arrays(), u, v) for u, v in uv]
    return ok & np.array(inside)


def sphere(count=4000):
    """Directions spread evenly."""
    k = np.arange(count) + 0.5
    z, a = 1.0 - 2.0 * k / count, k * np.pi * (3.0 - np.sqrt(5.0))
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(a), r * np.sin(a), z])


def test_azimuth_turns_left_and_elevation_up():
    for (azimuth, elevation), axis in {
        (0, 0): [1, 0, 0], (90, 0): [0, 1, 0], (180, 0): [-1, 0, 0], (0, 90): [0, 0, 1],
        (0, -90): [0, 0, -1],
    }.items():  # fmt: skip
        R = mount_rotation(azimuth, elevation, 0.0)
        np.testing.assert_allclose(R[:, 2], axis, atol=1e-12)
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
    level = mount_rotation(40.0, 20.0, 0.0)
    assert level[2, 0] == pytest.approx(0.0)  # x is level
    assert level[2, 1] < 0.0  # y points down
    rolled = mount_rotation(40.0, 20.0, 30.0)
    np.testing.assert_allclose(rolled[:, 2], level[:, 2])
    assert rolled[:, 0] @ level[:, 0] == pytest.approx(np.cos(np.radians(30.0)))
    assert rolled[:, 0] @ level[:, 1] > 0.0


def test_the_stereo_pair_shares_most_of_what_it_sees():
    left, right = CAMERAS["front left"], CAMERAS["front right"]
    np.testing.assert_array_equal(left.R_BC, right.R_BC)
    np.testing.assert_allclose(left.p_BC - right.p_BC, [0.0, 0.08, 0.0])
    d = sphere(20_000)
    for distance, least in ((0.5, 0.8), (2.0, 0.93)):
        a, b = sees(left, d, distance), sees(right, d, distance)
        assert np.sum(a & b) / np.sum(a | b) > least


def test_rear_and_down_overlap_and_so_do_front_and_event_camera():
    d = sphere(20_000)
    rear, down, front = (sees(CAMERAS[n], d) for n in ("rear", "down", "front left"))
    event = sees(RIG.event_camera, d)
    both = rear & down
    assert both.sum() > 0.1 * down.sum()
    elevation = np.degrees(np.arcsin(d[both, 2]))
    assert elevation.max() - elevation.min() > 5.0
    assert np.sum(front & event) > 0.95 * front.sum()


def test_four_vehicles_that_look_outward_see_movers_from_all_round():
    d = sphere()
    seen = np.zeros(len(d), dtype=bool)
    for yaw in np.radians([45, 135, 225, 315]):
        c, s = np.cos(yaw), np.sin(yaw)
        seen |= sees(RIG.event_camera, d @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]))
    elevation = np.degrees(np.arcsin(d[:, 2]))
    assert np.all(seen[np.abs(elevation) < 35.0])
    assert seen.mean() > 0.8


def test_the_plate_is_in_sight_wherever_the_load_hangs():
    """23 to 29 deg from straight down, up to 45 deg to either side of straight behind, 1.1 m."""
    down = CAMERAS["down"]
    for polar in np.radians([23.0, 26.0, 29.0]):
        for azimuth in np.radians([135.0, 180.0, 225.0]):
            side = np.sin(polar)
            centre = 1.1 * np.array(
                [side * np.cos(azimuth), side * np.sin(azimuth), -np.cos(polar)]
            )
            corners = centre + 0.1 * np.array([[x, y, 0] for x in (-1, 1) for y in (-1, 1)])
            assert np.all(sees(down, corners, 1.0))


def test_no_camera_sees_its_own_body():
    """The corners of the body box lie outside every image."""
    box = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = box * [0.045, 0.035, 0.018]
    for camera in (*RIG.cameras, RIG.event_camera):
        ahead = (corners - camera.p_BC) @ camera.R_BC[:, 2] > 0.02
        assert not np.any(ahead & sees(camera, corners, 1.0)), camera.name


def test_calibration_has_what_an_estimator_needs_and_is_read_only():
    assert [c.name for c in RIG.cameras] == ["front left", "front right", "rear", "down"]
    for camera in (*RIG.cameras, RIG.event_camera):
        assert pixel_rays(camera.model).shape == (*camera.model.size_px[::-1], 3)
        with pytest.raises(ValueError, match="read-only"):
            camera.p_BC[0] = 1.0


def test_impossible_mounts_are_refused():
    for name in ("", "imu", "1 left", "Left", "a-b", "r\u00e9ar", "a/b", "a\n"):
        with pytest.raises(ValueError, match="name must begin with a lower-case letter, go on"):
            CameraMount(name=name, lens=SMALL, p_BC_m=(0, 0, 0))
        with pytest.raises(ValueError, match="name must begin with a lower-case letter, go on"):
            EventCameraMount(name=name)
    with pytest.raises(ValueError, match="rate_hz must divide the 500 steps"):
        CameraMount(name="a", lens=SMALL, p_BC_m=(0, 0, 0), rate_hz=30.0)
    twice = CameraMount(name="a", lens=SMALL, p_BC_m=(0, 0, 0))
    with pytest.raises(ValueError, match="'a' twice"):
        RigParams(cameras=(twice, twice))
    for one, other in (("a b", "a_b"), ("a b", "a  b")):  # one file name for both
        mounts = tuple(CameraMount(name=n, lens=SMALL, p_BC_m=(0, 0, 0)) for n in (one, other))
        with pytest.raises(ValueError, match="differ in letters or digits"):
            RigParams(cameras=mounts)
