# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.perception.obstacles.motion import KalmanFilter
from skyhaul.perception.obstacles.particles import ParticleFilter
from skyhaul.perception.obstacles.tracker import BearingTracker

from .conftest import CAMERAS, PERIOD_US, Swing, follow, nearest, seen_by

KALMAN, PARTICLES = BearingTracker(), BearingTracker(filter=ParticleFilter(particles=400))
APART = [
    Swing((3.0, 0.0, 2.0), (0.0, 1.0, 0.2), period_s=5.0),
    Swing((-2.5, 1.0, 1.5), (0.5, 0.8, 0.0), period_s=6.0, phase_s=1.0, radius_m=0.3),
    Swing((0.0, -3.0, 2.5), (0.4, 0.1, 0.0), phase_s=-1.0, radius_m=0.15),
]


def names_of(tracks_by_step, movers, since):
    """For each mover, the names that its tracks bore from a step on."""
    names = [set() for _ in movers]
    for k, tracks in enumerate(tracks_by_step):
        if k >= since:
            for track in tracks:
                who, off = nearest(track, movers, 1e-6 * PERIOD_US * k)
                assert off < 0.5
                names[who].add(track.track_id)
    return names


@pytest.mark.parametrize("tracker", [KALMAN, PARTICLES], ids=["kalman", "particles"])
@pytest.mark.parametrize("seed", range(2))
def test_each_of_some_separate_movers_keeps_one_name(tracker, seed):
    out = follow(tracker, APART, 120, seed, clutter=0.3)
    names = names_of(out, APART, since=20)
    assert [len(n) for n in names] == [1, 1, 1]
    assert len(set.union(*names)) == 3


def test_a_mover_is_confirmed_within_60_ms_of_its_first_bearing():
    first = next(k for k, tracks in enumerate(follow(KALMAN, APART, 12, 0, miss=0.0)) if tracks)
    assert first * PERIOD_US <= 60_000


def test_clutter_alone_confirms_nothing():
    for seed in range(2):
        assert not any(follow(KALMAN, [], 150, seed, clutter=1.5))


def test_position_velocity_and_size_are_right_at_three_metres():
    errors = []
    for seed in range(3):
        for k, tracks in enumerate(follow(KALMAN, APART, 150, seed)[40:], start=40):
            t_s = 1e-6 * PERIOD_US * k
            for track in tracks:
                who, off = nearest(track, APART, t_s)
                v_off = np.linalg.norm(track.v_WO - APART[who].velocity(t_s))
                errors.append((off, v_off, track.shape.radius_m / APART[who].radius_m - 1.0))
    p_rmse, v_rmse, size_rmse = np.sqrt(np.mean(np.square(errors), axis=0))
    assert p_rmse <= 0.25
    assert v_rmse <= 0.3
    assert size_rmse <= 0.15


def occluded_between(a, b):
    return lambda k: (0,) if a <= k < b else ()


def test_a_short_occlusion_is_coasted_through():
    movers = [Swing((3.0, -0.5, 2.0), (0.0, 0.6, 0.0))]
    out = follow(KALMAN, movers, 120, 0, hidden=occluded_between(50, 80))
    assert len({t.track_id for tracks in out for t in tracks}) == 1
    assert all(len(tracks) == 1 for tracks in out[20:])


def test_after_a_long_occlusion_a_mover_gets_its_name_back():
    movers = [Swing((3.0, -1.0, 2.0), (0.0, 0.6, 0.0)), APART[1]]
    out = follow(KALMAN, movers, 300, 1, hidden=occluded_between(80, 190))
    assert len(out[150]) == 1
    names = names_of(out, movers, since=20)
    assert [len(n) for n in names] == [1, 1]


def test_what_comes_back_much_larger_or_far_off_is_another_one():
    first = Swing((3.0, -1.0, 2.0), (0.0, 0.6, 0.0))
    larger = Swing((3.0, -1.0, 2.0), (0.0, 0.6, 0.0), radius_m=0.7)
    elsewhere = Swing((-3.0, 0.0, 4.0), (0.0, 0.0, 0.0))

    def hidden(k):
        return (1,) if k < 60 else (0, 1) if k < 130 else (0,)

    for other in (larger, elsewhere):
        out = follow(KALMAN, [first, other], 160, 0, hidden=hidden)
        before, after = ({t.track_id for t in out[k]} for k in (50, 159))
        assert len(before) == len(after) == 1
        assert before != after


def test_a_track_that_is_seen_no_more_is_handed_out_no_longer_than_said():
    out = follow(KALMAN, APART[:1], 200, 0, hidden=lambda k: (0,) if k >= 60 else ())
    unseen = [k for k, tracks in enumerate(out) if k >= 60 and tracks]
    assert max(unseen) == pytest.approx(60 + KALMAN.coast_s * 1e6 / PERIOD_US, abs=2)


def test_a_camera_with_ranges_needs_no_other():
    out = follow(KALMAN, APART[:1], 40, 0, cameras=[0], ranged=True)
    (track,) = out[-1]
    assert nearest(track, APART[:1], 0.39)[1] < 0.1


