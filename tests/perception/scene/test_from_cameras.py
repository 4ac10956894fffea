# SPDX-License-Identifier: Apache-2.0
"""A hovering team among balls that stand and balls that fly, by depth alone."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.perception.scene.from_cameras import CameraObstacles
from skyhaul.perception.scene.watch import ViewRules

from .conftest import ROOM, TEAM, VOXEL, Ball, follow, scene

AHEAD = (2.2, 2.2, 2.5)  # where one of the vehicles looks
STANDS = Ball(AHEAD, radius_m=0.3)


def surface_distance(estimate, ball):
    """From the middles of the occupied voxels to the ball's surface [m]."""
    cells = np.argwhere(estimate.voxels.occupied)
    return np.linalg.norm(estimate.voxels.p_WO + VOXEL * cells - ball.p, axis=1) - ball.radius_m


def test_what_stands_becomes_voxels_on_its_surface_and_no_track():
    _, out = follow(scene(), [STANDS], 12, rng=np.random.default_rng(0))
    off = surface_distance(out[-1], STANDS)
    assert len(off) > 15
    assert np.abs(off).max() < 1.8 * VOXEL
    assert all(e.tracks == () for e in out)


def test_an_empty_room_gives_nothing_walls_and_the_team_are_no_obstacles():
    _, out = follow(scene(), [], 12, rng=np.random.default_rng(1))
    assert not out[-1].voxels.occupied.any()
    assert all(e.tracks == () for e in out)


@pytest.mark.parametrize("v", [(0.4, -0.4, 0.0), (0.0, 0.0, 0.5), (-0.35, -0.35, 0.1)])
def test_what_flies_becomes_one_track_and_leaves_no_voxels(v):
    middle = np.array(AHEAD) - 1.5 * np.array(v)
    ball = Ball(tuple(middle), v)
    _, out = follow(scene(), [ball], 30, rng=np.random.default_rng(2))
    (track,) = out[-1].tracks
    assert {t.track_id for e in out for t in e.tracks} == {track.track_id}
    assert np.linalg.norm(track.p_WO - ball.place(1e-6 * track.stamp_us)) < 0.1
    assert np.linalg.norm(track.v_WO - v) < 0.12
    assert track.shape.radius_m == pytest.approx(0.2, rel=0.3)
    assert out[-1].voxels.occupied.sum() <= 2


def test_a_mover_beside_what_stands_does_not_take_it_along():
    ball = Ball((2.2, 1.2, 2.5), (0.0, 0.4, 0.0))  # it passes the other one 0.9 m nearer
    stands = Ball((3.0, 2.2, 2.5), radius_m=0.3)
    _, out = follow(scene(), [stands, ball], 30, rng=np.random.default_rng(3))
    (track,) = out[-1].tracks
    assert np.linalg.norm(track.p_WO - ball.place(1e-6 * track.stamp_us)) < 0.15
    off = surface_distance(out[-1], stands)
    assert np.mean(np.abs(off) < 1.8 * VOXEL) > 0.9
    assert len(off) > 15


def test_what_appears_in_open_space_is_a_track_at_once():
    estimator = scene()
    memory, _ = follow(estimator, [], 10, rng=np.random.default_rng(4))
    _, out = follow(estimator, [STANDS], 6, first=10, memory=memory, rng=np.random.default_rng(5))
    first = next(k for k, e in enumerate(out) if e.tracks)
    assert first <= 3
    assert np.linalg.norm(out[-1].tracks[0].p_WO - STANDS.p) < 0.15


def test_voxels_of_what_left_are_freed():
    estimator = scene()
    memory, before = follow(estimator, [STANDS], 12)
    assert before[-1].voxels.occupied.any()
    _, after = follow(estimator, [], 15, first=12, memory=memory)
    assert not after[-1].voxels.occupied.any()


def test_versions_rise_and_say_what_changed():
    _, out = follow(scene(replace(CameraObstacles(), voxel_period_us=100_000)), [STANDS], 12)
    before = np.zeros_like(out[0].voxels.occupied)
    version = 0
    for e in out:
        if e.voxels.version > version:
            assert e.voxels.version == version + 1
            low, high = e.voxels.changed
            differ = np.argwhere(before != e.voxels.occupied)
            assert np.all(differ >= low)
            assert np.all(differ < high)
        else:
            np.testing.assert_array_equal(before, e.voxels.occupied)
        before, version = e.voxels.occupied, e.voxels.version
    assert version > 0


def test_a_vehicle_that_is_silent_is_done_without():
    _, out = follow(scene(), [STANDS], 12, vehicles=[0, 1, 2])
    assert len(out) == 12


def test_tubes_are_bounded_so_that_planning_stays_possible():
    ball = Ball((2.2, 1.6, 2.5), (0.0, 0.4, 0.0))
    _, out = follow(scene(), [ball], 25, rng=np.random.default_rng(6))
    tracks = [t for e in out for t in e.tracks]
    assert tracks
    assert max(t.growth_mps for t in tracks) <= CameraObstacles().growth_most_mps
    assert max(t.tube_base_m for t in tracks) <= CameraObstacles().tube_most_m


def test_the_map_begins_empty_and_has_the_rooms_size():
    estimator = scene()
    memory = estimator.init()
    assert memory.voxels.occupied.shape == tuple(np.ceil((ROOM[1] - ROOM[0]) / VOXEL).astype(int))
    assert len(estimator.watches) == TEAM.count


@pytest.mark.parametrize("wrong", [{"step_px": 0}, {"range_m": 6.0}, {"least_points": 0}])
def test_rules_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match="must"):
        ViewRules(**wrong)
