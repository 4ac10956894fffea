# SPDX-License-Identifier: Apache-2.0
"""What every obstacle field must do. A new one adds one entry to FIELDS."""

import numpy as np
import pytest

from skyhaul.geometry.shapes import Box, Capsule, Sphere
from skyhaul.model import Team
from skyhaul.model.envelope import team_shape
from skyhaul.world.motion import obstacle_field
from skyhaul.world.obstacles import Appearance, Circle, CyclicPath, Line, Obstacle
from skyhaul.world.scenario import World

BALL, BOX = Sphere(radius_m=0.2), Box(size_m=(0.4, 0.4, 1.0), yaw_deg=20.0)
ROD = Capsule(radius_m=0.1, length_m=0.6)
SQUARE = CyclicPath(points_m=((6, 3, 1), (6, 6, 1), (3, 6, 1)), speed_mps=0.7, dwell_s=1.0)
OBSTACLES = (
    Obstacle(name="stands", shape=BOX, center_m=(1, 1, 1)),
    Obstacle(name="cycles", shape=BALL, center_m=(3, 3, 1), motion=SQUARE),
    Obstacle(name="shuttles", shape=ROD, center_m=(0, 5, 2),
             motion=Line(velocity_mps=(0.3, 0.1, 0.0), length_m=2.0, phase_s=1.0)),
    Obstacle(name="leaves", shape=BALL, center_m=(2, 2, 2), motion=Line(velocity_mps=(0, 0, 0.4))),
    Obstacle(name="circles", shape=BOX, center_m=(8, 4, 3),
             motion=Circle(center_m=(7, 4, 3), period_s=9.0, normal=(0, 1, 2))),
    Obstacle(name="late", shape=BALL, center_m=(4, 8, 1), appears=Appearance(at_s=2.0)),
    Obstacle(name="near", shape=BALL, center_m=(9, 9, 2), appears=Appearance(distance_m=1.5)),
)  # fmt: skip
SHAPE = team_shape(Team(), 0.0)
FIELDS = [lambda seed: obstacle_field(World(obstacles=OBSTACLES), seed, SHAPE)]
FAR = np.array([-50.0, 0.0, 0.0])

every_field = pytest.mark.parametrize("make", FIELDS, ids=["moving-obstacles"])
times = pytest.mark.parametrize("t_us", [0, 123_456, 2_000_000, 7_654_321, 600_000_000])


@every_field
@times
def test_rows_keep_the_order_of_the_scenario(make, t_us):
    field = make(0)
    assert field.names == tuple(o.name for o in OBSTACLES)
    shapes = field.shapes_at(t_us)
    assert len(shapes.kind) == len(field.velocities_at(t_us)) == len(OBSTACLES)
    np.testing.assert_array_equal(shapes.p_WO[0], OBSTACLES[0].center_m)
    np.testing.assert_allclose(shapes.R_WO @ shapes.R_WO.transpose(0, 2, 1),
                               np.tile(np.eye(3), (len(OBSTACLES), 1, 1)), atol=1e-12)  # fmt: skip


@every_field
@times
@pytest.mark.parametrize("seed", [0, 5])
def test_velocity_is_the_derivative_of_the_place(make, t_us, seed):
    field, h = make(seed), 50
    ahead, behind = (field.shapes_at(t_us + d).p_WO.copy() for d in (h, -h))
    slope = (ahead - behind) / (2e-6 * h)
    np.testing.assert_allclose(field.velocities_at(t_us), slope, atol=2e-4)


@every_field
def test_time_may_be_asked_in_any_order(make):
    field, t = make(0), [0, 5_000_000, 1_000_000]
    there = [field.shapes_at(x).p_WO.copy() for x in t]
    back = [field.shapes_at(x).p_WO.copy() for x in reversed(t)]
    np.testing.assert_array_equal(there, back[::-1])


@every_field
def test_same_seed_same_motion_and_another_seed_another_phase(make):
    a, b, c = (make(seed).shapes_at(1_000_000).p_WO.copy() for seed in (7, 7, 8))
    np.testing.assert_array_equal(a, b)
    moved = np.linalg.norm(a - c, axis=1) > 1e-3
    cyclic = [o.name in ("cycles", "shuttles", "circles") for o in OBSTACLES]
    np.testing.assert_array_equal(moved, cyclic)


@every_field
def test_what_appears_is_there_from_its_time_or_its_distance_on(make):
    field = make(0)
    near = np.array([9.0, 9.0, 2.0 - 1.0])
    assert [bool(field.present(t, FAR)[5]) for t in (1_999_999, 2_000_000)] == [False, True]
    assert not field.present(0, FAR)[6]
    assert field.present(0, near)[6]
    assert field.present(0, FAR)[:5].all()


@every_field
def test_present_is_pure(make):
    field = make(0)
    field.present(0, np.array([9.0, 9.0, 1.0]))
    assert not field.present(0, FAR)[6]
