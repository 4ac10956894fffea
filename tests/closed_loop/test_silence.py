# SPDX-License-Identifier: Apache-2.0
"""A vehicle whose radio fails in flight costs no mission, whether it leads or follows."""

import pytest

from skyhaul.comms.in_process import InProcessBus

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

ROOM = (
    "world.room={min_m: [-4, -4, 0], max_m: [8, 4, 5]}",
    "world.map={origin_m: [-4, -4, 0], size_m: [12, 8, 5]}",
    "world.obstacles=[]",
    "start={kind: ground, payload_m: [0, 0]}",
    "task={kind: goto, goal_m: [5, 0, 1.5]}",
    "events=[]",
    "time_limit_s=30",
)
FROM_US = 5_000_000


@pytest.mark.parametrize(("mute", "deaf"), [(True, False), (False, True), (True, True)])
@pytest.mark.parametrize("vehicle", [0, 2])
def test_the_load_comes_to_the_goal(flown, monkeypatch, vehicle, mute, deaf):
    publish, receive = InProcessBus.publish, InProcessBus.receive

    def send(bus, topic, sender, t_us, payload):
        if not (mute and sender == vehicle and t_us >= FROM_US):
            publish(bus, topic, sender, t_us, payload)

    def hear(bus, receiver, t_us):
        messages = receive(bus, receiver, t_us)
        return [] if deaf and receiver == vehicle and t_us >= FROM_US else messages

    monkeypatch.setattr(InProcessBus, "publish", send)
    monkeypatch.setattr(InProcessBus, "receive", hear)
    metrics = flown("lost-vehicle", ROOM)
    assert metrics["mission_success"], metrics["outcome"]
    assert metrics["collisions"] == 0
