# SPDX-License-Identifier: Apache-2.0
"""Tests of `world.motion`."""

import numpy as np
import pytest

from skyhaul.errors import ConfigError
from skyhaul.geometry.distance import team_clearance
from skyhaul.geometry.shapes import Box, Sphere
from skyhaul.model.envelope import TeamShape
from skyhaul.world.motion import obstacle_field
from skyhaul.world.obstacles import Appearance, Circle, CyclicPath, Line, Obstacle, Static
from skyhaul.world.scenario import World

BALL = Sphere(radius_m=0.2)
CYCLE = CyclicPath(points_m=((3, 1, 1), (3, 2, 1), (1, 2, 2)), speed_mps=0.5)
DWELL = CyclicPath(points_m=((3, 1, 1),), speed_mps=0.5, dwell_s=2.0)
SHUTTLE = Line(velocity_mps=(0.6, 0.0, 0.8), length_m=2.0)
ROUND = Circle(center_m=(0, 0, 0.5), period_s=4.0)
TILTED = Circle(center_m=(0, 0, 0.5), period_s=-4.0, normal=(0, 1, 1))
FAST = CyclicPath(points_m=((1.2, 1, 1), (1.2, 1.3, 1)), speed_mps=2.0)
REPEATING = [CYCLE, DWELL, SHUTTLE, ROUND, TILTED, FAST]


def field_of(*motions, seed=0):
    obstacles = [
        Obstacle(name=f"o{j}", shape=BALL, center_m=(1, 1, 1), motion=m)
        for j, m in enumerate(motions)
    ]
    return obstacle_field(World(obstacles=tuple(obstacles)), seed)


def path(field, times_s):
    states = [field.state_at(round(1e6 * t)) for t in times_s]
    return np.array([p[0] for p, _ in states]), np.array([v[0] for _, v in states])


@pytest.mark.parametrize("motion", REPEATING)
def test_velocity_is_continuous_and_the_derivative_of_position(motion):
    dt = 1e-3
    p, v = path(field_of(motion), np.arange(0.0, 40.0, dt))
    slope = np.diff(p, axis=0) / dt
    np.testing.assert_allclose(slope, 0.5 * (v[1:] + v[:-1]), atol=8.0 * dt)
    assert np.max(np.linalg.norm(np.diff(v, axis=0), axis=1)) < 40.0 * dt  # no jump


@pytest.mark.parametrize("motion", [CYCLE, DWELL, FAST])
def test_a_cycle_runs_at_its_speed_at_most_and_comes_back_to_its_own_position(motion):
    field = field_of(motion)
    period = field.motions.period[0]
    p, v = path(field, np.array([0.0, period, 3.0 * period]))
    np.testing.assert_allclose(p, np.ones((3, 3)), atol=1e-5)
    np.testing.assert_allclose(v, 0.0, atol=1e-4)
    _, v = path(field, np.linspace(0.0, period, 500))
    speed = np.linalg.norm(v, axis=1)
    assert np.max(speed) == pytest.approx(motion.speed_mps)


def test_corners_are_cut_by_a_known_distance():
    """Half way through a corner the piece is |u_1 - u_0| d / 4 off the corner."""
    p, _ = path(field_of(CYCLE), np.arange(0.0, 20.0, 1e-3))
    nearest = np.min(np.linalg.norm(p - np.array([3.0, 1.0, 1.0]), axis=1))
    np.testing.assert_allclose(nearest, np.sqrt(2.0) * 0.25 / 4.0, atol=1e-4)


def test_a_dwell_is_rest_at_the_own_position():
    p, v = path(field_of(DWELL), [0.0, 1.0, 1.99])
    np.testing.assert_allclose(p, 1.0)
    np.testing.assert_allclose(v, 0.0)
    assert path(field_of(DWELL), [2.5])[0][0, 0] > 1.0


def test_a_line_covers_exactly_its_length_and_turns():
    p, _ = path(field_of(SHUTTLE), np.arange(0.0, 12.0, 1e-3))
    along = (p - 1.0) @ np.array([0.6, 0.0, 0.8])
    assert np.min(along) == pytest.approx(0.0, abs=1e-6)
    assert np.max(along) == pytest.approx(2.0, abs=1e-6)
    np.testing.assert_allclose(np.linalg.norm(p - 1.0, axis=1), np.abs(along), atol=1e-12)


def test_a_line_without_length_goes_on():
    p, v = path(field_of(Line(velocity_mps=(1, 2, 3), phase_s=2.0)), [8.0])
    np.testing.assert_allclose(p[0], [11.0, 21.0, 31.0])
    np.testing.assert_allclose(v[0], [1.0, 2.0, 3.0])


