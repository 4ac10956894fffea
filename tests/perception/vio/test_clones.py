# SPDX-License-Identifier: Apache-2.0
"""The filter's algebra and the constraint of a track."""

import numpy as np
import pytest
from simulated_tracks import rig_of

from skyhaul.geometry.quaternion import R_to_quat, quat_conj, quat_log, quat_mul
from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.vio.api import NE, CameraRig, NavState
from skyhaul.perception.vio.clones import clone, correct, forget_clone, move, start_filter
from skyhaul.perception.vio.constraints import (
    ClonedTrack,
    _noise_of,
    sight_derivatives,
    standing_constraint,
    track_constraint,
)
from skyhaul.perception.vio.ekf import EkfVio, follow
from skyhaul.perception.vio.imu import ImuNoise, advance

STAMPS_US = tuple(100_000 * k for k in range(6))


def random_covariance(rng, n):
    A = rng.normal(size=(n, n))
    return 1e-3 * (A @ A.T + np.eye(n))


@pytest.fixture
def filled():
    """A filter with three clones, moved between them."""
    rng = np.random.default_rng(0)
    state = NavState(np.ones(3), R_to_quat(so3_exp(rng.normal(size=3))), *rng.normal(size=(3, 3)))
    f = clone(start_filter(state, random_covariance(rng, NE)), 1)
    for k in (2, 3):
        samples = np.hstack([np.full((20, 1), 0.005), rng.normal(size=(20, 6)) + 3.0])
        predicted, Phi, Q = advance(f.state, samples, ImuNoise().densities())
        f = clone(move(f, predicted, Phi, Q, 0.1), k)
    return f


def test_a_clone_is_the_pose_and_knows_it(filled):
    P = filled.covariance
    assert P.shape == (NE + 18, NE + 18)
    np.testing.assert_array_equal(P[-6:, -6:], P[:6, :6])
    np.testing.assert_array_equal(P[-6:, :NE], P[:6, :NE])
    np.testing.assert_array_equal(filled.clone_p[-1], filled.state.p_WI)
    assert filled.clone_k == (1, 2, 3)


def test_motion_leaves_clones_alone_and_carries_their_correlation():
    rng = np.random.default_rng(1)
    state = NavState(np.ones(3), R_to_quat(so3_exp(rng.normal(size=3))), *rng.normal(size=(3, 3)))
    f = clone(start_filter(state, random_covariance(rng, NE)), 1)
    samples = np.hstack([np.full((20, 1), 0.005), rng.normal(size=(20, 6)) + 3.0])
    predicted, Phi, Q = advance(f.state, samples, ImuNoise().densities())
    moved = move(f, predicted, Phi, Q, 0.1)
    # Before any correction the first estimates are the estimates: the plain propagation.
    F = np.eye(NE + 6)
    F[:NE, :NE] = Phi
    full = F @ f.covariance @ F.T
    full[:NE, :NE] += Q
    np.testing.assert_allclose(moved.covariance, full, atol=1e-12)
    np.testing.assert_array_equal(moved.clone_p, f.clone_p)


def test_correction_is_bayes_rule_in_information_form(filled):
    rng, filled = (
        np.random.default_rng(2),
        forget_clone(filled, 2),
    )  # the newest is the state's twin
    n = len(filled.covariance)
    for rows in (5, n + 20):
        H, residual, sigma = rng.normal(size=(rows, n)), 0.01 * rng.normal(size=rows), 0.3
        after = correct(filled, residual, H, sigma)
        information = np.linalg.inv(filled.covariance) + H.T @ H / sigma**2
        np.testing.assert_allclose(after.covariance, np.linalg.inv(information), atol=1e-9)
        dx = np.linalg.solve(information, H.T @ residual / sigma**2)
        np.testing.assert_allclose(after.state.p_WI - filled.state.p_WI, dx[:3], atol=1e-9)
        turn = quat_log(quat_mul(quat_conj(filled.state.q_WI), after.state.q_WI))
        np.testing.assert_allclose(turn, dx[3:6], atol=1e-9)
        np.testing.assert_allclose(
            after.clone_p[1] - filled.clone_p[1], dx[NE + 6 : NE + 9], atol=1e-9
        )
        np.testing.assert_array_equal(after.first_p, filled.first_p)


def test_joseph_form_stays_symmetric_and_positive(filled):
    rng, f = np.random.default_rng(3), forget_clone(filled, 2)
    for _ in range(200):
        f = correct(f, np.zeros(6), rng.normal(size=(6, len(f.covariance))), 1e-4)
    np.testing.assert_array_equal(f.covariance, f.covariance.T)
    assert np.linalg.eigvalsh(f.covariance).min() > 0.0


def test_forgetting_a_clone_keeps_the_others(filled):
    f = forget_clone(filled, 1)
    assert f.clone_k == (1, 3)
    keep = np.r_[0 : NE + 6, NE + 12 : NE + 18]
    np.testing.assert_array_equal(f.covariance, filled.covariance[np.ix_(keep, keep)])
    np.testing.assert_array_equal(f.clone_R, filled.clone_R[[0, 2]])


