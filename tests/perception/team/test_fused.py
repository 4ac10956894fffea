# SPDX-License-Identifier: Apache-2.0
"""Tests of `perception.team.fused`: accuracy, honesty, invariance, and what is missing at times."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_exp, quat_mul, quat_rotate
from skyhaul.perception.team.api import SurveyedTeam, TeamReports
from skyhaul.perception.team.fused import FusedTeam
from skyhaul.perception.vio.imu import NO_SAMPLES

SEEDS = range(8)
CHI2_95_12 = 21.03


def follow(made, reports=None, start=None, params=None):
    """All estimates of a flight, and the last memory."""
    estimator = made.estimator(params)
    if start is not None:
        estimator = replace(estimator, start=start)
    memory, out = estimator.init(), []
    for reading in reports or made.reports:
        memory, estimate = estimator.step(memory, reading)
        out.append(estimate)
    return out, memory, estimator


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module")
def noisy(flight):
    """Errors of the load (seed, tick, 12) and NEES (seed, tick) of eight flights."""
    errors, nees = [], []
    for seed in SEEDS:
        made = flight(seed, 3.0)
        estimates, memory, _ = follow(made)
        e = np.array([made.error(k, x) for k, x in enumerate(estimates)])
        errors.append(e)
        nees.append(
            [
                e[k] @ np.linalg.solve(estimates[k].load_covariance, e[k])
                for k in range(250, 1500, 50)
            ]
        )
        assert memory.state.tally[1] <= 2  # of about 120 sights, 1 in 1000 is refused
    return np.array(errors), np.array(nees)


def test_the_load_is_known_to_centimetres(noisy):
    e = noisy[0][:, 250:]
    assert rms(np.linalg.norm(e[..., :3], axis=-1)) < 0.04
    assert np.degrees(rms(np.linalg.norm(e[..., 3:6], axis=-1))) < 0.6
    assert rms(np.linalg.norm(e[..., 6:9], axis=-1)) < 0.05
    assert rms(np.linalg.norm(e[..., 9:], axis=-1)) < 0.02


def test_errors_are_as_large_as_the_covariance_says(noisy):
    nees = noisy[1]
    assert 4.0 < nees.mean() < 14.0  # 12 is ideal
    assert np.mean(nees < CHI2_95_12) > 0.9


def test_without_noise_the_estimate_is_the_truth(flight, exact):
    made = flight(1, 2.0, exact)
    estimates, _, _ = follow(made)
    for k in range(500, 1001, 50):
        x = estimates[k]
        np.testing.assert_allclose(x.team.p_WL, made.p_WL[k], atol=3e-3)
        np.testing.assert_allclose(x.cables.dir_W, made.dir_W[k], atol=1e-3)
        np.testing.assert_allclose(x.cables.w_W, made.w_W[k], atol=5e-3)
        np.testing.assert_allclose(x.cables.tension, made.tension[k], rtol=0.01)
        np.testing.assert_allclose(x.team.p_WB, made.p_WB[k], atol=3e-3)


def moved(made, yaw, shift):
    """The same flight in a world that is turned about the vertical and shifted."""
    turn = quat_exp(np.array([0.0, 0.0, yaw]))
    at = lambda p: quat_rotate(turn, p) + shift  # noqa: E731
    Rz = np.eye(15)
    c, s = np.cos(yaw), np.sin(yaw)
    for block in (slice(0, 3), slice(6, 9)):
        Rz[block, block] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    reports = []
    for reading in made.reports:
        vehicles = []
        for v in reading.vehicles:
            if v.vio is not None:
                x = v.vio.state
                state = replace(
                    x,
                    p_WI=at(x.p_WI),
                    q_WI=quat_mul(turn, x.q_WI),
                    v_WI=quat_rotate(turn, x.v_WI),
                )
                cov = Rz @ v.vio.covariance @ Rz.T
                v = replace(v, vio=replace(v.vio, state=state, covariance=cov))
            vehicles.append(v)
        reports.append(replace(reading, vehicles=tuple(vehicles)))
    a = made.start
    start = SurveyedTeam(at(a.p_WL), quat_mul(turn, a.q_WL), at(a.p_WB), quat_mul(turn, a.q_WB))
    return reports, start, turn, at


def test_estimates_move_with_the_world(flight):
    """Turned by a right angle, since drift is gated axis by axis."""
    made = flight(2, 1.5)
    reports, start, turn, at = moved(made, 0.5 * np.pi, np.array([3.0, -2.0, 0.7]))
    here, there = follow(made)[0][-1], follow(made, reports, start)[0][-1]
    np.testing.assert_allclose(there.team.p_WL, at(here.team.p_WL), atol=1e-9)
    np.testing.assert_allclose(there.team.v_WL, quat_rotate(turn, here.team.v_WL), atol=1e-9)
    np.testing.assert_allclose(there.team.w_WL_L, here.team.w_WL_L, atol=1e-9)
    np.testing.assert_allclose(there.team.p_WB, at(here.team.p_WB), atol=1e-9)
    np.testing.assert_allclose(there.cables.dir_W, quat_rotate(turn, here.cables.dir_W), atol=1e-9)
    np.testing.assert_allclose(there.cables.tension, here.cables.tension, atol=1e-9)


def test_a_tag_that_nobody_sees_for_two_seconds_is_borne(flight):
    made = flight(3, 4.0, hidden_s=(1.0, 3.0))
    estimates, memory, _ = follow(made)
    e = np.array([made.error(k, x) for k, x in enumerate(estimates)])
    assert np.linalg.norm(e[500:, :3], axis=1).max() < 0.08
    assert np.degrees(np.linalg.norm(e[500:, 3:6], axis=1).max()) < 2.0
    spread = [np.sqrt(np.trace(estimates[k].load_covariance[3:6, 3:6])) for k in (495, 1495, 1700)]
    assert spread[0] < spread[1] > spread[2]  # it knows less meanwhile, and says so
    assert memory.state.tally[1] <= 2


def test_a_silent_imu_of_the_load_is_borne(flight):
    made = flight(3, 3.0, silent_s=(1.0, 1.5))
    estimates, _, _ = follow(made)
    e = np.array([made.error(k, x) for k, x in enumerate(estimates)])
    assert np.linalg.norm(e[500:, :3], axis=1).max() < 0.1
    assert np.degrees(np.linalg.norm(e[500:, 3:6], axis=1).max()) < 3.0


def test_frames_that_drift_apart_are_held_together(flight):
    made = flight(4, 4.0)
    reports = []
    for reading in made.reports:
        v = reading.vehicles[2]
        if v.vio is not None:  # one odometry slides away at 5 cm/s and says how far it may be off
            slide = 5e-2 * 1e-6 * reading.stamp_us
            state = replace(v.vio.state, p_WI=v.vio.state.p_WI + np.array([slide, 0.0, 0.0]))
            cov = v.vio.covariance.copy()
            cov[0, 0] += slide**2
            v = replace(v, vio=replace(v.vio, state=state, covariance=cov))
        vehicles = (*reading.vehicles[:2], v, *reading.vehicles[3:])
        reports.append(TeamReports(reading.stamp_us, vehicles, reading.load_imu))
    estimates, memory, estimator = follow(made, reports)
    k, last = len(estimates) - 1, estimates[-1]
    offset = estimator.offsets(memory)[2]
    assert np.linalg.norm(last.team.p_WB[2] - made.p_WB[k, 2]) < 0.08
    assert offset.p[0] < -0.1  # the frame is pulled back
    assert np.linalg.norm(last.team.p_WL - made.p_WL[k]) < 0.08
    line = np.sum(last.cables.dir_W * made.dir_W[k], axis=1)
    assert np.degrees(np.arccos(line.min())) < 1.5


def test_a_released_vehicle_is_left_alone(flight):
    made = flight(5, 2.0)
    reports = []
    for k, reading in enumerate(made.reports):
        v = reading.vehicles[1]
        if k > 500:  # its hook is open, its odometry raves
            vio = v.vio
            if vio is not None:
                vio = replace(vio, state=replace(vio.state, p_WI=vio.state.p_WI + 5.0))
            v = replace(v, attached=False, vio=vio, thrust=0.0)
        reports.append(replace(reading, vehicles=(reading.vehicles[0], v, *reading.vehicles[2:])))
    estimates, _, _ = follow(made, reports)
    assert not estimates[-1].attached[1]
    assert estimates[-1].cables.tension[1] == 0.0
    assert np.linalg.norm(estimates[-1].team.p_WL - made.p_WL[1000]) < 0.08


def test_before_their_first_odometry_vehicles_move_by_their_imus(flight, exact):
    made = flight(1, 1.0, exact)
    late = [
        reading
        if k > 150
        else replace(reading, vehicles=tuple(replace(v, vio=None) for v in reading.vehicles))
        for k, reading in enumerate(made.reports)
    ]
    estimates, _, _ = follow(made, late)
    assert np.linalg.norm(made.p_WB[150] - made.p_WB[0], axis=1).min() > 0.02
    np.testing.assert_allclose(estimates[150].team.p_WB, made.p_WB[150], atol=3e-3)


def test_a_silent_vehicle_is_borne(flight):
    made = flight(6, 2.0)
    reports = [
        replace(r, vehicles=(*r.vehicles[:3], None if k > 500 else r.vehicles[3]))
        for k, r in enumerate(made.reports)
    ]
    estimates, _, _ = follow(made, reports)
    e = np.array([made.error(k, x) for k, x in enumerate(estimates)])
    assert np.linalg.norm(e[500:, :3], axis=1).max() < 0.1


@pytest.mark.parametrize("missing", [1, 3, 75])
def test_a_gap_in_a_vehicle_s_imu_is_bridged(flight, missing):
    """Its pose moves on, 8 ms late at most, and its cable's force is known meanwhile."""
    made, first = flight(6, 3.0), 700
    reports = []
    for k, r in enumerate(made.reports):
        last = r.vehicles[3]
        if first <= k < first + missing:
            last = replace(last, imu=NO_SAMPLES)
        reports.append(replace(r, vehicles=(*r.vehicles[:3], last)))
    whole, estimates = follow(made)[0], follow(made, reports)[0]
    off = [
        np.linalg.norm(x.team.p_WB[3] - y.team.p_WB[3])
        for x, y in zip(estimates, whole, strict=True)
    ]
    moved = np.linalg.norm(made.p_WB[first + missing, 3] - made.p_WB[first, 3])
    assert max(off[first : first + missing + 5]) < max(0.25 * moved, 0.01)
    assert max(off[first + missing + 100 :]) < 0.01
    e = np.array([made.error(k, x) for k, x in enumerate(estimates)])
    assert np.linalg.norm(e[500:, :3], axis=1).max() < 0.05
    tension = np.array([x.cables.tension[3] for x in estimates]) - made.tension[:, 3]
    assert np.abs(tension[first : first + missing]).max() < 0.2


