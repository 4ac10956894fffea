# SPDX-License-Identifier: Apache-2.0
"""One cost for every choice between two ways: time, length, little clearance."""

import numpy as np
import pytest

from skyhaul.planning.cost import (
    METRE_S,
    ROOMY_M,
    TIGHT_S,
    WORTH_S,
    is_better,
    reference_cost,
    way_cost,
)
from skyhaul.planning.tasks import leg_reference
from skyhaul.world.scenario import Limits

CORNERS = np.array([[0.0, 0.0, 1.0], [3.0, 0.0, 1.0], [3.0, 4.0, 1.0]])


def test_a_roomy_way_costs_its_time_and_its_length():
    assert way_cost(10.0, 5.0, ROOMY_M) == pytest.approx(10.0 + 5.0 * METRE_S)
    assert way_cost(10.0, 5.0, 9.0) == way_cost(10.0, 5.0, ROOMY_M)


def test_little_clearance_costs_and_never_more_than_its_share():
    assert way_cost(0.0, 0.0, 0.5 * ROOMY_M) == pytest.approx(0.5 * TIGHT_S)
    assert way_cost(0.0, 0.0, -1.0) == way_cost(0.0, 0.0, 0.0) == pytest.approx(TIGHT_S)


def test_a_reference_costs_what_is_left_of_it():
    reference = leg_reference(CORNERS, 0.0, 1_000_000, Limits())
    whole = reference_cost(reference, 1_000_000, 1.0)
    taken_s = (reference.end_us - reference.start_us) / 1e6
    assert whole == pytest.approx(taken_s + METRE_S * 7.0, abs=0.2)
    later = [reference_cost(reference, t, 1.0) for t in range(1_000_000, reference.end_us, 500_000)]
    assert (np.diff(later) < 0.0).all()
    assert reference_cost(reference, reference.end_us + 5, 1.0) == 0.0


@pytest.mark.parametrize(("left_s", "needed"), [(4.0, 0.6), (20.0, WORTH_S)])
def test_a_change_must_save_a_share_of_what_is_left_or_a_second(left_s, needed):
    assert not is_better(10.0, 10.0 + needed - 0.01, left_s, 0.85)
    assert is_better(10.0, 10.0 + needed + 0.01, left_s, 0.85)
    assert not is_better(11.0, 10.0, left_s, 0.85)


def test_of_two_ways_that_end_together_the_longer_and_tighter_is_no_change_for_the_better():
    now = way_cost(8.0, 9.0, 0.3)
    assert not is_better(way_cost(6.5, 14.0, 0.02), now, 8.0, 0.85)
    assert is_better(way_cost(6.5, 9.0, 0.3), now, 8.0, 0.85)
