# SPDX-License-Identifier: Apache-2.0
"""Rounded corners and speeds along a path: limits, rests, ends, closed forms."""

import numpy as np
import pytest

from skyhaul.mapping.api import OccupancyGrid
from skyhaul.mapping.mapper import static_map
from skyhaul.model.envelope import TeamShape
from skyhaul.planning.motion import Drive, control_points, run_along
from skyhaul.planning.path import curvatures, round_corners
from skyhaul.planning.shortcut import subdivide

DRIVE = Drive(1.5, 0.85, 0.0, 0.0, -1.0, 0.0, np.inf)
SHAPE = TeamShape(radius_m=0.3, above_m=0.4, below_m=0.1)
EMPTY = static_map(OccupancyGrid(np.zeros((80, 80, 30), np.bool_), np.full(3, 0.05), 0.1), SHAPE)
BEND = np.array([[1.0, 1.0, 1.0], [5.0, 1.0, 1.0], [5.0, 6.0, 1.5], [6.5, 6.5, 1.5]])


def line(length, spacing=0.05) -> np.ndarray:
    return subdivide(np.array([[0.0, 0, 0], [length, 0, 0]]), spacing)


def round_path(reach=1.0, path=BEND, world_map=EMPTY) -> np.ndarray:
    return round_corners(world_map.arrays, path, reach, 0.05, 0.05)


def test_rounding_keeps_the_ends_and_stays_within_the_corner_triangles():
    p = round_path()
    np.testing.assert_array_equal(p[[0, -1]], BEND[[0, -1]])
    assert np.max(np.linalg.norm(np.diff(p, axis=0), axis=1)) < 0.08
    # the parabola leaves a right angle by half the cut over sqrt(2)
    corner = np.min(np.linalg.norm(p - BEND[1], axis=1))
    assert corner == pytest.approx(1.0 / 2.0 / np.sqrt(2.0) * np.sqrt(1.01), rel=0.05)


def test_rounding_leaves_no_sharp_turn():
    d = np.diff(round_path(), axis=0)
    d /= np.linalg.norm(d, axis=1)[:, None]
    assert np.min((d[:-1] * d[1:]).sum(axis=1)) > np.cos(np.deg2rad(9.0))


def test_a_corner_that_would_touch_is_rounded_less():
    occupied = np.zeros((80, 80, 30), np.bool_)
    occupied[43:45, 15:17, :] = True  # inside of the bend at (5, 1)
    tight = round_path(world_map=static_map(OccupancyGrid(occupied, np.full(3, 0.05), 0.1), SHAPE))
    free = round_path()
    nearest = [np.min(np.linalg.norm(p - BEND[1], axis=1)) for p in (tight, free)]
    assert nearest[0] < 0.6 * nearest[1]


def test_curvature_of_a_circle_is_one_over_its_radius():
    a = np.linspace(0.0, 3.0, 200)
    p = 2.5 * np.column_stack([np.cos(a), np.sin(a), 0.0 * a])
    np.testing.assert_allclose(curvatures(p)[1:-1], 0.4, rtol=1e-3)


def test_a_short_line_is_flown_with_constant_acceleration_and_braking():
    run = run_along(line(1.0), 0.0, DRIVE)
    assert run.time[-1] == pytest.approx(2.0 * np.sqrt(1.0 / 0.85), rel=1e-6)
    assert run.speed.max() == pytest.approx(np.sqrt(0.85), rel=1e-6)


def test_a_long_line_reaches_the_speed_limit():
    run = run_along(line(10.0), 0.0, DRIVE)
    assert run.speed.max() == pytest.approx(1.5)
    assert run.time[-1] == pytest.approx(10.0 / 1.5 + 1.5 / 0.85, rel=1e-3)


def test_a_circle_is_flown_at_the_lateral_limit():
    a = np.linspace(0.0, 4.0, 400)
    p = np.column_stack([np.cos(a), np.sin(a), 0.0 * a])
    run = run_along(p, 0.0, DRIVE)
    middle = run.speed[150:250]
    np.testing.assert_allclose(middle, np.sqrt(0.8 * 0.85), rtol=5e-3)


@pytest.mark.parametrize("speed_0", [0.0, 0.7, 1.5])
def test_acceleration_along_and_across_stays_within_the_limit(speed_0):
    run = run_along(round_path(), speed_0, DRIVE)
    assert run.feasible
    assert run.speed[0] == pytest.approx(speed_0)
    along = np.diff(run.speed**2) / (2.0 * np.diff(run.way))
    across = (curvatures(run.points) * run.speed**2)[1:]
    assert np.max(np.hypot(along, across)) < 0.85 * 1.03
    assert run.speed[-1] == 0.0


def test_a_speed_too_high_for_what_follows_is_told():
    assert not run_along(line(0.5), 1.5, DRIVE).feasible
    assert run_along(line(1.4), 1.5, DRIVE).feasible


def test_a_rest_on_the_way_takes_its_time_and_an_early_end_cuts():
    go = run_along(line(6.0), 0.0, DRIVE)
    rest = run_along(line(6.0), 0.0, DRIVE._replace(rest_at=2.03, rest_s=1.5))
    two_legs = sum(run_along(line(x), 0.0, DRIVE).time[-1] for x in (2.03, 3.97))
    assert rest.time[-1] == pytest.approx(two_legs + 1.5, rel=1e-3)
    assert rest.way[rest.rest_index] == pytest.approx(2.03)
    cut = run_along(line(6.0), 0.0, DRIVE._replace(end_at=2.03))
    np.testing.assert_allclose(cut.points[-1], [2.03, 0, 0], atol=1e-12)
    assert cut.time[-1] < go.time[-1]


def test_control_points_follow_the_run_and_end_with_equal_ones():
    run = run_along(line(3.0), 0.0, DRIVE)
    first = np.zeros((7, 4))
    control = control_points(first, run, 0.3)
    t = 0.3 * np.arange(1, 6)
    np.testing.assert_allclose(control[7:12, 0], 0.5 * 0.85 * t**2, atol=1e-9)
    left = run.time[-1] - 0.3 * np.arange(9, len(control) - 14)
    np.testing.assert_allclose(
        control[15 : 15 + len(left), 0], 3.0 - 0.5 * 0.85 * left**2, atol=1e-9
    )
    np.testing.assert_array_equal(control[-8:], np.tile(control[-1], (8, 1)))
    np.testing.assert_allclose(control[-1, :3], [3.0, 0, 0])


def test_differences_of_control_points_hold_the_limits():
    control = control_points(
        np.tile([1.0, 1.0, 1.0, 0.0], (7, 1)), run_along(round_path(), 0.0, DRIVE), 0.3
    )
    v = np.linalg.norm(np.diff(control[:, :3], axis=0), axis=1) / 0.3
    a = np.linalg.norm(np.diff(control[:, :3], 2, axis=0), axis=1) / 0.09
    assert v.max() <= 1.5 + 1e-9
    assert a.max() <= 0.85 * 1.05


def test_yaw_comes_to_rest_smoothly():
    first = np.zeros((7, 4))
    first[:, 3] = 0.1 * np.arange(7)
    control = control_points(first, run_along(line(3.0), 0.0, DRIVE), 0.3)
    steps = np.diff(control[:, 3])[6:]
    np.testing.assert_allclose(steps[:5], 0.1 * 0.5 ** np.arange(1, 6))
    np.testing.assert_array_equal(steps[-7:], 0.0)
