# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from simulated_tracks import rig_of

from skyhaul.geometry.so3 import so3_exp, so3_log
from skyhaul.perception.vio.api import CameraRig
from skyhaul.perception.vio.pose_update import (
    CUTOFF_2D,
    MEDIAN_TO_SIGMA_2D,
    Sights,
    TukeyPose,
    bearing_sigma,
    bearings,
    few,
    sight_error,
    tangent,
    update_pose,
)

SIGMA = 2e-3
TRUE_P, TRUE_R = np.array([0.3, -0.2, 0.5]), so3_exp(np.array([0.1, 0.2, -0.3]))
GUESS = (TRUE_P + np.array([0.1, -0.08, 0.06]), TRUE_R @ so3_exp(np.array([0.05, -0.04, 0.06])))


def scene(seed=0, n=100, cameras=4, outliers=0.0, noise=1.0):
    """Bearings of n points, a share of them wrong by some degrees."""
    rng, rig = np.random.default_rng(seed), rig_of(cameras)
    camera = np.arange(n) % cameras
    in_C = np.column_stack([rng.uniform(-0.7, 0.7, (n, 2)), np.ones(n)])
    in_C *= rng.uniform(1.0, 12.0, (n, 1))
    in_I = np.einsum("nij,nj->ni", rig.R_IC[camera], in_C) + rig.p_IC[camera]
    xy = in_C[:, :2] / in_C[:, 2:] + noise * SIGMA * rng.normal(size=(n, 2))
    wrong = rng.permutation(n)[: round(outliers * n)]
    xy[wrong] += rng.normal(size=(len(wrong), 2)) * 40.0 * SIGMA
    sights = Sights(in_I @ TRUE_R.T + TRUE_P, bearings(xy), camera, bearing_sigma(xy, SIGMA))
    return rig, sights, wrong


def error_of(fix):
    return np.linalg.norm(fix.p_WI - TRUE_P), np.linalg.norm(so3_log(TRUE_R.T @ fix.R_WI))


@pytest.mark.parametrize("axis", [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, -0.64, 0.48]])
def test_tangents_are_unit_vectors_normal_to_the_bearing(axis):
    basis = np.array([tangent(np.array(axis), 0), tangent(np.array(axis), 1), axis])
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-14)


def test_derivative_of_an_error_is_that_of_its_differences():
    rig, sights, _ = scene(noise=5.0)
    R_CI = rig.R_IC[1].T.copy()
    p_CI = -R_CI @ rig.p_IC[1]
    at = (R_CI, p_CI, sights.p_WP[1], sights.bearing_C[1])

    def error(x):
        e, J = np.empty(2), np.empty((2, 6))
        assert sight_error(GUESS[0] + x[:3], GUESS[1] @ so3_exp(x[3:]), *at, e, J)
        return e, J

    h = 1e-6
    columns = [(error(d)[0] - error(-d)[0]) / (2 * h) for d in h * np.eye(6)]
    np.testing.assert_allclose(error(np.zeros(6))[1], np.array(columns).T, atol=1e-8)


def test_exact_bearings_give_the_exact_pose():
    rig, sights, _ = scene(noise=0.0)
    fix = update_pose(TukeyPose(), rig, GUESS, sights)
    assert max(error_of(fix)) < 1e-9
    assert fix.inlier.all()


def test_one_camera_is_enough_and_behind_it_nothing_counts():
    rig, sights, _ = scene(cameras=1, noise=0.0)
    behind = sights._replace(p_WP=sights.p_WP.copy())
    behind.p_WP[:5] = 2.0 * TRUE_P - behind.p_WP[:5]
    fix = update_pose(TukeyPose(), rig, GUESS, behind)
    assert max(error_of(fix)) < 1e-9
    np.testing.assert_array_equal(np.flatnonzero(~fix.inlier), np.arange(5))


@pytest.mark.parametrize("seed", range(5))
def test_40_percent_outliers_do_no_harm(seed):
    rig, clean, _ = scene(seed)
    rig, dirty, wrong = scene(seed, outliers=0.4)
    ours = update_pose(TukeyPose(), rig, GUESS, dirty)
    best = update_pose(TukeyPose(), rig, GUESS, clean)
    assert error_of(ours)[0] < 0.01
    assert error_of(ours)[1] < 0.004
    assert error_of(ours)[0] < 3.0 * error_of(best)[0] + 0.003
    right = np.setdiff1d(np.arange(100), wrong)
    assert np.mean(ours.inlier[right]) > 0.95
    assert np.mean(ours.inlier[wrong]) < 0.35  # of wrong ones some lie within the cut-off


def test_without_the_cutoff_40_percent_outliers_do_harm():
    # The same solver with a scale that never cuts: least squares.
    rig, dirty, _ = scene(0, outliers=0.4)
    least_squares = update_pose(TukeyPose(scale_floor=1e3), rig, GUESS, dirty)
    assert (
        error_of(least_squares)[0] > 4.0 * error_of(update_pose(TukeyPose(), rig, GUESS, dirty))[0]
    )


