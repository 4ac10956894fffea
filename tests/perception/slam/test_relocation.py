# SPDX-License-Identifier: Apache-2.0
"""After LOST the odometry finds its place again, and is not led to one that only looks alike."""

import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))

from simulated_looks import SimulatedLook
from simulated_tracks import Flight, simulate

from skyhaul.geometry.camera import RadTan
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.so3 import rotation_z, so3_log
from skyhaul.perception.slam.keyframes import KeyframeRules
from skyhaul.perception.slam.relocation import LandmarkMap, Relocation
from skyhaul.perception.vio.api import P, StartPose, TrackFrame, VioStatus
from skyhaul.perception.vio.ekf import EkfVio
from skyhaul.perception.vio.smoother import SmootherVio

LENS = RadTan.from_fov((640, 640), 70.0).arrays()
ESTIMATORS = [EkfVio(), SmootherVio()]
SEEDS = range(3)
DARK = (8.0, 12.5)
LATER = 1_000_000
"""Tracks are others after the dark."""

every_estimator = pytest.mark.parametrize("kind", ESTIMATORS, ids=lambda e: e.kind)


@cache
def room(seed):
    return simulate(Flight(duration_s=16.0, still_s=1.5, cameras=3, tracks=20, pace=1.3, seed=seed))


@dataclass(frozen=True, eq=False)
class Flown:
    t_s: np.ndarray  # (n,)
    error: np.ndarray  # (n, 9) true less estimated p, R, v
    estimates: tuple
    places: LandmarkMap

    @property
    def found_s(self):
        return [e.stamp_us / 1e6 for e in self.estimates if e.relocated]

    @property
    def nees(self):
        """Of the pose, (n,)."""
        S = np.array([e.covariance[:6, :6] for e in self.estimates])
        e = self.error[:, :6]
        return np.einsum("ni,ni->n", e, np.linalg.solve(S, e[:, :, None])[:, :, 0])

    def off(self, begin_s, end_s=99.0):
        """RMS of the position's error in an interval [m]."""
        inside = (self.t_s >= begin_s) & (self.t_s < end_s)
        return np.sqrt(np.mean(np.sum(self.error[inside, P] ** 2, axis=1)))


@cache
def flown(kind, seed, rules=Relocation(), dark=DARK, elsewhere=(0.0, 0.0, 0.0)):  # noqa: B008
    """A flight through the dark; after it all that is seen stands elsewhere by so much [m]."""
    made = room(seed)
    estimator = kind.build(made.recording.rig, made.recording.sigma)
    memory, out = estimator.init(StartPose()), []
    finder = None if rules is None else rules.build(made.recording.rig, (LENS,) * 3)
    places = LandmarkMap()
    for k, (imu, frame) in enumerate(made.recording.readings()):
        t_s = frame.stamp_us / 1e6
        tracks = seen(frame, dark[0] <= t_s < dark[1], t_s >= dark[1])
        memory, estimate = estimator.step(memory, imu, tracks)
        if finder is not None:
            shift = np.array(elsewhere) if t_s >= dark[1] else np.zeros(3)
            look = look_at(made, k, tracks, estimator, memory, shift)
            places, found = finder.step(places, estimate, look)
            if found is not None:
                memory = estimator.restart(memory, *found)
                estimate = replace(estimate, state=found[0], covariance=found[1], relocated=True)
        out.append(estimate)
    return scored(made, out, places)


def seen(frame, dark, later):
    ids = frame.track_id + (LATER if later else 0)
    kept = np.full(len(ids), not dark)
    return TrackFrame(frame.stamp_us, ids[kept], frame.camera[kept], frame.xy[kept])


def look_at(made, k, tracks, estimator, memory, shift):
    def landmarks():
        return {i % LATER: p for i, p in estimator.landmarks(memory).items()}

    return SimulatedLook(made, k, not len(tracks.track_id), landmarks, shift)


def scored(made, estimates, places):
    R_0 = quat_to_R(made.truth.q[0])
    R_WS = rotation_z(np.arctan2(R_0[1, 0], R_0[0, 0]))  # W of the estimate is the start's
    rows, known = [], []
    for k, e in enumerate(estimates):
        if e.state is None:
            continue
        p = R_WS.T @ (made.truth.p[k] - made.truth.p[0])
        R = R_WS.T @ quat_to_R(made.truth.q[k])
        turn = so3_log(quat_to_R(e.state.q_WI).T @ R)
        v = R_WS.T @ made.v_WI[k] - e.state.v_WI
        rows.append((e.stamp_us / 1e6, *(p - e.state.p_WI), *turn, *v))
        known.append(e)
    table = np.array(rows)
    return Flown(table[:, 0], table[:, 1:], tuple(known), places)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@every_estimator
