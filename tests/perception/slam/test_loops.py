# SPDX-License-Identifier: Apache-2.0
"""Loops: a place seen again takes the drift out, one that only looks alike does not."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan
from skyhaul.geometry.quaternion import R_to_quat, quat_to_R
from skyhaul.geometry.so3 import rotation_z, so3_exp, so3_log
from skyhaul.perception.slam.closure import ClosureRules, close, match
from skyhaul.perception.slam.keyframes import KeyframeRules
from skyhaul.perception.slam.loops import LoopRules, on_map
from skyhaul.perception.slam.places import Corners, Place
from skyhaul.perception.vio.api import CameraRig, NavState, VioEstimate, VioStatus

LENS = RadTan.from_fov((320, 240), 84.0).arrays()
# two cameras, to the front and to the left: z of a camera along x and along y of the body
FRONT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
RIG = CameraRig(
    np.array([FRONT, rotation_z(np.pi / 2) @ FRONT]), np.array([[0.1, 0, 0], [0, 0.1, 0]])
)
RULES = LoopRules(keyframes=KeyframeRules(learn_from=4, words=64), least_gap_s=5.0)
FOCAL = LENS.fx


@pytest.fixture(scope="module")
def world():
    """Points on the walls of a hall of 16 x 8 x 4 m, each with a descriptor of its own."""
    rng = np.random.default_rng(0)
    walls = []
    for _ in range(900):
        p = rng.uniform([-8, -4, 0], [8, 4, 4])
        axis = rng.integers(2)
        p[axis] = np.sign(p[axis]) * (8.0, 4.0)[axis]
        walls.append(p)
    return np.array(walls), rng.integers(0, 256, (900, 32), dtype=np.uint8)


def place_of(world, stamp_us, true, held, rng, sigma=1e-4):
    """A keyframe at a true pose (R, p) that the odometry holds for another."""
    points, names = world
    R, p = true
    i = (points - p) @ R  # body axes
    camera, xy, seen = [], [], []
    for c in range(2):
        z = (i - RIG.p_IC[c]) @ RIG.R_IC[c]
        flat = z[:, :2] / np.maximum(z[:, 2:], 1e-3)
        ok = (z[:, 2] > 0.3) & (np.abs(flat[:, 0]) < 0.9) & (np.abs(flat[:, 1]) < 0.67)
        rows = np.flatnonzero(ok)
        camera.append(np.full(len(rows), c))
        xy.append(flat[rows] + 1e-3 * rng.normal(size=(len(rows), 2)))
        seen.append(rows)
    rows = np.concatenate(seen)
    bits = np.unpackbits(names[rows], axis=1) ^ (rng.random((len(rows), 256)) < 0.05)
    corners = Corners(np.concatenate(camera), np.concatenate(xy), np.packbits(bits, axis=1))
    known = rng.permutation(np.unique(rows))[:60]
    R_held, p_held = held
    return Place(
        stamp_us, R_held, p_held, np.diag(np.repeat([sigma, 1e-4], 3)), corners,
        i[known] + 0.02 * rng.normal(size=(len(known), 3)), names[known],
    )  # fmt: skip


def there_and_back(n=24):
    """True poses: 6 m along x, and back."""
    x = np.concatenate([np.linspace(-3, 3, n // 2), np.linspace(3, -3, n // 2)])
    return [(rotation_z(0.2 * np.sin(a)), np.array([a, 0.3, 2.0])) for a in x]


def drifted(true, per_place_m, yaw=0.0):
    """The same as an odometry sees it that stretches the way along x and turns."""
    out = []
    for k, (R, p) in enumerate(true):
        turn = rotation_z(yaw * k)
        out.append((turn @ R, turn @ p + [per_place_m * k, 0.0, 0.0]))
    return out


def flown(world, true, held, rules=RULES, sigma=1e-4):
    rng, closer = np.random.default_rng(3), rules.build(RIG, (LENS, LENS))
    memory = closer.init()
    for k, (a, b) in enumerate(zip(true, held, strict=True)):
        memory = closer.add(memory, place_of(world, 1_000_000 * k, a, b, rng, (k + 1) * sigma))
    return memory


def state_of(held):
    R, p = held
    return NavState(p, R_to_quat(R), np.zeros(3), np.zeros(3), np.zeros(3))


def test_the_pose_of_now_is_found_from_the_points_of_then(world):
    rng = np.random.default_rng(1)
    a = (rotation_z(0.1), np.array([1.0, 0.5, 2.0]))
    b = (rotation_z(0.3) @ so3_exp(np.array([0.02, -0.03, 0.0])), np.array([1.3, 0.2, 1.8]))
    old, now = place_of(world, 0, a, a, rng), place_of(world, 1, b, b, rng)
    found = close(ClosureRules(), RIG, FOCAL, old, now.corners)
    R, p = a[0].T @ b[0], a[0].T @ (b[1] - a[1])
    assert np.linalg.norm(found.p - p) < 0.02
    assert np.linalg.norm(so3_log(R.T @ found.R)) < 0.005
    assert found.inliers > 0.8 * found.matches
    e = np.concatenate([found.R.T @ (p - found.p), so3_log(found.R.T @ R)])
    assert e @ np.linalg.solve(found.covariance, e) < 22.5  # 99.9 %


def test_another_place_gives_no_pose(world):
    rng = np.random.default_rng(2)
    a = (rotation_z(np.pi), np.array([-5.0, 0.0, 2.0]))
    b = (np.eye(3), np.array([5.0, 0.0, 2.0]))
    old, now = place_of(world, 0, a, a, rng), place_of(world, 1, b, b, rng)
    assert close(ClosureRules(), RIG, FOCAL, old, now.corners) is None


def test_matches_are_mutual_and_clear():
    rng = np.random.default_rng(4)
    old = rng.integers(0, 256, (40, 32), dtype=np.uint8)
    now = old[::-1].copy()
    i, j = match(ClosureRules(), old, now)
    np.testing.assert_array_equal(j, 39 - i)
    assert len(i) == 40
    twice = np.vstack([now, now])  # each looks like two
    assert len(match(ClosureRules(), old, twice)[0]) == 0


def test_a_loop_takes_the_drift_out(world):
    true = there_and_back()
    held = drifted(true, 0.01, yaw=0.002)
    memory = flown(world, true, held)
    assert len(memory.loops) > 5
    p, q = on_map(memory, state_of(held[-1]))
    before = np.linalg.norm(held[-1][1] - true[-1][1])
    assert np.linalg.norm(p - true[-1][1]) < before / 3.0
    assert np.linalg.norm(so3_log(true[-1][0].T @ quat_to_R(q))) < 0.02
    # the graph holds all of the way, not only its end
    off = [np.linalg.norm(a - b[1]) for a, b in zip(memory.graph_p, true, strict=True)]
    assert max(off) < 0.08


def test_without_drift_loops_change_next_to_nothing(world):
    true = there_and_back()
    memory = flown(world, true, true)
    assert len(memory.loops) > 5
    assert np.linalg.norm(on_map(memory, state_of(true[-1]))[0] - true[-1][1]) < 0.02


def test_a_place_that_only_looks_alike_is_further_off_than_the_odometry_can_be(world):
    """The way out repeats 3 m further on, point for point: a hall with the same door twice."""
    n = 12
    out = there_and_back(2 * n)[:n]
    further = np.array([3.0, 1.0, 0.0])
    alias = [(R, p + further) for R, p in out]  # there the odometry holds it, and is right
    rng, closer = np.random.default_rng(5), RULES.build(RIG, (LENS, LENS))
    memory = closer.init()
    for k, (a, held) in enumerate([*zip(out, out, strict=True), *zip(out, alias, strict=True)]):
        memory = closer.add(memory, place_of(world, 1_000_000 * k, a, held, rng))
    assert memory.loops  # along the way out: places see each other's points
    assert all(loop.j < n or loop.i >= n for loop in memory.loops)
    assert np.linalg.norm(on_map(memory, state_of(alias[-1]))[0] - alias[-1][1]) < 0.05


def test_after_long_blindness_a_place_that_is_recognised_brings_the_map_back(world):
    """LOST: the odometry dead-reckons, its covariance grows, keyframes go on by time."""
    true = there_and_back()
    held = list(drifted(true, 0.0))
    for k in range(16, 24):
        held[k] = (held[k][0], held[k][1] + [0.0, 0.25 * (k - 15), 0.0])  # 2 m off at the end
    rng, closer = np.random.default_rng(6), RULES.build(RIG, (LENS, LENS))
    memory = closer.init()
    for k, (a, b) in enumerate(zip(true, held, strict=True)):
        sigma = 1e-4 if k < 16 else (0.2 * (k - 15)) ** 2
        place = place_of(world, 1_000_000 * k, a, b, rng, sigma)
        if 16 <= k < 20:  # sees nothing
            none = Corners(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 32), np.uint8))
            place = replace(place, corners=none, p_IP=np.zeros((0, 3)), descriptor=none.descriptor)
        memory = closer.add(memory, place)
    assert np.linalg.norm(on_map(memory, state_of(held[-1]))[0] - true[-1][1]) < 0.1


def test_keyframes_go_by_way_turn_and_while_lost_by_time():
    closer, rng = RULES.build(RIG, (LENS, LENS)), np.random.default_rng(0)
    memory = closer.init()

    def estimate(t_s, x, yaw=0.0, status=VioStatus.TRACKING):
        state = state_of((rotation_z(yaw), np.array([x, 0.0, 0.0])))
        return VioEstimate(round(1e6 * t_s), status, state, np.eye(15), 0, 0)

    assert closer.due(memory, estimate(0.0, 0.0))
    memory = closer.add(
        memory,
        place_of((np.zeros((60, 3)) + 5.0, rng.integers(0, 256, (60, 32), dtype=np.uint8)), 0,
                 (np.eye(3), np.zeros(3)), (np.eye(3), np.zeros(3)), rng),
    )  # fmt: skip
    assert not closer.due(memory, estimate(0.1, 0.1))
    assert closer.due(memory, estimate(0.5, 0.6))
    assert closer.due(memory, estimate(0.5, 0.0, yaw=0.3))
    assert not closer.due(memory, estimate(9.0, 0.0))  # it stands
    assert closer.due(memory, estimate(0.6, 0.0, status=VioStatus.LOST))
    full = LoopRules(keyframes=KeyframeRules(most_places=1)).build(RIG, (LENS, LENS))
    assert not full.due(memory, estimate(0.5, 0.6))


def test_the_same_places_give_the_same_map(world):
    true = there_and_back()
    held = drifted(true, 0.01, yaw=0.002)
    a, b = flown(world, true, held), flown(world, true, held)
    assert a.graph_p.tobytes() == b.graph_p.tobytes()
    assert [(r.i, r.j) for r in a.loops] == [(r.i, r.j) for r in b.loops]