def test_a_load_that_was_taken_away_is_found_by_the_tag(flight):
    made = flight(7, 2.0)
    start = replace(made.start, p_WL=made.start.p_WL + np.array([0.6, -0.4, 0.2]))
    estimates = follow(made, start=start)[0]
    assert np.linalg.norm(estimates[-1].team.p_WL - made.p_WL[1000]) < 0.06


def test_a_load_is_not_placed_by_a_vehicle_that_was_released(flight):
    made = flight(7, 2.0)
    reports = []
    for reading in made.reports:
        v = reading.vehicles[0]  # the first that sees the tag; its odometry raves
        vio = v.vio and replace(v.vio, state=replace(v.vio.state, p_WI=v.vio.state.p_WI + 5.0))
        v = replace(v, attached=False, vio=vio, thrust=0.0)
        reports.append(replace(reading, vehicles=(v, *reading.vehicles[1:])))
    start = replace(made.start, p_WL=made.start.p_WL + np.array([0.6, -0.4, 0.2]))
    estimates, memory, _ = follow(made, reports, start=start)
    assert memory.state.tally[1] >= 12
    assert np.linalg.norm(estimates[-1].team.p_WL - made.p_WL[1000]) < 0.08


def test_numbers_out_of_range_are_refused():
    with pytest.raises(ValueError, match="sigma_px must be > 0, got 0"):
        FusedTeam(sigma_px=0.0)
    with pytest.raises(ValueError, match=r"slack_n must be below taut_n = 0.05, got 0.1"):
        FusedTeam(slack_n=0.1)
