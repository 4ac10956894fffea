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


def test_a_gap_in_one_vehicle_s_imu_costs_no_load(flown):
    gap = "sensors.faults=[{kind: imu-gap, vehicle: 0, start_s: 12, duration_s: 0.15}]"
    own = ("perception.team.kind=fused", "perception.odometry.kind=ekf")
    metrics = flown("circle", (*own, "task.laps=1", gap))
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["tracking_max_m"] < 0.1


@pytest.mark.parametrize("scenario", ["forest", "window"])
def test_a_team_that_sees_passes_what_stands(flown, scenario):
    seeing = ("perception.team.kind=fused", "perception.obstacles.kind=cameras")
    metrics = flown(scenario, (*seeing, "perception.odometry.kind=ekf"))
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == 0
    assert metrics["min_clearance_m"] > 0.0
