# SPDX-License-Identifier: Apache-2.0
"""Tests of `geometry.distance`, `geometry.gjk` and `geometry.team_clearance`."""

import itertools

import mujoco
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from skyhaul.geometry.distance import (
    bounding_radius,
    lowest_point,
    shape_distance,
    team_clearance,
    team_clearance_gradient,
    team_clearances,
)
from skyhaul.geometry.shapes import BOX, CAPSULE, CYLINDER, SPHERE, ShapeArrays

KINDS = (SPHERE, BOX, CAPSULE, CYLINDER)
PAIRS = list(itertools.combinations_with_replacement(KINDS, 2))
TEAM = (0.6, 1.0, 0.1)  # radius, above, below [m]


def row(kind, size, p, R):
    return ShapeArrays(
        np.array([kind]),
        np.array(size, float).reshape(1, 3),
        np.array(p, float).reshape(1, 3),
        np.array(R, float).reshape(1, 3, 3),
    )


def random_shape(rng, kind, spread):
    used = {SPHERE: 1, BOX: 3, CAPSULE: 2, CYLINDER: 2}[kind]
    size = np.zeros(3)
    size[:used] = rng.uniform(0.05, 0.6, used)
    return row(kind, size, rng.uniform(-spread, spread, 3), Rotation.random(rng=rng).as_matrix())


def distance(a, b):
    return shape_distance(a, 0, b, 0)


def point_sdf(s, p):
    """Signed distance of points (k, 3) to a shape, written from the definitions."""
    x = np.abs((p - s.p_WO[0]) @ s.R_WO[0])
    size = s.size[0]
    match s.kind[0]:
        case 0:
            return np.linalg.norm(x, axis=1) - size[0]
        case 1:
            e = x - size
        case 2:
            x[:, 2] = np.maximum(x[:, 2] - size[1], 0.0)
            return np.linalg.norm(x, axis=1) - size[0]
        case 3:
            e = np.column_stack([np.hypot(x[:, 0], x[:, 1]) - size[0], x[:, 2] - size[1]])
    return np.linalg.norm(np.maximum(e, 0.0), axis=1) + np.minimum(e.max(axis=1), 0.0)


def brute_distance(a, b):
    """Smallest distance by projecting from one shape to the other until nothing changes."""

    def gap(p):
        return max(point_sdf(a, p[None])[0], point_sdf(b, p[None])[0])

    # the deepest common level of both distance fields is half the distance of separated shapes
    starts = [a.p_WO[0], b.p_WO[0], 0.5 * (a.p_WO[0] + b.p_WO[0])]
    best = np.inf
    for start in starts:
        p = start
        for _ in range(4):
            options = {"xatol": 1e-11, "fatol": 1e-13, "maxiter": 4000, "maxfev": 4000}
            result = minimize(gap, p, method="Nelder-Mead", options=options)
            p = result.x
        best = min(best, result.fun)
    return 2.0 * best


@pytest.mark.parametrize(("ka", "kb"), PAIRS)
def test_separated_shapes_match_a_brute_force_search(ka, kb):
    rng = np.random.default_rng([1, ka, kb])
    found = []
    while len(found) < 4:
        a, b = random_shape(rng, ka, 1.0), random_shape(rng, kb, 1.0)
        d = distance(a, b)
        if d > 0.02:
            found.append((d, brute_distance(a, b)))
    d, brute = np.array(found).T
    np.testing.assert_allclose(d, brute, atol=1e-6)


@pytest.mark.parametrize(("ka", "kb"), PAIRS)
def test_the_sign_tells_whether_the_shapes_share_a_point(ka, kb):
    rng = np.random.default_rng([2, ka, kb])
    for _ in range(60):
        a, b = random_shape(rng, ka, 0.6), random_shape(rng, kb, 0.6)
        inside = rng.uniform(-1.0, 1.0, (20_000, 3)) * bounding_radius(a, 0) + a.p_WO[0]
        shared = np.min(np.maximum(point_sdf(a, inside), point_sdf(b, inside))) < 0.0
        assert not (shared and distance(a, b) > 0.0)


