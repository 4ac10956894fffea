# SPDX-License-Identifier: Apache-2.0
"""Three to eight vehicles fly the same missions with the same code."""

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

COUNTS = range(3, 9)


@pytest.mark.parametrize("n", COUNTS)
def test_circle(flown, n):
    ring = (f"team.count={n}", "team.azimuths_deg=null", "team.hooks_m=null")
    metrics = flown("circle", ring)
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == 0
    assert metrics["min_tension_n"] > 0.0
    assert metrics["tracking_rmse_m"] < 0.02


@pytest.mark.parametrize("n", COUNTS)
def test_paper(flown, n):
    ring = (f"team.count={n}", "team.azimuths_deg=null", "start.vehicles_m=null")
    metrics = flown("paper", ring)
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == 0
    assert metrics["min_clearance_m"] > 0.0
    assert metrics["min_tension_n"] > 0.0