def test_over_known_ground_it_is_found_within_a_second_of_light(kind):
    for seed in SEEDS:
        run = flown(kind, seed)
        assert len(run.places.places) >= 8
        assert len(run.found_s) == 1
        assert DARK[1] <= run.found_s[0] <= DARK[1] + 1.1
        at = int(np.argmin(np.abs(run.t_s - run.found_s[0])))
        assert np.linalg.norm(run.error[at, P]) < 0.03


@every_estimator
def test_what_dead_reckoning_drifted_is_gone_after(kind):
    found = [flown(kind, seed) for seed in SEEDS]
    alone = [flown(kind, seed, None) for seed in SEEDS]
    assert all(VioStatus.LOST in [e.status for e in run.estimates] for run in found)
    assert rms([run.off(DARK[1] - 0.2, DARK[1]) for run in found]) > 0.07
    after = DARK[1] + 1.1
    assert rms([run.off(after) for run in found]) < 0.03
    assert rms([run.off(after) for run in alone]) > 3.0 * rms([run.off(after) for run in found])


@every_estimator
def test_the_covariance_holds_what_is_left(kind):
    after = [run.nees[run.t_s >= run.found_s[0]] for run in (flown(kind, s) for s in SEEDS)]
    assert np.mean(np.concatenate(after)) < 9.0
    assert np.max(np.concatenate(after)) < 22.5  # 99.9 %


@every_estimator
def test_the_covariance_falls_to_less_than_half_where_it_jumps(kind):
    """The team's filter takes that for a new frame of the vehicle."""
    for seed in SEEDS:
        run = flown(kind, seed)
        k = [e.relocated for e in run.estimates].index(True)
        spread = [np.trace(e.covariance[P, P]) for e in run.estimates[k - 1 : k + 1]]
        assert spread[1] < 0.5 * spread[0]


@every_estimator
def test_a_place_that_only_looks_alike_is_further_off_than_it_can_have_drifted(kind):
    run, alone = flown(kind, 0, elsewhere=(2.5, 1.0, 0.0)), flown(kind, 0, None)
    assert run.found_s == []
    np.testing.assert_array_equal(run.error, alone.error)


@every_estimator
def test_a_map_too_small_for_words_serves_too(kind):
    rules = Relocation(keyframes=KeyframeRules(learn_from=100))
    run = flown(kind, 0, rules)
    assert run.places.index is None
    assert len(run.found_s) == 1
    assert run.off(DARK[1] + 1.1) < 0.03


@every_estimator
@pytest.mark.parametrize("dark", [(0.5, 6.0), (1.6, 6.5)])
def test_blind_before_there_is_a_place_it_goes_on_without(kind, dark):
    run = flown(kind, 0, dark=dark)
    assert run.found_s == []
    assert run.estimates[-1].status is VioStatus.TRACKING
    assert len(run.places.places) > 3  # the map grows while it tracks, astray or not


@every_estimator
def test_who_is_never_lost_is_never_touched(kind):
    never = (99.0, 99.0)
    run, alone = flown(kind, 0, dark=never), flown(kind, 0, None, dark=never)
    assert run.places.places
    for a, b in zip(run.estimates, alone.estimates, strict=True):
        assert a.state.p_WI.tobytes() == b.state.p_WI.tobytes()
        assert a.covariance.tobytes() == b.covariance.tobytes()


def test_while_it_is_lost_the_map_does_not_grow():
    run = flown(ESTIMATORS[0], 0)
    lost = [e.stamp_us for e in run.estimates if e.status is VioStatus.LOST and not e.relocated]
    assert not any(lost[0] <= p.stamp_us <= lost[-1] for p in run.places.places)


@pytest.mark.parametrize(
    ("key", "value"), [("every_s", 0.0), ("gain", 1.0), ("candidates", 0), ("floor_m", -1.0)]
)
def test_nonsense_is_refused(key, value):
    with pytest.raises(ValueError, match=f"{key} must"):
        Relocation(**{key: value})