@pytest.mark.parametrize("tracker", [KALMAN, PARTICLES], ids=["kalman", "particles"])
def test_a_camera_alone_never_believes_to_know_the_distance(tracker):
    """Truth stays within three standard deviations, and the direction is right."""
    mover = Swing((3.0, 0.0, 2.0), (0.0, 0.8, 0.0), radius_m=0.3)
    for k, tracks in enumerate(follow(tracker, [mover], 250, 0, cameras=[0])[30:], start=30):
        (track,) = tracks
        true = mover.place(1e-6 * PERIOD_US * k) - CAMERAS[0]
        rel = track.p_WO - CAMERAS[0]
        rho = np.linalg.norm(rel)
        d = rel / rho
        share = np.sqrt(d @ track.covariance[:3, :3] @ d) / rho
        assert share > 0.2
        assert abs(np.log(np.linalg.norm(true) / rho)) < 2.5 * share
        assert np.linalg.norm(true / np.linalg.norm(true) - d) < 0.05


def test_when_a_second_camera_joins_the_distance_is_found_and_the_name_kept():
    mover, rng = Swing((3.0, 0.0, 2.0), (0.0, 0.8, 0.0), radius_m=0.35), np.random.default_rng(2)
    memory, names = KALMAN.init(), set()
    for k in range(160):
        cameras = (0,) if k < 100 else (0, 3)
        seen = tuple(seen_by(c, [mover], k, rng)[0] for c in cameras)
        memory, tracks = KALMAN.step(memory, PERIOD_US * k, seen)
        names |= {t.track_id for t in tracks}
    assert len(names) == 1
    assert nearest(tracks[0], [mover], 1.59)[1] < 0.1
    assert tracks[0].shape.radius_m == pytest.approx(0.35, rel=0.1)


def test_one_camera_keeps_the_distance_that_two_have_found():
    """A size once known places what one camera sees."""
    mover, rng = Swing((3.0, 0.0, 2.0), (0.0, 0.8, 0.0)), np.random.default_rng(2)
    memory, errors = KALMAN.init(), []
    for k in range(200):
        cameras = (0, 3) if k < 80 else (0,)
        seen = tuple(seen_by(c, [mover], k, rng)[0] for c in cameras)
        memory, tracks = KALMAN.step(memory, PERIOD_US * k, seen)
        if k >= 80:
            errors.append(nearest(tracks[0], [mover], 1e-6 * PERIOD_US * k)[1])
    assert np.sqrt(np.mean(np.square(errors))) < 0.25


def in_tube_share(tracker, movers, seeds, steps=220):
    """Share of tracks and times whose mover stays in its tube over all of the next second."""
    held = []
    for seed in seeds:
        for k, tracks in enumerate(follow(tracker, movers, steps, seed)):
            if k < 30 or k % 10:
                continue
            for track in tracks:
                t_s = 1e-6 * PERIOD_US * k
                who, _ = nearest(track, movers, t_s)
                ahead = np.linspace(0.0, 1.0, 11)
                off = [np.linalg.norm(movers[who].place(t_s + a) - track.p_WO - a * track.v_WO)
                       for a in ahead]  # fmt: skip
                tube = [track.tube_m(a) for a in ahead]
                held.append(np.all(np.array(off) <= tube))
    return np.mean(held)


def test_the_tube_holds_the_mover_over_the_next_second_as_often_as_it_says():
    """Movers as the scenarios have them: swings of 3 to 8 s, straight ways."""
    rng = np.random.default_rng(7)
    held = []
    for seed in range(3):
        movers = [
            Swing(tuple(m), tuple(rng.normal(size=3) * [0.8, 0.8, 0.3]), rng.uniform(3.0, 8.0),
                  rng.uniform(0.0, 8.0))
            for m in ([3.0, 0.0, 2.0], [-3.0, 0.5, 2.0], [0.0, 3.0, 1.5])
        ]  # fmt: skip
        movers.append(Swing((0.0, -3.0, 2.0), tuple(0.4 * rng.normal(size=3)), 0.0, -1.0))
        held.append(in_tube_share(KALMAN, movers, [seed]))
    assert 0.90 <= np.mean(held) <= 0.99


def test_steps_are_pure():
    from skyhaul.perception.obstacles.api import Bearings

    for tracker in (KALMAN, PARTICLES):
        memory = tracker.init()
        d = np.array([[1.0, 0.0, 0.0]])
        seen = tuple(
            Bearings(0, c, np.array([0.0, y, 0.0]), np.zeros(3), d, np.array([0.01]),
                     np.array([0.1]), np.array([3.0]), np.array([0.05]), np.zeros(1), np.ones(1))
            for c, y in enumerate((0.0,))
        )  # fmt: skip
        for k in range(8):
            memory, _ = tracker.step(memory, PERIOD_US * k, seen)
        (a,), (b,) = (tracker.step(memory, 8 * PERIOD_US, seen)[1] for _ in range(2))
        np.testing.assert_array_equal(a.p_WO, b.p_WO)
        np.testing.assert_array_equal(a.covariance, b.covariance)


@pytest.mark.parametrize(
    "wrong",
    [
        {"confirm_hits": 7},
        {"confirm_alone": 0},
        {"rejoin_m": 0.0},
        {"gate_probability": 1.0},
        {"coast_s": 0.0},
    ],
)
def test_impossible_rules_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        BearingTracker(**wrong)


def test_models_can_be_chosen():
    single = BearingTracker(filter=KalmanFilter(models="velocity"))
    assert len(follow(single, APART, 40, 0)[-1]) == 3
