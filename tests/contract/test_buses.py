# SPDX-License-Identifier: Apache-2.0
"""What every bus must do. A new one adds one entry to BUSES."""

from collections import Counter

import numpy as np
import pytest

from skyhaul.comms.in_process import InProcess

BUSES = [InProcess(), InProcess(delay_ms=25.0), InProcess(delay_ms=5.0, loss=0.4)]
LATER_US = 10**9

every_bus = pytest.mark.parametrize(
    "params", BUSES, ids=lambda p: f"{p.kind}-{p.delay_ms}-{p.loss}"
)


def busy(params, n=4, seed=3):
    """A bus after 300 messages of two topics, from everybody."""
    sent = []
    bus = params.build(n, seed, sent.append)
    for k in range(300):
        bus.publish("plan" if k % 3 else "status", k % n, 2_000 * k, k)
    return bus, sent


@every_bus
def test_nobody_hears_a_message_twice_or_its_own(params):
    bus, _ = busy(params)
    for i in range(4):
        heard = [e.payload for e in bus.receive(i, LATER_US)]
        assert max(Counter(heard).values()) == 1
        assert all(k % 4 != i for k in heard)
        assert bus.receive(i, LATER_US) == []


@every_bus
def test_each_sender_is_heard_in_the_order_of_sending(params):
    bus, _ = busy(params)
    sent_us = [e.sent_us for e in bus.receive(0, LATER_US)]
    assert sent_us == sorted(sent_us)


@every_bus
def test_messages_sent_at_one_moment_keep_their_order(params):
    bus, _ = busy(params)
    bus.receive(0, LATER_US)
    for k in range(50):
        bus.publish("burst", 1 + k % 3, LATER_US, k)
    heard = [e.payload for e in bus.receive(0, 2 * LATER_US)]
    assert len(heard) > 10
    assert heard == sorted(heard)


@every_bus
def test_nothing_arrives_before_it_is_sent(params):
    bus, _ = busy(params)
    for t_us in range(0, 800_000, 7_000):
        assert all(e.sent_us <= t_us for e in bus.receive(1, t_us))


@every_bus
def test_the_recorder_hears_everything_once_when_it_is_sent(params):
    _, sent = busy(params)
    assert [e.payload for e in sent] == list(range(300))
    assert [e.sent_us for e in sent] == [2_000 * k for k in range(300)]


@every_bus
def test_sequences_rise_by_one_per_sender_and_topic(params):
    _, sent = busy(params)
    counts = Counter()
    for e in sent:
        assert e.sequence == counts[e.sender, e.topic]
        counts[e.sender, e.topic] += 1
    assert len(counts) == 8


@every_bus
def test_same_seed_same_messages(params):
    a, b = (busy(params)[0] for _ in range(2))
    for i in range(4):
        heard = [[e.payload for e in bus.receive(i, LATER_US)] for bus in (a, b)]
        assert heard[0] == heard[1]


@every_bus
def test_a_payload_arrives_unharmed(params):
    bus, _ = busy(params)
    for k in range(40):
        bus.publish("array", 0, k, np.arange(5.0))
    arrays = [e.payload for e in bus.receive(1, LATER_US) if e.topic == "array"]
    assert arrays
    np.testing.assert_array_equal(arrays, np.tile(np.arange(5.0), (len(arrays), 1)))
