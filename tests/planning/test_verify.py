# SPDX-License-Identifier: Apache-2.0
"""When a curve counts as clear: exact times, the way out of a place that is too close."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.shapes import Sphere
from skyhaul.mapping.api import OccupancyGrid, WorldMap
from skyhaul.mapping.mapper import static_map
from skyhaul.model.envelope import TeamShape
from skyhaul.perception.api import Track
from skyhaul.planning.reference import resting_reference
from skyhaul.planning.tasks import leg_reference
from skyhaul.planning.verify import ESCAPE_S, verify
from skyhaul.world.scenario import Limits

SHAPE = TeamShape(radius_m=0.3, above_m=0.4, below_m=0.1)
HERE = np.array([3.0, 3.0, 1.0])


def world(p=(9.0, 9.0, 9.0), v=(0.0, 0.0, 0.0)) -> WorldMap:
    grid = OccupancyGrid(np.zeros((60, 60, 20), np.bool_), np.full(3, 0.05), 0.1)
    mover = Track(
        0, 0, Sphere(radius_m=0.2), np.array(p, np.float64), np.eye(3),
        np.array(v, np.float64), np.zeros((6, 6)), 0.0, 0.0,
    )  # fmt: skip
    return replace(static_map(grid, SHAPE), tracks=(mover,), tube_horizon_s=8.0)


def leg(to) -> object:
    return leg_reference(np.array([HERE, HERE + to]), 0.0, 0, Limits())


def test_a_mover_that_comes_tells_when():
    """It stands off 0.5 m, comes at 0.25 m/s and touches after 2 s."""
    smallest, bad_at, now = verify(
        world((4.0, 3.0, 1.0), (-0.25, 0.0, 0.0)), resting_reference(HERE, 0.0, 0), 0, 1.0
    )
    assert now == pytest.approx(0.5)
    assert bad_at == pytest.approx(2.0, abs=0.1)
    assert smallest < -0.2


def test_later_on_the_same_curve_it_is_sooner():
    m, r = world((4.0, 3.0, 1.0), (-0.25, 0.0, 0.0)), resting_reference(HERE, 0.0, 0)
    assert verify(m, r, 1_500_000, 1.0)[1] == pytest.approx(0.5, abs=0.1)


def test_a_curve_that_begins_too_close_and_leaves_is_clear():
    m = world((3.45, 3.0, 1.0))
    assert verify(m, leg([-1.0, 0.0, 0.0]), 0, 1.0)[1:] == (np.inf, pytest.approx(-0.05))


def test_a_curve_that_begins_too_close_and_stays_is_not():
    m = world((3.45, 3.0, 1.0))
    bad_at = verify(m, resting_reference(HERE, 0.0, 0), 0, 1.0)[1]
    assert bad_at == pytest.approx(ESCAPE_S, abs=0.05)


def test_a_curve_that_begins_too_close_and_goes_deeper_is_not():
    assert verify(world((3.45, 3.0, 1.0)), leg([0.3, 0.0, 0.0]), 0, 1.0)[1] < ESCAPE_S


@pytest.mark.parametrize("gap_m", [0.0, 0.12])
def test_a_wall_is_met_where_the_curve_is_too_near(gap_m):
    """The room ends at x = 6."""
    r = leg([2.7 - gap_m, 0.0, 0.0])
    bad_at = verify(world(), r, 0, 1.0)[1]
    assert (bad_at < np.inf) == (gap_m == 0.0)