def test_derivatives_of_a_sight_are_those_of_its_differences():
    rng, rig = np.random.default_rng(4), rig_of(1)
    R_WI, p_WI = so3_exp(0.2 * rng.normal(size=(3, 3))), 0.3 * rng.normal(size=(3, 3))
    point, h = np.array([4.0, 0.5, -0.3]), 1e-6

    def images(R, p, x):
        c = (np.einsum("kji,kj->ki", R, x - p) - rig.p_IC[0]) @ rig.R_IC[0]
        return c[:, :2] / c[:, 2:]

    by_pose, by_point = sight_derivatives(R_WI, p_WI, rig.R_IC[[0] * 3], rig.p_IC[[0] * 3], point)
    for axis in range(3):
        d = h * np.eye(3)[axis]
        np.testing.assert_allclose(
            by_point[:, :, axis],
            (images(R_WI, p_WI, point + d) - images(R_WI, p_WI, point - d)) / (2 * h),
            atol=1e-8,
        )
        np.testing.assert_allclose(
            by_pose[:, :, axis],
            (images(R_WI, p_WI + d, point) - images(R_WI, p_WI - d, point)) / (2 * h),
            atol=1e-8,
        )
        ahead, behind = R_WI @ so3_exp(d), R_WI @ so3_exp(-d)
        np.testing.assert_allclose(
            by_pose[:, :, 3 + axis],
            (images(ahead, p_WI, point) - images(behind, p_WI, point)) / (2 * h),
            atol=1e-8,
        )


def test_a_constraint_does_not_depend_on_the_place_of_its_point():
    rng, rig = np.random.default_rng(5), rig_of(1)
    state = NavState(np.zeros(3), np.array([1.0, 0, 0, 0]), *np.zeros((3, 3)))
    f = start_filter(state, 1e-4 * np.eye(NE))
    for k in range(6):
        moved = NavState(
            0.2 * rng.normal(size=3),
            R_to_quat(so3_exp(0.1 * rng.normal(size=3))),
            *np.zeros((3, 3)),
        )
        f = clone(start_filter(moved, f.covariance) if k == 0 else _at(f, moved), k)
    point = np.array([4.0, 0.5, -0.3])
    c = (np.einsum("kji,kj->ki", f.clone_R, point - f.clone_p) - rig.p_IC[0]) @ rig.R_IC[0]
    track = ClonedTrack((0,) * 6, tuple(range(6)), tuple(c[:, :2] / c[:, 2:]), STAMPS_US)
    residual, H = track_constraint(f, rig, track, EkfVio(), np.ones(1))
    assert residual.shape == (9,)
    np.testing.assert_allclose(residual, 0.0, atol=1e-9)
    # Shifting all poses alike shifts the point alike: nothing changes. Nor does a common turn.
    common = np.tile(np.r_[0.3, -0.2, 0.1, 0.0, 0.0, 0.0], 6)
    np.testing.assert_allclose(H[:, NE:] @ common, 0.0, atol=1e-9)
    w = np.array([0.2, -0.1, 0.3])
    turn = np.concatenate(
        [np.r_[np.cross(w, p), R.T @ w] for p, R in zip(f.clone_p, f.clone_R, strict=True)]
    )
    np.testing.assert_allclose(H[:, NE:] @ turn, 0.0, atol=1e-9)
    assert np.linalg.norm(H) > 0.1


def _at(f, state):
    from dataclasses import replace

    return replace(f, state=state, first=state)


def test_tracks_go_on_end_and_begin():
    from skyhaul.perception.vio.api import TrackFrame

    def frame(ids):
        n = len(ids)
        return TrackFrame(0, np.array(ids), np.zeros(n, dtype=np.int64), np.full((n, 2), 0.1 * n))

    tracks, ended = follow({}, frame([4, 7]), 1)
    tracks, ended = follow(tracks, frame([7, 9]), 2)
    assert [i for i, _ in ended] == [4]
    assert {i: t.k for i, t in tracks.items()} == {7: (1, 2), 9: (2,)}
    assert tracks[7].seen_from(2).k == (2,)


def test_tracks_of_a_silent_camera_go_on_and_are_not_seen():
    from skyhaul.perception.vio.api import TrackFrame

    def frame(ids, cameras, silent=()):
        xy = np.full((len(ids), 2), 0.1)
        return TrackFrame(0, np.array(ids, np.int64), np.array(cameras, np.int64), xy, silent)

    tracks, _ = follow({}, frame([4, 7, 7], [0, 0, 1]), 1)
    tracks, ended = follow(tracks, frame([8], [1], silent=(0,)), 2)
    assert not ended
    assert {i: t.k for i, t in tracks.items()} == {4: (1,), 7: (1, 1), 8: (2,)}
    tracks, ended = follow(tracks, frame([4], [0], silent=(1,)), 3)
    assert not ended
    tracks, ended = follow(tracks, frame([4], [0]), 4)
    assert {i for i, _ in ended} == {7, 8}
    assert tracks[4].k == (1, 3, 4)


