# SPDX-License-Identifier: Apache-2.0
"""Messages that must arrive arrive, and nothing is said twice without need."""

from collections import Counter

import pytest

from skyhaul.comms.in_process import InProcess
from skyhaul.comms.repeat import PAUSE_US, RepeatingBus

N, STEP_US, BEAT_US = 4, 2_000, 20_000


def converse(bus, repeating, until_us, beats_lost=False):
    """Receivers 1 .. N-1 confirm with each heartbeat; returns when each had the newest message."""
    have, got_us = dict.fromkeys(range(1, N), -1), {}
    for t_us in range(0, until_us, STEP_US):
        for i in have:
            for stamp_us in orders(bus.receive(i, t_us), "payload"):
                have[i] = max(have[i], stamp_us)
                got_us.setdefault((i, stamp_us), t_us)
            if t_us % BEAT_US == 0:
                bus.publish("beat", i, t_us, (i, have[i]))
        if not beats_lost:
            for envelope in bus.receive(0, t_us):
                repeating.confirm(envelope.payload[0], {"order": envelope.payload[1]})
        if t_us % BEAT_US == 0:
            repeating.repeat(t_us, 0, range(N))
    return got_us


def buses(**comms):
    sent = []
    bus = InProcess(**comms).build(N, 0, sent.append)
    return bus, RepeatingBus(bus), sent


def orders(envelopes, what="sent_us"):
    return [getattr(e, what) for e in envelopes if e.topic == "order"]


@pytest.mark.parametrize("seed", range(20))
def test_every_receiver_has_the_message_within_half_a_second_at_a_loss_of_a_fifth(seed):
    bus = InProcess(loss=0.2, delay_ms=20.0).build(N, seed, lambda _: None)
    repeating = RepeatingBus(bus)
    repeating.publish("order", 0, 0, 0)
    got_us = converse(bus, repeating, 500_000)
    assert {i for i, _ in got_us} == {1, 2, 3}


@pytest.mark.parametrize("delay_ms", [0.0, 20.0])
def test_without_loss_nothing_is_sent_twice(delay_ms):
    bus, repeating, sent = buses(delay_ms=delay_ms)
    repeating.publish("order", 0, 0, 0)
    converse(bus, repeating, 400_000)
    assert orders(sent) == [0]


def test_an_unconfirmed_message_is_sent_again_after_the_pause_and_no_sooner():
    bus, repeating, sent = buses()
    repeating.publish("order", 0, 0, 0)
    converse(bus, repeating, 200_000, beats_lost=True)
    assert orders(sent) == [k * PAUSE_US for k in range(4)]


def test_only_the_newest_message_of_a_topic_is_repeated():
    _, repeating, sent = buses()
    repeating.publish("order", 0, 0, 0)
    repeating.publish("order", 0, 10_000, 10_000)
    repeating.publish("plan", 0, 10_000, 10_000)
    repeating.repeat(100_000, 0, range(N))
    again = [e.payload for e in sent if e.sent_us == 100_000]
    assert again == [10_000, 10_000]
    assert Counter(e.topic for e in sent) == {"order": 3, "plan": 2}


def test_those_who_are_left_out_and_the_sender_need_not_confirm():
    _, repeating, sent = buses()
    repeating.publish("order", 0, 0, 0)
    repeating.confirm(1, {"order": 0})
    repeating.repeat(100_000, 0, [0, 1])
    assert orders(sent) == [0]
    repeating.repeat(100_000, 0, [0, 1, 2])
    assert orders(sent) == [0, 100_000]


def test_a_stamp_older_than_the_message_confirms_nothing():
    _, repeating, sent = buses()
    repeating.publish("order", 0, 50_000, 50_000)
    repeating.confirm(1, {"order": 40_000, "plan": 50_000})
    repeating.repeat(200_000, 0, [1])
    assert orders(sent) == [50_000, 200_000]
