# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2

from skyhaul.perception.obstacles.api import bearings
from skyhaul.perception.obstacles.motion import KalmanFilter
from skyhaul.perception.obstacles.particles import ParticleFilter
from skyhaul.perception.obstacles.polar import Polar, extents, innovation, polar
from skyhaul.perception.obstacles.tubes import radius_95

from .conftest import PERIOD_US, Swing, seen_by

DT_S = 1e-6 * PERIOD_US
FILTERS = [
    KalmanFilter(models="velocity", manoeuvre=0.3),
    KalmanFilter(models="acceleration"),
    KalmanFilter(models="both", manoeuvre=0.3),
    ParticleFilter(manoeuvre=0.3),
]
every_filter = pytest.mark.parametrize(
    "motion", FILTERS, ids=["velocity", "acceleration", "both", "particles"]
)


def exact_discretisation(A, G, dt_s):
    """F and Q of dx = A x dt + G dw by Van Loan's matrix exponential."""
    n = len(A)
    M = np.zeros((2 * n, 2 * n))
    M[:n, :n], M[:n, n:], M[n:, n:] = -A, G @ G.T, A.T
    E = expm(M * dt_s)
    F = E[n:, n:].T
    return F, F @ E[:n, n:]


@pytest.mark.parametrize("dt_s", [0.01, 0.3, 2.0])
def test_transition_is_the_exact_discretisation_of_its_motion(dt_s):
    params = KalmanFilter()
    F, Q = params.transition(dt_s)
    A, G = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [np.sqrt(params.manoeuvre)]])
    F_v, Q_v = exact_discretisation(A, G, dt_s)
    alpha = 1.0 / params.accel_time_s
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -alpha]])
    G = np.array([[0.0], [0.0], [params.accel_sigma_mps2 * np.sqrt(2.0 * alpha)]])
    F_a, Q_a = exact_discretisation(A, G, dt_s)
    for axis in range(3):
        at = np.ix_([axis, axis + 3, axis + 6], [axis, axis + 3, axis + 6])
        np.testing.assert_allclose(F[0][at][:2, :2], F_v, atol=1e-12)
        np.testing.assert_allclose(Q[0][at][:2, :2], Q_v, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(F[1][at], F_a, atol=1e-12)
        np.testing.assert_allclose(Q[1][at], Q_a, rtol=1e-6, atol=1e-12)


def test_two_steps_are_one_long_step_without_measurements():
    motion, rng = KalmanFilter(models="acceleration"), np.random.default_rng(0)
    start = motion.start(rng.normal(size=(4, 4)), np.tile(0.01 * np.eye(4), (4, 1, 1)), rng)
    twice = motion.predict(motion.predict(start, 0.2), 0.3)
    once = motion.predict(start, 0.5)
    for a, b in zip(twice, once, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-10)


def textbook_update(x, P, z, extent):
    """Iterated update with direction and range, then one with the extent, in NumPy."""
    start, likelihood = x.copy(), None
    G, R = np.zeros((3, 10)), np.diag(z.variance)
    for _ in range(3):
        found = innovation(x[:3] - z.age_s * x[3:6], z)
        G[:, :3], G[:, 3:6] = found.H, -z.age_s * found.H
        S = G @ P @ G.T + R
        K = P @ G.T @ np.linalg.inv(S)
        if likelihood is None:
            y = found.residual
            likelihood = np.exp(-0.5 * y @ np.linalg.solve(S, y)) / np.sqrt(np.linalg.det(S))
        x = start + K @ (found.residual - G @ (start - x))
    J = np.eye(10) - K @ G
    P = J @ P @ J.T + K @ R @ K.T
    rel = x[:3] - z.age_s * x[3:6] - z.p_WC
    g = np.concatenate([-rel, z.age_s * rel, np.zeros(4)]) / (rel @ rel)
    g[9] = 1.0
    y = extent[0] - (x[9] - np.log(np.linalg.norm(rel)))
    s = max(g @ P @ g + extent[1], y * y / 4.0)
    return x + P @ g * y / s, P - np.outer(P @ g, P @ g) / s, likelihood


@pytest.mark.parametrize("age_s", [0.0, 0.03])
def test_update_is_the_textbook_one(age_s):
    rng = np.random.default_rng(3)
    motion = KalmanFilter()
    z = polar(seen_by(1, [Swing((2.5, -1.0, 2.0), (0.0, 0.0, 0.0))] * 3, 0, rng, miss=0.0,
                      ranged=True)[0])  # fmt: skip
    z = z._replace(age_s=np.full(3, age_s))
    start = motion.start(
        np.tile([2.6, -0.9, 2.1, np.log(0.25)], (3, 1)), np.tile(0.02 * np.eye(4), (3, 1, 1)), rng
    )
    prior = motion.predict(start, 0.3)
    after = motion.update(prior, z)
    extent = np.stack(extents(z, motion.extent_sigma), axis=1)
    for i in range(3):
        likelihood = []
        for m in range(2):
            row = Polar(*(a[i] for a in z))
            x, P, how = textbook_update(prior.x[i, m], prior.covariance[i, m], row, extent[i])
            np.testing.assert_allclose(after.x[i, m], x, atol=1e-9)
            np.testing.assert_allclose(after.covariance[i, m], P, atol=1e-9)
            likelihood.append(how)
        weight = prior.weight[i] * likelihood
        np.testing.assert_allclose(after.weight[i], weight / weight.sum(), atol=1e-8)


@pytest.mark.parametrize("motion", [KalmanFilter(), ParticleFilter()], ids=["kalman", "particles"])
def test_holding_the_size_changes_nothing_that_one_camera_sees(motion):
    """Direction, extent and their rates stay; distance is as uncertain as the size again."""
    rng, c, v_C = np.random.default_rng(8), np.array([0.3, -0.2, 2.0]), np.array([1.0, 0.4, 0.0])
    d = np.array([[0.9, 0.3, -0.1]])
    z = polar(bearings(0, 0, c, d / np.linalg.norm(d), 0.01, np.array([0.06])))
    z = z._replace(v_WC=v_C[None])
    pr = np.append(c + 2.0 * d[0], np.log(0.12))[None]
    belief = motion.predict(motion.start(pr, 1e-6 * np.eye(4)[None], rng), 0.01, rng)
    before = motion.moments(belief)
    held = motion.moments(motion.hold_size(belief, z, (np.log(0.2), 0.3), rng))
    assert held.log_radius[0] == pytest.approx(np.log(0.2), abs=0.05)
    assert np.sqrt(held.radius_variance[0]) == pytest.approx(0.3, rel=0.1)
    far = np.linalg.norm(held.p_WO[0] - c)
    assert far / np.linalg.norm(before.p_WO[0] - c) == pytest.approx(0.2 / 0.12, rel=0.08)
    assert np.sqrt(held.covariance[0, :3, :3].trace()) == pytest.approx(0.3 * far, rel=0.15)
    u = (held.p_WO[0] - c) / far
    np.testing.assert_allclose(u, d[0] / np.linalg.norm(d[0]), atol=2e-3)
    turn = [np.cross(m.p_WO[0] - c, m.v_WO[0] - v_C) / np.sum((m.p_WO[0] - c) ** 2)
            for m in (before, held)]  # fmt: skip
    np.testing.assert_allclose(turn[1], turn[0], atol=0.08)


def wander(motion_noise, steps, rng):
    """A way with white acceleration of the given density: positions and velocities (steps, 3)."""
    p, v = np.array([2.5, -1.0, 2.0]), 0.7 * rng.normal(size=3)
    out = []
    for _ in range(steps):
        a, b = np.sqrt(motion_noise * DT_S) * rng.normal(size=(2, 3))
        p, v = p + DT_S * (v + 0.5 * a + b / np.sqrt(12.0)), v + a
        out.append((p, v))
    return out


class At:
    """A mover that is where it is put."""

    radius_m = 0.2

    def __init__(self, p):
        self.p = p

    def place(self, _):
        return self.p


def filtered(motion, way, rng):
    """Errors (6,) and covariances after each step, as four cameras see a way."""
    p, _ = way[0]
    first = p + 0.05 * rng.normal(size=3)
    pr = np.append(first, np.log(0.2))[None]
    belief = motion.start(pr, 0.05**2 * np.eye(4)[None], rng)
    out = []
    for k, (p, v) in enumerate(way):
        belief = motion.predict(belief, DT_S if k else 0.0, rng)
        for camera in range(4):
            z = polar(seen_by(camera, [At(p)], 0, rng, miss=0.0)[0])
            belief = motion.update(belief, z, rng)
        m = motion.moments(belief)
        out.append((np.concatenate([m.p_WO[0] - p, m.v_WO[0] - v]), m.covariance[0]))
    return out


def mean_nees(motion, runs, steps):
    """Mean over runs of the normalised error squared after some steps; 6 where all is right."""
    squared = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        e, cov = filtered(motion, wander(0.3, steps, rng), rng)[-1]
        squared.append(e @ np.linalg.solve(cov, e))
    return np.mean(squared)


def test_errors_are_as_large_as_the_covariance_says():
    """NEES of the model that moves the truth: its mean over runs, in its 99.9 % interval."""
    runs = 40
    low, high = chi2.ppf([0.0005, 0.9995], 6 * runs) / runs
    assert low < mean_nees(FILTERS[0], runs, 25) < high


def test_particles_are_spread_about_as_far_as_their_errors():
    """Finitely many particles understate the tails: within a factor of two."""
    assert 3.0 < mean_nees(ParticleFilter(manoeuvre=0.3), 12, 20) < 12.0


@every_filter
def test_a_mover_on_a_straight_way_is_found_to_centimetres(motion):
    rng, ways = np.random.default_rng(5), Swing((2.0, 0.0, 2.0), (0.8, -0.5, 0.2))
    way = [(ways.place(k * DT_S), ways.velocity(k * DT_S)) for k in range(60)]
    e, _ = filtered(motion, way, rng)[-1]
    assert np.linalg.norm(e[:3]) < 0.06
    assert np.linalg.norm(e[3:]) < 0.35


def test_the_interacting_models_follow_a_turn_better_than_constant_velocity():
    ways = Swing((2.5, 0.0, 2.0), (0.0, 1.0, 0.3), period_s=2.5)
    way = [(ways.place(k * DT_S), ways.velocity(k * DT_S)) for k in range(250)]
    rmse = {}
    for models in ("velocity", "both"):
        motion = KalmanFilter(models=models)
        e = np.array([e for e, _ in filtered(motion, way, np.random.default_rng(0))][50:])
        rmse[models] = np.sqrt(np.mean(np.sum(e[:, 3:] ** 2, axis=1)))
    assert rmse["both"] < 0.8 * rmse["velocity"]


@every_filter
def test_covariances_stay_symmetric_and_positive(motion):
    rng = np.random.default_rng(1)
    for _, cov in filtered(motion, wander(0.3, 40, rng), rng):
        np.testing.assert_allclose(cov, cov.T, atol=1e-10)
        assert np.linalg.eigvalsh(cov).min() > 0.0


def test_the_95_percent_ball_holds_95_percent():
    rng = np.random.default_rng(0)
    for scales in ([1.0, 1.0, 1.0], [1.0, 0.3, 0.1], [1.0, 0.02, 0.01], [0.5, 0.5, 0.01]):
        e = rng.normal(size=(200_000, 3)) * scales
        inside = np.mean(np.linalg.norm(e, axis=1) <= radius_95(np.diag(np.square(scales))))
        assert inside == pytest.approx(0.95, abs=0.006)


@every_filter
def test_predicted_spread_grows_and_is_the_covariance_now(motion):
    rng = np.random.default_rng(2)
    belief = motion.start(np.array([[2.0, 1.0, 1.0, -1.6]]), 0.01 * np.eye(4)[None], rng)
    belief = motion.predict(belief, 0.2, rng)
    spreads = [np.trace(motion.spread(belief, dt)[0]) for dt in (0.0, 0.1, 0.5, 1.0, 2.0)]
    assert np.all(np.diff(spreads) > 0.0)
    now = np.trace(motion.moments(belief).covariance[0, :3, :3])
    assert spreads[0] == pytest.approx(now, rel=1e-9)
