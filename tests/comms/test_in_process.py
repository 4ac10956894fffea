# SPDX-License-Identifier: Apache-2.0
"""The bus in one process: what its parameters promise."""

import numpy as np
import pytest

from skyhaul.comms.in_process import InProcess


def bus_of(n=3, seed=0, **params):
    sent = []
    return InProcess(**params).build(n, seed, sent.append), sent


def payloads(envelopes):
    return [e.payload for e in envelopes]


def test_a_message_arrives_after_the_delay_and_not_before():
    bus, _ = bus_of(delay_ms=30.0)
    bus.publish("a", 0, 1_000, "late")
    assert bus.receive(1, 30_999) == []
    assert payloads(bus.receive(1, 31_000)) == ["late"]
    (envelope,) = bus.receive(2, 10**9)
    assert envelope.sent_us == 1_000


def test_messages_come_in_the_order_of_sending_and_those_on_their_way_stay():
    bus, _ = bus_of(delay_ms=10.0)
    for k in range(6):
        bus.publish("ab"[k % 2], k % 2, 4_000 * k, k)
    assert payloads(bus.receive(2, 18_000)) == [0, 1, 2]
    assert payloads(bus.receive(2, 100_000)) == [3, 4, 5]


def test_every_loss_is_drawn_from_the_seed():
    def heard(seed):
        bus, _ = bus_of(seed=seed, loss=0.5)
        for k in range(200):
            bus.publish("a", 0, k, k)
        return payloads(bus.receive(1, 200))

    assert heard(1) == heard(1)
    assert heard(1) != heard(2)


def test_the_share_lost_is_the_share_asked_for_at_each_receiver_apart():
    bus, sent = bus_of(loss=0.3)
    for k in range(4000):
        bus.publish("a", 0, k, k)
    one, two = (set(payloads(bus.receive(i, 4000))) for i in (1, 2))
    assert len(sent) == 4000  # the recorder hears what is sent, not what arrives
    assert len(one) / 4000 == pytest.approx(0.7, abs=0.03)
    assert len(one & two) / 4000 == pytest.approx(0.49, abs=0.03)  # independent


def test_without_loss_no_random_number_is_drawn():
    plain, lossy = bus_of(seed=4)[0], bus_of(seed=4, loss=1e-9)[0]
    for bus in (plain, lossy):
        for k in range(50):
            bus.publish("a", 0, k, k)
    assert payloads(plain.receive(1, 50)) == payloads(lossy.receive(1, 50)) == list(range(50))


def test_the_size_is_that_of_the_encoded_payload():
    bus, sent = bus_of()
    bus.publish("a", 0, 0, np.zeros(10))
    assert sent[0].size_bytes == 84


@pytest.mark.parametrize(("name", "value"), [("delay_ms", -1.0), ("loss", 1.0), ("loss", -0.1)])
def test_impossible_parameters_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} must .*, got {value}"):
        InProcess(**{name: value})