@pytest.mark.parametrize(("ka", "kb"), PAIRS)
def test_distance_along_a_straight_motion_is_convex_and_changes_no_faster_than_the_motion(ka, kb):
    rng = np.random.default_rng([3, ka, kb])
    for _ in range(5):
        a, b = random_shape(rng, ka, 0.3), random_shape(rng, kb, 0.3)
        u = rng.normal(size=3)
        u /= np.linalg.norm(u)
        path = np.linspace(-3.0, 3.0, 61)
        d = np.array([distance(a, b._replace(p_WO=b.p_WO + s * u)) for s in path])
        apart = np.minimum(np.minimum(d[:-2], d[1:-1]), d[2:]) > 0.0
        assert np.all(np.diff(d, 2)[apart] >= -3e-8)
        positive = (d[1:] > 0.0) & (d[:-1] > 0.0)
        assert np.all(np.abs(np.diff(d))[positive] <= 0.1 + 3e-8)


@pytest.mark.parametrize(("ka", "kb"), PAIRS)
def test_distance_is_symmetric_and_ignores_the_world_frame(ka, kb):
    rng = np.random.default_rng([4, ka, kb])
    for _ in range(50):
        a, b = random_shape(rng, ka, 1.0), random_shape(rng, kb, 1.0)
        R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
        a2 = a._replace(p_WO=a.p_WO @ R.T + t, R_WO=R @ a.R_WO)
        b2 = b._replace(p_WO=b.p_WO @ R.T + t, R_WO=R @ b.R_WO)
        d = distance(a, b)
        np.testing.assert_allclose(distance(b, a), d, atol=3e-8)
        np.testing.assert_allclose(distance(a2, b2), d, atol=3e-8)


def mujoco_distance(a, b):
    spec = mujoco.MjSpec()
    for s in (a, b):
        body = spec.worldbody.add_body(pos=s.p_WO[0])
        quat = Rotation.from_matrix(s.R_WO[0]).as_quat(scalar_first=True)
        kind = {SPHERE: "SPHERE", BOX: "BOX", CAPSULE: "CAPSULE", CYLINDER: "CYLINDER"}
        geom_type = getattr(mujoco.mjtGeom, "mjGEOM_" + kind[int(s.kind[0])])
        body.add_geom(type=geom_type, size=s.size[0], quat=quat)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None)


@pytest.mark.parametrize(("ka", "kb"), PAIRS)
def test_separated_shapes_agree_with_mujoco(ka, kb):
    rng = np.random.default_rng([5, ka, kb])
    ours, theirs = [], []
    while len(ours) < 20:
        a, b = random_shape(rng, ka, 1.5), random_shape(rng, kb, 1.5)
        d = distance(a, b)
        if d > 1e-3:
            ours.append(d)
            theirs.append(mujoco_distance(a, b))
    np.testing.assert_allclose(ours, theirs, atol=2e-6)


def test_overlapping_boxes_have_the_exact_depth():
    rng = np.random.default_rng(6)
    for _ in range(50):
        ha, hb = rng.uniform(0.1, 0.6, (2, 3))
        offset = rng.uniform(-0.05, 0.05, 3)
        R = Rotation.random(rng=rng).as_matrix()
        a, b = row(BOX, ha, np.zeros(3), R), row(BOX, hb, R @ offset, R)
        np.testing.assert_allclose(distance(a, b), -np.min(ha + hb - np.abs(offset)), atol=1e-12)


def test_depth_bound_is_enough_to_part_the_shapes():
    """Some translation no longer than the depth parts the shapes: we try a dense set."""
    rng = np.random.default_rng(7)
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for ka, kb in PAIRS:
        a, b = random_shape(rng, ka, 0.15), random_shape(rng, kb, 0.15)
        depth = -distance(a, b)
        assert depth > 0.0
        moved = [distance(a, b._replace(p_WO=b.p_WO + 1.15 * depth * u)) for u in directions]
        assert max(moved) > 0.0


