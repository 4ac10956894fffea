# SPDX-License-Identifier: Apache-2.0
"""Every payload controller under every trigger flies the lying eight."""

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


OPEN_LOOP_WRENCH = pytest.mark.xfail(
    reason="the paper's wrench, open loop at 20 Hz, takes yaw moments for immediate: it diverges",
    strict=True,
)
KINDS = [
    pytest.param(payload, trigger, marks=OPEN_LOOP_WRENCH)
    if (payload, trigger) == ("wrench", "periodic")
    else (payload, trigger)
    for payload in ("nmpc", "wrench", "geometric")
    for trigger in ("event", "periodic", "periodic-feedback")
]


@pytest.mark.parametrize(("payload", "trigger"), KINDS)
def test_figure8(flown, payload, trigger):
    kinds = (f"control.payload.kind={payload}", f"mission.trigger.kind={trigger}")
    metrics = flown("figure8", kinds)
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == 0
    assert metrics["min_tension_n"] > 0.0
    assert metrics["tracking_rmse_m"] < 0.15


@pytest.mark.parametrize("trigger", ["event", "periodic-feedback"])
def test_feedback_spares_four_solves_in_five(flown, trigger):
    few = flown("figure8", (f"mission.trigger.kind={trigger}", "task.laps=1"))
    many = flown("figure8", ("mission.trigger.kind=periodic", "task.laps=1"), seed=1)
    assert few["nmpc_solves"] < 0.2 * many["nmpc_solves"]
    assert few["tracking_rmse_m"] < 1.05 * many["tracking_rmse_m"]


@pytest.mark.parametrize("delay_ms", [10, 40])
def test_circle_over_a_bus_with_delay(flown, delay_ms):
    metrics = flown("circle", (f"comms.delay_ms={delay_ms}",))
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["tracking_rmse_m"] < 0.03
