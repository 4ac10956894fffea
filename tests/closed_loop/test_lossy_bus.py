# SPDX-License-Identifier: Apache-2.0
"""A bus that loses a fifth of the messages and delays the rest by 20 ms costs no mission."""

import pytest

LOSSY = ("comms.loss=0.2", "comms.delay_ms=20")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_paper_s_mission_is_done(flown, seed):
    metrics = flown("paper", LOSSY, seed)
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == 0
    assert metrics["tracking_rmse_m"] < 0.05


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_others_bring_the_load_to_the_goal_when_a_vehicle_dies(flown, seed):
    metrics = flown("lost-vehicle", LOSSY, seed)
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == metrics["collisions_lost_vehicle"]
