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