def test_lowest_point_is_the_support_of_the_shape():
    rng = np.random.default_rng(8)
    for kind in KINDS:
        s = random_shape(rng, kind, 1.0)
        p = s.p_WO[0] + rng.uniform(-1.0, 1.0, (400_000, 3)) * bounding_radius(s, 0)
        p = p[point_sdf(s, p) <= 0.0]
        for axis, sign in itertools.product(range(3), (1.0, -1.0)):
            sampled = np.min(sign * p[:, axis])
            exact = lowest_point(s, 0, axis, sign)
            assert exact - 1e-9 <= sampled <= exact + 0.06


def team_as_cylinder(p):
    radius, above, below = TEAM
    half = 0.5 * (above + below)
    return row(
        CYLINDER, [radius, half, 0.0], p + np.array([0, 0, 0.5 * (above - below)]), np.eye(3)
    )


def upright(rng, kind):
    s = random_shape(rng, kind, 2.0)
    yaw = Rotation.from_euler("z", rng.uniform(-3, 3)).as_matrix()
    return s._replace(R_WO=yaw[None]) if kind == BOX else s


@pytest.mark.parametrize("kind", [SPHERE, BOX, CAPSULE])
def test_team_clearance_is_the_distance_of_its_cylinder(kind):
    rng = np.random.default_rng([9, kind])
    n_apart = 0
    for _ in range(300):
        s, p = upright(rng, kind), rng.uniform(-0.5, 0.5, 3)
        ours = team_clearance(*TEAM, p, kind, s.size[0], s.p_WO[0], s.R_WO[0])
        reference = distance(team_as_cylinder(p), s)
        n_apart += reference > 1e-6
        if reference > 1e-6:
            np.testing.assert_allclose(ours, reference, atol=1e-7)
        else:
            assert ours <= 1e-6
            assert ours >= reference - 1e-7  # theirs is an upper bound of the depth
    assert 100 < n_apart < 300


@pytest.mark.parametrize("kind", [SPHERE, BOX, CAPSULE])
def test_gradient_is_the_finite_difference_and_unit(kind):
    rng = np.random.default_rng([10, kind])
    n_smooth = 0
    for _ in range(200):
        s, p = upright(rng, kind), rng.uniform(-0.5, 0.5, 3)
        args = (kind, s.size[0], s.p_WO[0], s.R_WO[0])
        d, *g = team_clearance_gradient(*TEAM, p, *args)
        assert d == team_clearance(*TEAM, p, *args)
        np.testing.assert_allclose(np.linalg.norm(g), 1.0, atol=1e-9)
        h = 1e-6
        ahead = [(team_clearance(*TEAM, p + e, *args) - d) / h for e in h * np.eye(3)]
        behind = [(d - team_clearance(*TEAM, p - e, *args)) / h for e in h * np.eye(3)]
        smooth = np.max(np.abs(np.subtract(ahead, behind))) < 1e-3
        n_smooth += smooth
        error = np.max(np.abs(0.5 * np.add(ahead, behind) - g))
        core_overlaps = kind == CAPSULE and d < -s.size[0, 0]  # a direction, not the gradient
        assert error < 1e-3 or not smooth or core_overlaps
    assert n_smooth >= 190


def test_team_clearances_is_the_loop():
    rng = np.random.default_rng(11)
    rows = [upright(rng, k) for k in (SPHERE, BOX, CAPSULE, BOX)]
    s = ShapeArrays(*(np.concatenate(column) for column in zip(*rows, strict=True)))
    p = np.array([0.1, -0.2, 0.3])
    loop = [team_clearance(*TEAM, p, r.kind[0], r.size[0], r.p_WO[0], r.R_WO[0]) for r in rows]
    np.testing.assert_array_equal(team_clearances(TEAM, p, *s), loop)