def test_two_cameras_may_see_one_track():
    from skyhaul.perception.vio.api import TrackFrame

    frame = TrackFrame(0, np.array([4, 4]), np.array([0, 1]), np.array([[0.1, 0.0], [0.2, 0.0]]))
    tracks, _ = follow({}, frame, 3)
    assert (tracks[4].camera, tracks[4].k) == ((0, 1), (3, 3))
    assert len(np.unique(frame.sight_id)) == 2


def test_a_slide_of_tracks_is_a_walk_in_each_camera():
    stamps_us = (300_000, 300_000, 700_000, 700_000)
    track = ClonedTrack((0, 1, 0, 1), (3, 3, 7, 7), (np.zeros(2),) * 4, stamps_us)
    params = EkfVio(slide=2.0)
    covariance = _noise_of(track, np.full(4, 0.5), params)
    walk = 0.25 * 4.0 * 0.4
    np.testing.assert_allclose(np.diag(covariance), [0.25, 0.25, 0.25 + walk, 0.25 + walk])
    assert covariance[2, 3] == covariance[0, 2] == 0.0
    late = ClonedTrack((0, 0, 0), (0, 4, 8), (np.zeros(2),) * 3, (0, 400_000, 800_000))
    assert _noise_of(late, np.full(3, 0.5), params)[1, 2] == pytest.approx(walk)


def test_a_slide_grows_with_time_from_the_first_sight_of_its_camera():
    """Keyframes may come late, and a camera may join a track long after another began it."""
    stamps_us = (0, 250_000, 250_000, 1_000_000, 1_400_000)
    track = ClonedTrack((0, 0, 1, 1, 0), (1, 2, 2, 3, 4), (np.zeros(2),) * 5, stamps_us)
    covariance = _noise_of(track, np.full(5, 0.5), EkfVio(slide=2.0))
    since_s = np.array([0.0, 0.25, 0.0, 0.75, 1.4])
    np.testing.assert_allclose(np.diag(covariance), 0.25 * (1.0 + 4.0 * since_s))
    assert covariance[1, 4] == pytest.approx(0.25 * 4.0 * 0.25)
    assert covariance[2, 3] == covariance[1, 2] == covariance[3, 4] == 0.0


def hanging(v_guess, v_true, depth_m, slide=2.0):
    """A filter that holds a vehicle for moving at `v_guess` along x; its 12 tracks of `v_true`.

    It looks along y; six clones in half a second.
    """
    rng = np.random.default_rng(5)
    q = R_to_quat(np.eye(3))
    state = NavState(np.zeros(3), q, np.array([v_guess, 0, 0]), np.zeros(3), np.zeros(3))
    sigma = np.repeat([1e-3, 2e-3, 0.1, 1e-4, 1e-3], 3)
    f = clone(start_filter(state, np.diag(sigma**2)), 0)
    samples = np.hstack(
        [np.full((50, 1), 0.002), np.zeros((50, 3)), np.tile([0, 0, 9.80665], (50, 1))]
    )
    for k in range(1, 6):
        predicted, Phi, Q = advance(f.state, samples, ImuNoise().densities())
        f = clone(move(f, predicted, Phi, Q, 0.1), k)
    tracks = []
    for xy in rng.uniform(-0.4, 0.4, (12, 2)):
        p_WP = depth_m * np.array([xy[0], 1.0, -xy[1]])
        seen = [p_WP - [0.1 * k * v_true, 0.0, 0.0] for k in range(6)]
        sights = [np.array([s[0] / s[1], -s[2] / s[1]]) for s in seen]
        tracks.append(ClonedTrack((0,) * 6, tuple(range(6)), tuple(sights), STAMPS_US))
    return f, tracks


LOOKS_ALONG_Y = CameraRig(np.array([[[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]]), np.zeros((1, 3)))


@pytest.mark.parametrize("depth_m", [1.0, 3.0, 8.0])
def test_bearings_that_stand_hold_a_filter_that_believes_it_moves(depth_m):
    f, tracks = hanging(0.15, 0.0, depth_m)
    both = [standing_constraint(f, LOOKS_ALONG_Y, t, EkfVio(), np.array([1e-3])) for t in tracks]
    residual, H = np.concatenate([r for r, _ in both]), np.vstack([H for _, H in both])
    after = correct(f, residual, H, 1.0)
    error = after.state.v_WI[0]
    assert abs(error) < 0.02
    assert error**2 < 9.0 * after.covariance[6, 6] < 0.1 * f.covariance[6, 6]


@pytest.mark.parametrize("depth_m", [1.0, 3.0])
def test_bearings_that_move_hold_nothing(depth_m):
    """Their scale is not known: 0.15 m/s before far points, or less before near ones?"""
    f, tracks = hanging(0.15, 0.15, depth_m)
    for track in tracks:
        assert standing_constraint(f, LOOKS_ALONG_Y, track, EkfVio(), np.array([1e-3])) is None
