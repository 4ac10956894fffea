# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.camera import pixel_rays
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.perception.scene.backdrop import BackdropRules, BackdropWatch
from skyhaul.perception.scene.evidence import empty_evidence

from ..obstacles.conftest import state_of  # noqa: TID252
from .conftest import CALIBRATION, CELLS, FRAME_US, LOOK, ROOM, TEAM, VOXEL

REAR = 2
STEP = np.array([0.04, 0.03, 0.01])
ALL = np.ones(TEAM.count, np.bool_)


def moved(by):
    """The team, all of it shifted by (3,) [m]."""
    team = state_of(TEAM)
    return replace(team, p_WL=team.p_WL + by, p_WB=team.p_WB + by)


def picture(team, ball):
    """What vehicle 0 sees to the rear: walls with a pattern of waves, and a ball with a finer one.

    A sum of waves keeps its derivatives small enough for interpolation to be exact to one level.
    """
    camera = CALIBRATION.rig.cameras[REAR]
    width, height = camera.model.size_px
    R_WB = quat_to_R(team.q_WB[0])
    p = team.p_WB[0] + R_WB @ camera.p_BC
    d = pixel_rays(camera.model).reshape(height, width, 3) @ (R_WB @ camera.R_BC).T
    with np.errstate(divide="ignore"):
        far = np.where(d > 0.0, (ROOM[1] - p) / d, (ROOM[0] - p) / d).min(axis=-1)
    w = p + far[..., None] * d
    grey = 128.0 + 35.0 * np.sin(7.0 * w).sum(axis=-1)
    if ball is not None:
        rel = ball[:3] - p
        unit = d / np.linalg.norm(d, axis=-1, keepdims=True)
        b = unit @ rel
        depth = ball[3] ** 2 - rel @ rel + b**2
        inside = (b > 0.0) & (depth > 0.0)
        on = unit[inside] * (b[inside] - np.sqrt(depth[inside]))[:, None] - rel
        grey[inside] = 128.0 + 35.0 * np.sin(25.0 * on).sum(axis=-1)
    return np.clip(grey, 0, 255).astype(np.uint8), p


def two_looks(ball=None, evidence=None, off=0.0, rules=BackdropRules()):  # noqa: B008
    """Bearings of the second of two images, and where its camera is."""
    watch = BackdropWatch(rules, 0, TEAM.count, TEAM, CALIBRATION.rig.cameras[REAR], ROOM)
    evidence = evidence or empty_evidence(ROOM[0] + 0.5 * VOXEL, VOXEL, CELLS)
    shot, bearings, p = None, None, None
    for k in range(2):
        team = moved(k * STEP)
        image, p = picture(team, ball)
        told = replace(team, p_WB=team.p_WB + k * off) if off else team
        shot, bearings = watch.step(shot, k * FRAME_US, image, told, ALL, LOOK, evidence)
    return bearings, p


def rear_axis():
    team = moved(np.zeros(3))
    camera = CALIBRATION.rig.cameras[REAR]
    return quat_to_R(team.q_WB[0]) @ camera.R_BC[:, 2], team.p_WB[0]


def ball_behind(distance_m=1.6):
    """A ball to the side of the rear axis, clear of the team."""
    axis, p = rear_axis()
    side = np.cross(axis, [0.0, 0.0, 1.0])
    d = axis + 0.45 * side / np.linalg.norm(side) + np.array([0.0, 0.0, 0.3])
    return np.append(p + distance_m * d / np.linalg.norm(d), 0.2)


def test_an_empty_room_is_no_news():
    bearings, _ = two_looks()
    assert len(bearings.dir_W) == 0


def test_a_ball_in_front_of_the_wall_is_seen_where_it_is():
    ball = ball_behind()
    bearings, p = two_looks(ball)
    assert len(bearings.dir_W)
    d = ball[:3] - p
    off = np.arccos(np.clip(bearings.dir_W @ d / np.linalg.norm(d), -1.0, 1.0))
    assert off.min() < np.arcsin(ball[3] / np.linalg.norm(d))
    assert np.all(np.isnan(bearings.range_m))


def test_what_voxels_explain_is_no_news():
    ball = ball_behind()
    evidence = empty_evidence(ROOM[0] + 0.5 * VOXEL, VOXEL, CELLS)
    centre = np.floor((ball[:3] - ROOM[0]) / VOXEL).astype(int)
    x, y, z = (slice(c - 3, c + 4) for c in centre)
    evidence.occupied[x, y, z] = True
    seen, _ = two_looks(ball)
    explained, _ = two_looks(ball, evidence)
    assert len(explained.dir_W) < len(seen.dir_W)


def test_an_image_at_a_wrong_pose_says_nothing():
    """Where all differs it is the pose that is wrong: better silent than everywhere wrong."""
    bearings, _ = two_looks(off=0.6)
    trusting, _ = two_looks(off=0.6, rules=BackdropRules(most_share=1.0))
    assert len(bearings.dir_W) == 0 < len(trusting.dir_W)


def test_the_first_image_has_nothing_to_be_compared_with():
    watch = BackdropWatch(BackdropRules(), 0, TEAM.count, TEAM, CALIBRATION.rig.cameras[REAR], ROOM)
    team = moved(np.zeros(3))
    image, _ = picture(team, ball_behind())
    evidence = empty_evidence(ROOM[0] + 0.5 * VOXEL, VOXEL, CELLS)
    _, bearings = watch.step(None, 0, image, team, ALL, LOOK, evidence)
    assert len(bearings.dir_W) == 0


@pytest.mark.parametrize("wrong", [{"window": 4}, {"window": 1}, {"most_share": 0.0}])
def test_rules_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match="must"):
        BackdropRules(**wrong)