@pytest.mark.parametrize("motion", [ROUND, TILTED])
def test_a_circle_keeps_radius_and_height_over_its_plane(motion):
    p, _ = path(field_of(motion), np.linspace(0.0, 4.0, 9))
    n = np.array(motion.normal) / np.linalg.norm(motion.normal)
    arm = p - np.array(motion.center_m)
    np.testing.assert_allclose(np.linalg.norm(arm, axis=1), np.sqrt(2.25), atol=1e-12)
    np.testing.assert_allclose(arm @ n, arm[0] @ n, atol=1e-12)
    np.testing.assert_allclose(p[-1], p[0], atol=1e-12)


def test_a_positive_period_turns_with_the_normal():
    p, _ = path(field_of(ROUND), [0.0, 0.1])
    assert np.cross(p[0], p[1])[2] > 0.0


@pytest.mark.parametrize("motion", REPEATING)
def test_seed_0_keeps_the_printed_phase_and_others_draw_theirs(motion):
    shifted = type(motion)(**{**vars(motion), "phase_s": 1.25})
    times = np.linspace(0.0, 10.0, 21)
    expected = path(field_of(motion), times + 1.25)[0]
    np.testing.assert_allclose(path(field_of(shifted), times)[0], expected, atol=1e-9)
    drawn = [field_of(motion, seed=s).motions.phase[0] for s in range(1, 40)]
    period = field_of(motion).motions.period[0]
    assert 0.0 <= min(drawn) < 0.2 * period
    assert 0.8 * period < max(drawn) < period
    assert field_of(motion, seed=7).motions.phase[0] == field_of(motion, seed=7).motions.phase[0]


def test_each_obstacle_draws_its_own_phase():
    phase = field_of(CYCLE, CYCLE, Static(), CYCLE, seed=3).motions.phase
    assert len(set(phase)) == 4
    assert phase[2] == 0.0


def test_many_obstacles_are_each_alone():
    motions = [*REPEATING, Static()]
    together = field_of(*motions)
    for t_us in (0, 1_234_000, 9_876_000):
        p, v = together.state_at(t_us)
        alone = [field_of(m).state_at(t_us) for m in motions]
        np.testing.assert_array_equal(p, [a[0][0] for a in alone])
        np.testing.assert_array_equal(v, [a[1][0] for a in alone])
        np.testing.assert_array_equal(together.shapes_at(t_us).p_WO, p)
        np.testing.assert_array_equal(together.velocities_at(t_us), v)


def test_appearing_at_a_time_and_at_a_distance_of_surfaces():
    box = Box(size_m=(0.4, 0.4, 0.4), yaw_deg=30.0)
    shape = TeamShape(radius_m=0.5, above_m=1.0, below_m=0.1)
    obstacles = (
        Obstacle(name="always", shape=BALL, center_m=(5, 5, 5)),
        Obstacle(name="later", shape=BALL, center_m=(5, 5, 5), appears=Appearance(at_s=2.0)),
        Obstacle(name="near", shape=box, center_m=(3, 0, 1), appears=Appearance(distance_m=1.0)),
    )
    field = obstacle_field(World(obstacles=obstacles), 0, shape)
    np.testing.assert_array_equal(field.present(1_999_999, np.zeros(3)), [True, False, False])
    np.testing.assert_array_equal(field.present(2_000_000, np.zeros(3)), [True, True, False])
    s = field.shapes_at(0)
    for x in np.linspace(0.5, 2.0, 31):
        p = np.array([x, 0.0, 1.0])
        gap = team_clearance(0.5, 1.0, 0.1, p, s.kind[2], s.size[2], s.p_WO[2], s.R_WO[2])
        assert field.present(0, p)[2] == (gap <= 1.0)


def test_no_obstacles_are_no_rows():
    field = obstacle_field(World(), 5)
    assert field.shapes_at(0).p_WO.shape == (0, 3)
    assert field.velocities_at(0).shape == (0, 3)
    assert field.present(0, np.zeros(3)).shape == (0,)


@pytest.mark.parametrize("points", [((1, 1, 1),), ((2, 1, 1), (2, 1, 1)), ((2, 1, 1), (1, 1, 1))])
def test_points_that_coincide_are_refused_by_name(points):
    with pytest.raises(ConfigError, match=r"obstacle o0: no two points"):
        field_of(CyclicPath(points_m=points, speed_mps=1.0))


def test_twin_names_and_a_missing_team_shape_are_refused():
    near = Appearance(distance_m=1.0)
    sudden = Obstacle(name="a", shape=BALL, center_m=(0, 0, 0), appears=near)
    with pytest.raises(ConfigError, match="team's shape"):
        obstacle_field(World(obstacles=(sudden,)), 0)
    twin = Obstacle(name="a", shape=BALL, center_m=(0, 0, 0))
    with pytest.raises(ConfigError, match="unique"):
        obstacle_field(World(obstacles=(twin, twin)), 0)
