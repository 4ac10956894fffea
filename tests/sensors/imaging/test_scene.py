# SPDX-License-Identifier: Apache-2.0
"""What the scene tells about its objects, and how it follows the truth."""

import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.model.team import PointPayload, Team
from skyhaul.sensors.imaging.scene import build_scene


def test_objects_have_names_and_kinds_in_a_fixed_order(scene):
    assert scene.names[4:9] == ("floor", "ceiling", "crate", "ball", "pole")
    assert scene.kinds == (
        *["room"] * 6, "static", "mover", "static", "payload", *["vehicle"] * 4, *["cable"] * 4,
    )  # fmt: skip
    assert scene.first_vehicle == 10
    assert len(scene.names) == len(set(scene.names)) == len(scene.kinds)


def test_posing_puts_everything_where_truth_has_it(scene, hovering):
    truth = hovering(p_WL=(0.3, -0.2, 1.4), t_us=1_500_000, turn=(0.1, 0.2, 0.3))
    scene.pose(truth)
    o = scene.arrays.objects
    np.testing.assert_array_equal(o.p_WO[6:9], truth.obstacles.p_WO)
    np.testing.assert_array_equal(o.v_WO[6:9], truth.v_WO)
    np.testing.assert_array_equal(o.p_WO[9], truth.team.p_WL)
    np.testing.assert_array_equal(o.p_WO[10:14], truth.team.p_WB)
    R_WB = quat_to_R(truth.team.q_WB)
    np.testing.assert_allclose(o.R_WO[10:14], R_WB, atol=1e-12)
    np.testing.assert_allclose(o.w_WO[10:14], R_WB @ [0.1, 0.2, 0.3], atol=1e-12)
    assert o.v_WO[7] @ o.v_WO[7] > 0.0


def test_a_part_stays_inside_its_balls(scene, hovering):
    """Every point of a part lies in one of them, or tiles would miss it."""
    scene.pose(hovering())
    parts, balls, rng = scene.arrays.parts, scene.arrays.balls, np.random.default_rng(0)
    for k in range(len(parts.kind)):
        u = rng.uniform(-1.0, 1.0, (200, 3))
        s = parts.size[k]
        if parts.kind[k] == 0:
            local = s[0] * u / np.linalg.norm(u, axis=1, keepdims=True)
        elif parts.kind[k] == 1:
            local = u * s
        if parts.kind[k] in (2, 4):
            flat = u[:, :2] / np.linalg.norm(u[:, :2], axis=1, keepdims=True)
            local = np.column_stack([s[0] * flat, s[1] * u[:, 2]])
        at = parts.p_WP[k] + local @ parts.R_WP[k].T
        own = balls.part == k
        gap = np.linalg.norm(at[:, None] - balls.p_W[own], axis=2) - balls.radius[own]
        assert gap.min(axis=1).max() < 1e-9


def test_same_seed_same_textures_other_seed_others(team, world, scene):
    again, other = build_scene(team, world), build_scene(team, world, seed=1)
    assert again.arrays.atlas.texel.tobytes() == scene.arrays.atlas.texel.tobytes()
    assert np.mean(other.arrays.atlas.texel != scene.arrays.atlas.texel) > 0.5
    faces = scene.arrays.parts.face[:2]
    assert len(set(faces[0].tolist())) == 6  # a box has six different sides
    assert faces[0].tolist() != faces[1].tolist()


def test_a_point_load_is_a_ball_where_all_cables_meet(world):
    scene = build_scene(Team(payload=PointPayload(radius_m=0.07)), world)
    (row,) = np.flatnonzero(scene.arrays.parts.object == scene.names.index("payload"))
    assert scene.arrays.parts.size[row, 0] == pytest.approx(0.07)
    assert np.all(scene.hooks_L == 0.0)
