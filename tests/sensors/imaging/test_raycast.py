# SPDX-License-Identifier: Apache-2.0
"""The ray caster against signed distances written out once more, and what must not matter."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.camera import Equidistant, RadTan, pixel_rays
from skyhaul.geometry.shapes import Box, Sphere, shape_size
from skyhaul.sensors.imaging.arrays import NOBODY, SKY
from skyhaul.sensors.imaging.frame import blank_frame, z_depth
from skyhaul.sensors.imaging.lens import make_lens
from skyhaul.sensors.imaging.scene import build_scene
from skyhaul.sensors.rig import mount_rotation
from skyhaul.world.obstacles import Obstacle

FORWARD = mount_rotation(0.0, 0.0, 0.0)
CAMERA = RadTan.from_fov((90, 66), 84.0, (-0.28, 0.07, 2e-4, 1e-4))
FISHEYE = Equidistant.from_fov((70, 50), 150.0, (-0.02, 0.003, 0.0, 0.0))
EYE = np.array([-1.0, 0.2, 2.2])


def distance(obstacle, p):
    """Signed distance of points (..., 3) to an obstacle at its own place."""
    _, size, R = shape_size(obstacle.shape)
    d = (p - np.array(obstacle.center_m)) @ R
    if isinstance(obstacle.shape, Sphere):
        return np.linalg.norm(d, axis=-1) - size[0]
    if isinstance(obstacle.shape, Box):
        gap = np.abs(d) - size
        return np.linalg.norm(np.maximum(gap, 0), axis=-1) + np.minimum(gap.max(axis=-1), 0)
    d[..., 2] -= np.clip(d[..., 2], -size[1], size[1])
    return np.linalg.norm(d, axis=-1) - size[0]


def world_rays(model, R):
    return pixel_rays(model) @ R.T


@pytest.fixture
def still(scene, hovering):
    """The scene with the team out of the way."""
    scene.pose(hovering(p_WL=(-3.5, 0.0, 1.0)))
    return scene


@pytest.mark.parametrize("model", [CAMERA, FISHEYE], ids=["pinhole", "fisheye"])
def test_rays_end_on_the_surface_that_they_name_and_pass_nothing_before(still, world, see, model):
    frame = see(still, model, EYE, FORWARD)
    d, seen = world_rays(model, FORWARD), set()
    for j, obstacle in enumerate(world.obstacles):
        on = frame.object_id == 6 + j
        seen |= {j} if on.sum() > 20 else set()
        at = EYE + frame.range[on][:, None] * d[on]
        np.testing.assert_allclose(distance(obstacle, at), 0.0, atol=1e-12)
    assert seen == {0, 1, 2}
    solid = np.isfinite(frame.range) & (frame.object_id < 9)
    for share in np.linspace(0.02, 0.999, 60):
        before = EYE + share * frame.range[solid][:, None] * d[solid]
        for obstacle in world.obstacles:
            assert distance(obstacle, before).min() > 0.0
        assert np.all(before > [-5.0, -4.0, 0.0])
        assert np.all(before < [5.0, 4.0, 5.0])


def test_faces_of_the_room_are_where_they_are_and_named_so(still, see):
    for face, (azimuth, elevation) in enumerate(
        [(180, 0), (0, 0), (-90, 0), (90, 0), (0, -80), (0, 80)]
    ):
        R = mount_rotation(azimuth, elevation, 0.0)
        frame = see(still, CAMERA, [0.0, 0.0, 4.6 if face == 4 else 2.0], R)
        on = (frame.object_id == face) & np.isfinite(frame.range)
        at = frame.range[on][:, None] * world_rays(CAMERA, R)[on]
        at += [0.0, 0.0, 4.6 if face == 4 else 2.0]
        wall = [-5.0, 5.0, -4.0, 4.0, 0.0, 5.0][face]
        assert on.sum() > 100
        np.testing.assert_allclose(at[:, face // 2], wall, atol=1e-12)


def test_depth_is_the_range_times_the_cosine(still, see):
    lens = make_lens(CAMERA)
    frame = see(still, CAMERA, EYE, FORWARD, lens=lens)
    depth, finite = z_depth(lens, frame), np.isfinite(frame.range)
    np.testing.assert_allclose(
        depth[finite], (frame.range * pixel_rays(CAMERA)[..., 2])[finite], rtol=1e-12
    )
    wall = frame.object_id == 1  # straight ahead: the same depth everywhere
    np.testing.assert_allclose(depth[wall], 5.0 - EYE[0], atol=1e-12)


def test_tiles_do_not_show(still, see):
    """A camera whose image is moved by (5, 3) pixels casts the same rays through other tiles."""
    (cx, cy), focal = CAMERA.center_px, CAMERA.focal_px
    moved = RadTan(size_px=(90, 66), focal_px=focal, center_px=(cx - 5.0, cy - 3.0),
                   distortion=CAMERA.distortion)  # fmt: skip
    a, b = see(still, CAMERA, EYE, FORWARD), see(still, moved, EYE, FORWARD)
    np.testing.assert_allclose(a.range[3:, 5:], b.range[:-3, :-5], rtol=1e-9)
    np.testing.assert_array_equal(a.object_id[3:, 5:], b.object_id[:-3, :-5])
    inner = (slice(4, -1), slice(6, -1)), (slice(1, -4), slice(1, -6))
    difference = np.abs(a.grey[inner[0]] - b.grey[inner[1]])
    assert np.median(difference) < 1e-3  # spread of pixels at the rim is one-sided
    assert np.quantile(difference, 0.99) < 0.03


def test_what_is_not_there_leaves_no_trace(scene, hovering, see, world):
    truth = hovering(p_WL=(-3.5, 0.0, 1.0))
    scene.pose(truth)
    with_all = see(scene, CAMERA, EYE, FORWARD)
    object.__setattr__(truth, "present", np.array([True, False, True]))
    scene.pose(truth)
    without = see(scene, CAMERA, EYE, FORWARD)
    assert np.sum(with_all.object_id == 7) > 50
    assert not np.any(without.object_id == 7)
    same = with_all.object_id != 7
    np.testing.assert_array_equal(with_all.range[same], without.range[same])


def test_a_vehicle_does_not_see_itself_but_all_others(scene, hovering, see):
    truth = hovering(p_WL=(0.0, 0.0, 1.5))
    scene.pose(truth)
    centre = truth.team.p_WB.mean(axis=0)
    for i in range(4):
        towards = np.arctan2(*(centre - truth.team.p_WB[i])[[1, 0]])
        R = mount_rotation(np.degrees(towards), 0.0, 0.0)
        frame = see(scene, FISHEYE, truth.team.p_WB[i], R, own=scene.vehicle_id(i))
        others = {scene.vehicle_id(j) for j in range(4)} - {scene.vehicle_id(i)}
        assert others <= set(np.unique(frame.object_id).tolist())
        assert scene.vehicle_id(i) not in frame.object_id
    assert scene.kinds[scene.vehicle_id(0)] == "vehicle"
    assert scene.names[scene.vehicle_id(3)] == "vehicle 3"


def test_the_sky_shines_through_the_roof(still, see):
    up = mount_rotation(0.0, 89.0, 0.0)
    frame = see(still, CAMERA, [0.5, 0.0, 1.0], up)
    sky = frame.object_id == SKY
    assert 0.05 < sky.mean() < 0.8
    assert np.all(np.isinf(frame.range[sky]))
    inner = sky & np.roll(sky, 1, 0) & np.roll(sky, -1, 0) & np.roll(sky, 1, 1)
    assert frame.grey[inner].min() > 0.4
    assert frame.grey[inner].std() > 0.005  # clouds


def test_walls_are_seen_from_inside_only(still, see):
    inward = mount_rotation(180.0, 0.0, 0.0)
    outside = see(still, CAMERA, [14.0, 0.0, 2.5], inward)
    assert np.any(outside.object_id == 0)  # the far wall, through the near one
    assert not np.any(outside.object_id == 1)
    assert np.any(outside.object_id == SKY)  # past the room
    away = see(still, CAMERA, [14.0, 0.0, 2.5], FORWARD)
    assert np.all(away.object_id == SKY)
    assert away.grey.min() > 0.1


def test_frames_are_the_same_to_the_byte_and_buffers_leave_no_trace(still, see):
    lens = make_lens(CAMERA)
    frame = blank_frame(still.arrays, lens)
    first = see(still, CAMERA, EYE, FORWARD, frame=frame, lens=lens)
    kept = [first.grey.copy(), first.range.copy(), first.object_id.copy()]
    see(still, CAMERA, [1.0, 2.0, 1.0], mount_rotation(120.0, 10.0, 30.0), frame=frame, lens=lens)
    again = see(still, CAMERA, EYE, FORWARD, NOBODY, frame=frame, lens=lens)
    for a, b in zip(kept, (again.grey, again.range, again.object_id), strict=True):
        assert a.tobytes() == b.tobytes()


ODD = {
    "pinhole": RadTan(size_px=(91, 67), focal_px=(60.0, 60.0), center_px=(45.0, 33.0)),
    "fisheye": Equidistant.from_fov((71, 51), 150.0),
}


@pytest.mark.parametrize("eye", [EYE, [-7.0, 0.0, 2.0]], ids=["inside", "outside"])
@pytest.mark.parametrize("model", ODD.values(), ids=ODD.keys())
@pytest.mark.parametrize("azimuth", [0.0, 90.0, 180.0, 270.0])
def test_rays_along_an_axis_see_what_their_neighbours_see(still, see, model, azimuth, eye):
    """The middle row and column of an odd image have rays with components of exactly zero."""
    R = np.round(mount_rotation(azimuth, 0.0, 0.0))
    assert np.any(world_rays(model, R) == 0.0)
    frame = see(still, model, eye, R)
    assert frame.range.min() > 0.0
    assert np.all(np.isfinite(frame.grey))
    assert np.all(np.isfinite(frame.range) | (frame.object_id == SKY))
    row, column = model.size_px[1] // 2, model.size_px[0] // 2
    pairs = [(frame.range[row], frame.range[row + 1])]
    pairs.append((frame.range[:, column], frame.range[:, column + 1]))
    for a, b in pairs:  # all but outlines
        assert np.isclose(a, b, rtol=0.05).mean() > 0.85


def test_rays_along_an_axis_meet_a_box_along_the_axes(world, team, hovering, see):
    crate = Obstacle(name="crate", shape=Box(size_m=(1.0, 1.0, 1.0)), center_m=(2.0, 0.0, 2.0))
    alone = replace(world, obstacles=(crate,))
    scene = build_scene(team, alone)
    scene.pose(hovering(p_WL=(-3.5, 0.0, 1.0), world=alone))
    frame = see(scene, ODD["pinhole"], [0.0, 0.1, 1.9], np.round(FORWARD))
    assert set(frame.object_id[33, 31:60].tolist()) == {6}
    assert set(frame.object_id[20:48, 45].tolist()) == {6}
    assert frame.range[33, 45] == 1.5
