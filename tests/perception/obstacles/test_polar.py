# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.stats import chi2

from skyhaul.perception.obstacles.api import Bearings, bearings
from skyhaul.perception.obstacles.births import BirthRules
from skyhaul.perception.obstacles.polar import (
    Polar,
    gate,
    innovation,
    polar,
    stacked,
    triangulate,
)

from .conftest import CAMERAS, SIGMA_RAD, Swing, seen_by


def exact(camera, points, sigma_rad=SIGMA_RAD):
    rel = np.atleast_2d(points) - CAMERAS[camera]
    distance = np.linalg.norm(rel, axis=1, keepdims=True)
    half = np.arcsin(0.2 / distance[:, 0])
    return polar(bearings(0, camera, CAMERAS[camera], rel / distance, sigma_rad, half))


def test_residual_vanishes_at_the_obstacle_and_its_jacobian_is_that_of_differences():
    rng = np.random.default_rng(0)
    p = CAMERAS[1] + rng.normal(size=3) * 3.0
    rel = p - CAMERAS[1]
    distance = np.linalg.norm(rel)
    z = polar(Bearings(
        0, 1, CAMERAS[1], np.zeros(3), rel[None] / distance, np.array([0.01]), np.array([0.1]),
        np.array([distance]), np.array([0.1]), np.zeros(1), np.ones(1),
    ))  # fmt: skip
    assert np.abs(innovation(p, z).residual).max() < 1e-12
    q = p + 0.3 * rng.normal(size=3)
    H = innovation(q, z).H[0]
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        ahead, back = (innovation(q + s, z).residual[0] for s in (step, -step))
        np.testing.assert_allclose((back - ahead) / 2e-6, H[:, axis], atol=1e-7)


def test_gates_are_those_of_the_linearised_measurements():
    """Against NumPy's inverse and determinant of S from `innovation`."""
    rng = np.random.default_rng(1)
    points = np.array([[3.0, 1.0, 2.0], [-2.0, 2.5, 1.0], [0.5, -3.0, 2.5]])
    z = seen_by(0, [Swing(tuple(p), (0.0, 0.0, 0.0)) for p in points], 0, rng, ranged=True)[0]
    z = polar(z)
    root = rng.normal(size=(3, 6, 6))
    cov = 0.01 * root @ np.swapaxes(root, -1, -2)
    z = z._replace(age_s=np.full(3, 0.04))
    x = np.concatenate([points + 0.1, rng.normal(size=(3, 3))], axis=1)
    squared, log_det = gate(x, cov, z)
    for i in range(3):
        for j in range(len(z.camera)):
            found = innovation(x[i, :3] - 0.04 * x[i, 3:], Polar(*(a[j] for a in z)))
            if found.ahead > 0.0:
                G = np.concatenate([found.H, -0.04 * found.H], axis=1)
                S = G @ cov[i] @ G.T + np.diag(z.variance[j])
                y = found.residual
                np.testing.assert_allclose(squared[i, j], y @ np.linalg.solve(S, y), rtol=1e-8)
                np.testing.assert_allclose(log_det[i, j], np.log(np.linalg.det(S)), rtol=1e-8)
    assert np.isfinite(squared).sum() == 3


def test_axes_of_a_measurement_are_right_handed_around_its_direction():
    d = np.random.default_rng(2).normal(size=(40, 3))
    d[0], d[1] = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    axes = polar(bearings(0, 0, np.zeros(3), d, 0.01, np.full(40, 0.1))).axes
    np.testing.assert_allclose(axes @ np.swapaxes(axes, -1, -2), np.tile(np.eye(3), (40, 1, 1)),
                               atol=1e-12)  # fmt: skip
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)
    np.testing.assert_array_equal(axes[:, 2], d)


def test_a_gate_is_closed_for_what_is_behind_the_camera():
    z = exact(0, [3.0, 1.0, 2.0])
    p = np.stack([[3.0, 1.0, 2.0], 2 * CAMERAS[0] - [3.0, 1.0, 2.0]])
    x = np.concatenate([p, np.zeros((2, 3))], axis=1)
    squared, _ = gate(x, 0.01 * np.tile(np.eye(6), (2, 1, 1)), z)
    assert squared[0, 0] < 1e-12
    assert np.isinf(squared[1, 0])


