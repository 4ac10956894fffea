# SPDX-License-Identifier: Apache-2.0
"""Voxels: which a ray passes, what hits and misses add up to, and what open space is."""

import numpy as np
import pytest

from skyhaul.perception.scene.evidence import (
    EvidenceRules,
    clear_ball,
    empty_evidence,
    forget_changes,
    in_open,
    take_hits,
    take_misses,
)

RULES = EvidenceRules()
P_WO = np.array([-0.95, -0.95, 0.05])
N = np.array([20, 20, 20])


def fresh():
    return empty_evidence(P_WO.copy(), 0.1, N)


def center(*cell):
    return P_WO + 0.1 * np.array(cell, dtype=np.float64)


def hits(e, frame, *cells, each=4):
    take_hits(RULES, e, frame, np.repeat([center(*c) for c in cells], each, axis=0))


@pytest.mark.parametrize("seed", range(20))
def test_a_ray_passes_the_voxels_that_its_points_lie_in(seed):
    rng = np.random.default_rng(seed)
    start, end = rng.uniform([-1.2, -1.2, -0.2], [1.2, 1.2, 2.2], (2, 3))
    e = fresh()
    take_misses(RULES, e, 0, start, end[None])
    line = start + np.linspace(0.0, 1.0, 200_001)[:, None] * (end - start)
    cells = np.floor((line - P_WO) / 0.1 + 0.5).astype(int)
    cells = cells[np.all((cells >= 0) & (cells < N), axis=1)]
    passed = np.zeros(N, bool)
    passed[tuple(cells.T)] = True
    np.testing.assert_array_equal(e.known, passed)


def test_a_frame_counts_once_in_a_voxel_and_hits_come_before_misses():
    e, a = fresh(), center(10, 10, 10)
    hits(e, 0, (10, 10, 10), each=50)
    assert e.log_odds[10, 10, 10] == pytest.approx(RULES.hit)
    take_misses(RULES, e, 0, center(0, 10, 10), np.tile(center(19, 10, 10), (30, 1)))
    assert e.log_odds[10, 10, 10] == pytest.approx(RULES.hit)
    assert e.log_odds[9, 10, 10] == pytest.approx(RULES.miss)
    take_misses(RULES, e, 1, center(0, 10, 10), a[None])
    assert e.log_odds[10, 10, 10] == pytest.approx(RULES.hit + RULES.miss)


def test_single_points_are_noise():
    e = fresh()
    hits(e, 0, (5, 5, 5), each=RULES.least_points - 1)
    assert e.log_odds[5, 5, 5] == 0.0
    assert not e.known.any()


def test_two_hits_make_a_voxel_occupied_and_rays_free_it_again():
    e, cell = fresh(), (5, 5, 5)
    hits(e, 0, cell)
    assert not e.occupied[cell]
    hits(e, 1, cell)
    assert e.occupied[cell]
    for frame in range(2, 40):
        take_misses(RULES, e, frame, center(0, 5, 5), center(19, 5, 5)[None])
    assert not e.occupied[cell]
    assert e.log_odds.min() == pytest.approx(RULES.least)


def test_evidence_is_clamped_so_that_what_leaves_is_soon_forgotten():
    e, cell = fresh(), (5, 5, 5)
    for frame in range(100):
        hits(e, frame, cell)
    assert e.log_odds[cell] == pytest.approx(RULES.most)
    frames = 0
    while e.occupied[cell]:
        take_misses(RULES, e, 100 + frames, center(0, 5, 5), center(19, 5, 5)[None])
        frames += 1
    assert frames == int(np.ceil((RULES.most - RULES.free_below) / -RULES.miss + 1e-6))


def free(e, frames, first=0):
    """Let rays pass everywhere around the middle."""
    grid = np.array([center(19, j, k) for j in range(20) for k in range(20)])
    for frame in range(first, first + frames):
        for end in grid:
            take_misses(RULES, e, frame, end - [1.9, 0.0, 0.0], end[None])


def test_open_space_is_where_rays_passed_and_stays_open_when_something_comes():
    e, p = fresh(), center(10, 10, 10)[None]
    assert not in_open(e, p)[0]
    free(e, 4)
    assert in_open(e, p)[0]
    for frame in range(10, 14):
        hits(e, frame, (10, 10, 10))
    assert e.occupied[10, 10, 10]
    assert in_open(e, p)[0]


def test_beside_what_never_was_free_it_is_not_open():
    e = fresh()
    for frame in range(8):
        hits(e, frame, (10, 10, 11))
        free(e, 1, frame)
    assert not in_open(e, center(10, 10, 10)[None])[0]
    assert in_open(e, center(10, 10, 8)[None])[0]


def test_what_stays_long_enough_belongs_there():
    e = fresh()
    free(e, 4)
    for frame in range(RULES.close_hits):
        assert in_open(e, center(10, 10, 10)[None])[0]
        hits(e, 10 + frame, (10, 10, 10))
    assert not in_open(e, center(10, 10, 10)[None])[0]


def test_changes_are_noted_as_the_range_that_holds_them():
    e = fresh()
    assert np.all(e.changed[0] >= e.changed[1])
    hits(e, 0, (3, 4, 5), (8, 2, 9))
    hits(e, 1, (3, 4, 5), (8, 2, 9))
    np.testing.assert_array_equal(e.changed, [[3, 2, 5], [9, 5, 10]])
    forget_changes(e)
    assert np.all(e.changed[0] >= e.changed[1])


def test_a_ball_is_cleared_and_nothing_else():
    e = fresh()
    for frame in (0, 1):
        hits(e, frame, *((i, 10, 10) for i in range(20)))
    clear_ball(RULES, e, center(10, 10, 10), 0.25)
    np.testing.assert_array_equal(
        np.flatnonzero(e.occupied[:, 10, 10]), [*range(8), *range(13, 20)]
    )


@pytest.mark.parametrize("wrong", [{"hit": -0.1}, {"miss": 0.2}, {"free_below": 2.0}])
def test_rules_that_contradict_each_other_are_refused(wrong):
    with pytest.raises(ValueError, match=r"needed|must be"):
        EvidenceRules(**wrong)
