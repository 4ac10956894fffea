# SPDX-License-Identifier: Apache-2.0
"""The paper's mission on the team's own estimate of itself."""

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.mark.parametrize("scenario", ["paper", "lost-vehicle"])
def test_the_mission_is_done_on_fused_estimates(flown, scenario):
    metrics = flown(scenario, ("perception.team.kind=fused",))
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == 0
    assert metrics["min_clearance_m"] > 0.0


@pytest.mark.parametrize("scenario", ["forest", "window"])
def test_a_team_that_sees_passes_what_stands(flown, scenario):
    seeing = ("perception.team.kind=fused", "perception.obstacles.kind=cameras")
    metrics = flown(scenario, (*seeing, "perception.odometry.kind=ekf"))
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == 0
    assert metrics["min_clearance_m"] > 0.0