def test_scale_constant_is_that_of_the_length_of_2d_errors():
    lengths = np.linalg.norm(np.random.default_rng(0).normal(size=(200_000, 2)), axis=1)
    assert MEDIAN_TO_SIGMA_2D * np.median(lengths) == pytest.approx(1.0, abs=5e-3)
    assert pytest.approx(1.0 / np.sqrt(2.0 * np.log(2.0)), abs=1e-4) == MEDIAN_TO_SIGMA_2D
    # The scalar constant would take the scale of 2-D errors for 1.75 times too large.
    assert pytest.approx(1.746, abs=1e-3) == 1.4826 / MEDIAN_TO_SIGMA_2D


def test_cutoff_is_95_percent_efficient_in_two_dimensions():
    # Efficiency of an M-estimator of a 2-D location: E[(psi' + psi / r) / 2]^2 / E[psi^2 / 2].
    r = np.linspace(0.0, CUTOFF_2D, 20_001)
    density = r * np.exp(-0.5 * r * r)
    u = (r / CUTOFF_2D) ** 2
    weight, slope = (1 - u) ** 2, (1 - u) * (1 - 5 * u)
    step = r[1] - r[0]
    gain = np.sum(0.5 * (slope + weight) * density) * step
    power = np.sum(0.5 * (r * weight) ** 2 * density) * step
    assert gain**2 / power == pytest.approx(0.95, abs=2e-3)


def test_scale_is_estimated_from_the_errors():
    rig, sights, _ = scene(1, n=400, noise=3.0)
    fix = update_pose(TukeyPose(), rig, GUESS, sights)
    assert fix.scale == pytest.approx(3.0 * few(400), rel=0.1)
    ptam = update_pose(TukeyPose(scale="ptam"), rig, GUESS, sights)
    assert ptam.scale == pytest.approx(fix.scale * 1.4826 / 0.8493, rel=2e-2)


def test_information_is_the_inverse_covariance_of_many_fits():
    errors, expected = [], []
    for seed in range(300):
        rig, sights, _ = scene(seed, n=60)
        fix = update_pose(TukeyPose(), rig, (TRUE_P, TRUE_R), sights)
        errors.append(np.r_[fix.p_WI - TRUE_P, so3_log(TRUE_R.T @ fix.R_WI)])
        expected.append(np.linalg.inv(fix.information))
    ratio = np.var(errors, axis=0) / np.mean([np.diag(c) for c in expected], axis=0)
    assert np.all(ratio > 0.6)
    assert np.all(ratio < 1.4)


def test_a_prior_alone_keeps_the_guess_and_a_weak_one_gives_way():
    rig, sights, _ = scene(noise=0.0)
    none = Sights(*(a[:0] for a in sights))
    held = update_pose(TukeyPose(), rig, GUESS, none, np.eye(6))
    np.testing.assert_allclose(held.p_WI, GUESS[0], atol=1e-12)
    np.testing.assert_allclose(held.R_WI, GUESS[1], atol=1e-12)
    weak = update_pose(TukeyPose(), rig, GUESS, sights, 1e-6 * np.eye(6))
    assert max(error_of(weak)) < 1e-6


def test_prior_and_bearings_are_weighed_by_their_information():
    # Linear case: the fit with a prior is the information-weighted mean of both.
    rig, sights, _ = scene(2)
    near = (TRUE_P + 1e-3, TRUE_R @ so3_exp(np.full(3, 5e-4)))
    prior = np.diag([2e5, 1e5, 3e5, 1e6, 2e6, 1e6])
    params = TukeyPose(iterations=30, scale_floor=1e2)  # least squares: weights all near one
    alone = update_pose(params, rig, near, sights)
    both = update_pose(params, rig, near, sights, prior)
    d = np.r_[near[0] - alone.p_WI, so3_log(alone.R_WI.T @ near[1])]
    expected = np.linalg.solve(alone.information + prior, prior @ d)
    found = np.r_[both.p_WI - alone.p_WI, so3_log(alone.R_WI.T @ both.R_WI)]
    np.testing.assert_allclose(found, expected, atol=2e-6)


def test_nothing_seen_at_all_is_no_exception():
    rig = CameraRig(np.eye(3)[None], np.zeros((1, 3)))
    points = np.tile([0.0, 0.0, -5.0], (8, 1))
    lost = Sights(points, np.tile([0.0, 0, 1], (8, 1)), np.zeros(8, dtype=np.int64), np.ones(8))
    fix = update_pose(TukeyPose(), rig, (np.zeros(3), np.eye(3)), lost)
    assert not fix.inlier.any()
    np.testing.assert_array_equal(fix.p_WI, 0.0)


def test_parameters_are_checked():
    with pytest.raises(ValueError, match="free_iterations must be 1 to iterations"):
        TukeyPose(iterations=3, free_iterations=4)
    with pytest.raises(ValueError, match="scale_floor"):
        TukeyPose(scale_floor=0.0)