def test_triangulation_is_exact_for_exact_rays():
    p = np.array([2.5, -1.0, 3.0])
    z = stacked([exact(c, p) for c in range(4)])
    found, _ = triangulate(z, p + np.array([0.3, -0.2, 0.3]))
    np.testing.assert_allclose(found, p, atol=2e-3)


def test_covariance_of_a_triangulation_is_that_of_its_errors():
    """Normalised error squared is chi-square: its mean over trials, in its 99.9 % interval."""
    mover, rng, trials = Swing((2.5, -1.0, 3.0), (0.0, 0.0, 0.0)), np.random.default_rng(2), 800
    squared = []
    for _ in range(trials):
        parts = [polar(seen_by(c, [mover], 0, rng, miss=0.0)[0]) for c in range(4)]
        p, cov = triangulate(stacked(parts), mover.place(0.0) + 0.1)
        e = p - mover.place(0.0)
        squared.append(e @ np.linalg.solve(cov, e))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * trials) / trials
    assert low < np.mean(squared) < high


def test_obstacles_are_born_where_rays_of_several_cameras_meet_and_each_once():
    points = np.array([[3.0, 1.0, 2.0], [-2.0, 2.5, 1.0], [0.5, -3.0, 2.5]])
    rng = np.random.default_rng(3)
    parts = [exact(c, points[rng.permutation(3)]) for c in range(4)]
    born = BirthRules().born(stacked(parts))
    assert len(born) == 3
    assert all(len(b.cameras) == 4 for b in born)
    off = [min(np.linalg.norm(b.p_WO - p) for p in points) for b in born]
    assert max(off) < 0.01
    np.testing.assert_allclose(np.exp([b.log_radius for b in born]), 0.2, rtol=0.02)


def test_a_range_places_what_one_camera_sees():
    rng, mover = np.random.default_rng(4), Swing((3.0, 1.0, 2.0), (0.0, 0.0, 0.0))
    z = polar(seen_by(0, [mover], 0, rng, miss=0.0, ranged=True)[0])
    (born,) = BirthRules().born(z)
    assert np.linalg.norm(born.p_WO - mover.place(0.0)) < 0.3


def test_without_a_range_one_camera_places_by_size_and_says_how_unsure_it_is():
    """Over sizes drawn as the rule says, errors are as large as the covariance."""
    rng, rules, squared = np.random.default_rng(5), BirthRules(extent_sigma=0.05), []
    assert BirthRules(radius_spread=0.0).born(exact(0, [3.0, 1.0, 2.0])) == []
    for _ in range(300):
        radius = rules.usual_radius_m * np.exp(rules.radius_spread * rng.normal())
        mover = Swing((3.0, 1.0, 2.0), (0.0, 0.0, 0.0), radius_m=radius)
        z = polar(seen_by(0, [mover], 0, rng, miss=0.0)[0])
        (born,) = rules.born(z)
        away = mover.place(0.0) - z.p_WC[0]
        e = np.log(np.linalg.norm(born.p_WO - z.p_WC[0]) / np.linalg.norm(away))
        sigma = np.sqrt(z.axes[0, 2] @ born.covariance[:3, :3] @ z.axes[0, 2])
        squared.append((e * np.linalg.norm(born.p_WO - z.p_WC[0]) / sigma) ** 2)
    assert np.mean(squared) == pytest.approx(1.0, abs=0.25)


def test_rays_that_see_different_sizes_are_not_of_one_obstacle():
    p = np.array([3.0, 1.0, 2.0])
    a, b = exact(0, p), exact(1, p)
    assert len(BirthRules().born(stacked([a, b]))) == 1
    born = BirthRules().born(stacked([a, b._replace(half_angle=4.0 * b.half_angle)]))
    assert [len(x.rows) for x in born] == [1, 1]


def test_what_is_vague_gives_birth_to_nothing():
    assert BirthRules().born(exact(0, [3.0, 1.0, 2.0], sigma_rad=0.1)) == []
