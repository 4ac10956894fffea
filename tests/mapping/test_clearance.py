# SPDX-License-Identifier: Apache-2.0
"""The one clearance function: never above the truth, tubes in time, gradients."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.shapes import Box, Capsule, Sphere, pose_shapes
from skyhaul.geometry.so3 import so3_exp
from skyhaul.geometry.team_clearance import team_clearances
from skyhaul.mapping.api import WorldMap
from skyhaul.mapping.clearance import map_clearance, map_clearance_gradient
from skyhaul.mapping.mapper import Mapping
from skyhaul.model.envelope import TeamShape
from skyhaul.model.state import TeamState
from skyhaul.perception.api import ObstacleEstimate, StaticObject, Track
from skyhaul.world.scenario import MapFrame, Room

SHAPE = TeamShape(radius_m=0.5, above_m=0.8, below_m=0.2)
DIMS = (0.5, 0.8, 0.2)
FRAME = MapFrame(origin_m=(-1.0, -1.0, 0.0), size_m=(6.0, 5.0, 4.0))
ROOM = Room(min_m=(-1.0, -1.0, 0.0), max_m=(5.0, 4.0, 4.0))


def team_at(p_WL) -> TeamState:
    z = np.zeros
    return TeamState(
        np.array(p_WL, np.float64), np.array([1.0, 0, 0, 0]), z(3), z(3),
        z((4, 3)), z((4, 4)), z((4, 3)), z((4, 3)),
    )  # fmt: skip


def statics(seed, count=5) -> tuple[StaticObject, ...]:
    rng = np.random.default_rng(seed)
    kinds = [
        Sphere(radius_m=0.3),
        Box(size_m=(0.5, 0.3, 0.9), yaw_deg=30.0),
        Capsule(radius_m=0.1, length_m=1.0),
    ]
    out = []
    for i in range(count):
        shape = kinds[rng.integers(3)]
        p = rng.uniform([-0.5, -0.5, 0.3], [4.5, 3.5, 3.5])
        out.append(StaticObject(i, shape, p, pose_shapes([shape], p).R_WO[0]))
    return tuple(out)


def track(seed, stamp_us=0, **changes) -> Track:
    rng = np.random.default_rng(seed)
    values = {
        "track_id": seed,
        "stamp_us": stamp_us,
        "shape": Capsule(radius_m=0.2, length_m=0.4),
        "p_WO": rng.uniform([0, 0, 0.5], [4, 3, 3.5]),
        "R_WO": so3_exp(rng.normal(size=3)),
        "v_WO": rng.normal(size=3) * 0.4,
        "covariance": np.zeros((6, 6)),
        "growth_mps": 0.1,
        "tube_base_m": 0.04,
    }
    return Track(**(values | changes))


def world_map(
    objects=(), tracks=(), stamp_us=0, frame=FRAME, p_WL=(9.0, 9.0, 9.0), exempt_m=0.0
) -> WorldMap:
    mapper = Mapping(truncation_m=1.5, exempt_m=exempt_m).build(frame, ROOM, SHAPE)
    estimate = ObstacleEstimate(stamp_us, tuple(objects), tuple(tracks))
    return mapper.step(mapper.init(), estimate, team_at(p_WL))[1]


def places(seed, count=400) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-0.9, -0.9, 0.1], [4.9, 3.9, 3.9], (count, 3))


def true_static(objects, p) -> np.ndarray:
    """Exact clearance of the cylinder to shapes and room."""
    rows = pose_shapes([o.shape for o in objects], np.array([o.p_WO for o in objects]))
    d = np.array([team_clearances(DIMS, q, *rows).min() for q in p])
    flat = np.minimum(p[:, :2] - ROOM.min_m[:2], np.array(ROOM.max_m[:2]) - p[:, :2]).min(axis=1)
    room = np.minimum(flat - 0.5, np.minimum(4.0 - p[:, 2] - 0.8, p[:, 2] - 0.2))
    return np.minimum(d, room)


@pytest.mark.parametrize("seed", range(6))
def test_static_clearance_never_exceeds_the_truth_and_is_not_far_below(seed):
    objects, p = statics(seed), places(seed)
    found = map_clearance(world_map(objects), p, np.zeros(len(p)))
    truth = true_static(objects, p)
    assert np.all(found <= truth + 1e-6)
    outside = (truth > 0.1) & (truth < 1.2)
    # a voxel reaches a diagonal past the shape at most, and half a diagonal is taken off
    assert np.max((truth - found)[outside]) < 1.5 * np.sqrt(3.0) * 0.1


def test_between_two_voxel_centres_the_clearance_is_continuous():
    m = world_map(statics(2))
    p = np.linspace([0.0, 0.1, 0.5], [4.0, 3.0, 3.5], 20_001)
    c = m.clearance(p, np.zeros(len(p)))
    step = np.linalg.norm(p[1] - p[0])
    assert np.max(np.abs(np.diff(c))) < 3.0 * step + 1e-6


@pytest.mark.parametrize("seed", range(5))
def test_moving_clearance_is_that_to_the_shape_moved_and_grown(seed):
    t = replace(track(seed), stamp_us=300_000)
    m, rng = world_map((), (t,), stamp_us=500_000), np.random.default_rng(seed)
    p, t_us = places(seed, 60), rng.integers(500_000, 4_000_000, 60)
    for q, now, found in zip(p, t_us, m.clearance(p, t_us), strict=True):
        dt = (now - t.stamp_us) / 1e6
        rows = pose_shapes([t.shape], t.p_WO + dt * t.v_WO)._replace(R_WO=t.R_WO[None])
        tube = team_clearances(DIMS, q, *rows)[0] - t.tube_m(dt)
        assert found == pytest.approx(min(tube, map_clearance(world_map(), q[None], [0])[0]))


def test_beyond_the_horizon_the_tubes_of_movers_do_not_count():
    t = track(1, v_WO=np.array([0.1, 0, 0]), p_WO=np.array([1.45, 1.5, 2.0]))
    c = world_map((), (t,)).clearance(np.tile([2.0, 1.5, 2.0], (2, 1)), np.array([5.4e6, 5.6e6]))
    assert c[0] < 0.0 < c[1]


def test_a_mover_that_stands_is_taken_to_stand_on():
    t = track(1, v_WO=np.zeros(3), p_WO=np.array([2.0, 1.5, 2.0]))
    m, p = world_map((), (t,)), np.tile([2.0, 1.5, 2.0], (2, 1))
    at_horizon, later = m.clearance(p, np.array([5.5e6, 60e6]))
    assert later == at_horizon < 0.0
    np.testing.assert_allclose(map_clearance_gradient(m, p, [5.5e6, 60e6]).track, at_horizon)


def test_the_floor_is_exempt_in_the_lift_off_column_only():
    m = world_map(p_WL=(1.0, 1.0, 0.04), exempt_m=0.6)
    c = m.clearance(np.array([[1.0, 1.0, 0.05], [1.0, 2.5, 0.05]]), np.zeros(2))
    assert c[0] > 0.0
    assert c[1] == pytest.approx(0.05 - 0.2)


@pytest.mark.parametrize("seed", range(4))
def test_clearances_with_gradient_are_the_same_and_the_gradient_is_their_slope(seed):
    m, p = world_map(statics(seed), (track(seed), track(seed + 50))), places(seed, 300)
    t_us = np.full(len(p), 1_200_000)
    g = map_clearance_gradient(m, p, t_us)
    both = np.minimum(g.static, g.track.min(axis=1))
    np.testing.assert_allclose(both, m.clearance(p, t_us), atol=1e-12)
    h, smooth = 1e-5, 0
    for j in range(2):
        slope = np.empty((len(p), 3))
        for a in range(3):
            up, down = p.copy(), p.copy()
            up[:, a] += h
            down[:, a] -= h
            ahead, behind = (
                map_clearance_gradient(m, up, t_us),
                map_clearance_gradient(m, down, t_us),
            )
            slope[:, a] = (ahead.track[:, j] - behind.track[:, j]) / (2.0 * h)
        even = np.linalg.norm(slope, axis=1) > 1.0 - 1e-6  # not at a kink
        np.testing.assert_allclose(g.track_grad[even, j], slope[even], atol=1e-4)
        smooth += even.sum()
    assert smooth > 400


def test_following_the_static_gradient_leads_away_from_what_is_nearest():
    m, p = world_map(statics(3)), places(3)
    t = np.zeros(len(p))
    g = map_clearance_gradient(m, p, t)
    near = (g.static < 1.0) & (np.linalg.norm(g.static_grad, axis=1) > 0.5)
    gain = map_clearance_gradient(m, p + 0.02 * g.static_grad, t).static - g.static
    assert np.mean(gain[near] > 0.0) > 0.97


WINDOW = MapFrame(
    origin_m=(-1.0, -1.0, 0.0), size_m=(6.0, 5.0, 4.0), window_m=(3.0, 3.0, 3.0), coarse_voxel_m=0.5
)


@pytest.mark.parametrize("seed", range(6))
def test_with_a_rolling_window_it_never_exceeds_the_truth_anywhere(seed):
    objects, p = statics(seed), places(seed)
    m = world_map(objects, frame=WINDOW, p_WL=(2.0, 1.5, 2.0))
    assert np.all(m.clearance(p, np.zeros(len(p))) <= true_static(objects, p) + 1e-6)


def test_deep_inside_the_window_it_is_as_sharp_as_the_whole_map():
    objects = (StaticObject(0, Sphere(radius_m=0.3), np.array([2.0, 1.5, 2.6]), np.eye(3)),)
    p = np.array([[2.0, 1.5, 1.2], [1.9, 1.4, 1.3]])
    whole, window = world_map(objects), world_map(objects, frame=WINDOW, p_WL=(2.0, 1.5, 2.0))
    np.testing.assert_allclose(window.clearance(p, [0, 0]), whole.clearance(p, [0, 0]), atol=1e-6)
