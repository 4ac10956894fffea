# SPDX-License-Identifier: Apache-2.0
"""Every shipped scenario, seed 0, ends with its mission done."""

import pytest

from skyhaul.world.load import scenario_names

LOST = ("lost-vehicle", "lost-vehicle-5")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.mark.parametrize("name", [n for n in scenario_names() if n not in LOST])
def test_the_mission_is_done_without_a_touch_or_a_slack_cable(flown, name):
    metrics = flown(name)
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == 0
    assert (metrics["min_clearance_m"] or 1.0) > 0.0  # None: nothing to touch
    assert metrics["min_tension_n"] > 0.0
    assert metrics["max_thrust_ratio"] <= 1.0 + 1e-9


@pytest.mark.parametrize("name", LOST)
def test_the_others_bring_the_load_to_the_goal_when_a_vehicle_dies(flown, name):
    metrics = flown(name)
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == metrics["collisions_lost_vehicle"]
    assert metrics["triggers_fault"] >= 1


@pytest.mark.parametrize("victim", [0, 2, 3])
def test_it_does_not_matter_which_of_four_vehicles_dies(flown, victim):
    metrics = flown("lost-vehicle", (f"events[0].vehicle={victim}",))
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == metrics["collisions_lost_vehicle"]
