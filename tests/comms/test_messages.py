# SPDX-License-Identifier: Apache-2.0
"""Sizes of messages, counted out by hand."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from skyhaul.comms.messages import Fault, Order, PlanMessage, Status, encoded_bytes
from skyhaul.control.api import ForcePlan
from skyhaul.planning.heading import fan_out
from skyhaul.planning.reference import TiltBlend, resting_reference


def force_plan(k, n):
    return ForcePlan(
        stamp_us=0,
        node_s=np.linspace(0.0, 2.0, k),
        load=np.zeros((k, 13)),
        accel_W=np.zeros((k, 3)),
        force_W=np.zeros((k, n, 3)),
        dforce_W=np.zeros((k, n, 3)),
        gain=np.zeros((k, n, 3, 12)),
        thrust=np.zeros((k, n)),
        active=np.ones(n, dtype=bool),
    )


@pytest.mark.parametrize(
    ("message", "size"),
    [
        (True, 1),
        (7, 8),
        (0.5, 8),
        ("lift", 9),
        (np.zeros((3, 4)), 100),
        (np.ones(5, dtype=bool), 9),
        ((1, "a", True), 19),
        ([], 4),
        (np.bool_(True), 1),
        (np.int64(7), 8),
        (np.float64(0.5), 8),
    ],
)
def test_numbers_texts_and_arrays_have_their_sizes(message, size):
    assert encoded_bytes(message) == size


def test_a_text_is_counted_in_bytes_not_in_letters():
    assert encoded_bytes("µm") == 3 + 5


def test_a_heartbeat_is_numbers_two_vectors_flags_and_what_its_vehicle_has_heard():
    place, flags = np.zeros(3), np.zeros(4, dtype=bool)
    status = Status(0, 1, place, place, 0.6, True, True, False, 2.5, 0.5, flags, flags, 0, -1)
    assert encoded_bytes(status) == 2 * 8 + 2 * 28 + 3 * 8 + 3 + 2 * (4 + 4) + 2 * 8


def test_faults_and_orders_are_the_sum_of_their_parts():
    assert encoded_bytes(Fault(0, 1, "weak")) == 8 + 8 + 9
    order = Order(0, "carry", np.ones(4, dtype=bool), False, 0)
    assert encoded_bytes(order) == 8 + (5 + 5) + (4 + 4) + 1 + 8


@pytest.mark.parametrize(("k", "n"), [(2, 3), (21, 4), (21, 8)])
def test_a_plan_grows_with_nodes_and_vehicles(k, n):
    doubles = k * (1 + 13 + 3 + 3 * n + 3 * n + 36 * n + n)
    assert encoded_bytes(force_plan(k, n)) == 8 + 8 * doubles + 7 * 4 + (n + 4)


def test_a_plan_message_counts_forces_reference_and_headings():
    reference = resting_reference(np.zeros(3), 0.0, 0)
    heading = fan_out(reference, np.arange(4) * np.pi / 2, 0)
    plan = force_plan(21, 4)
    message = PlanMessage(0, plan, reference, heading)
    parts = 8 + sum(encoded_bytes(part) for part in (plan, reference, heading))
    assert encoded_bytes(message) == parts
    tilted = replace(reference, tilts=(TiltBlend(0, 10, np.zeros(3)),) * 3)
    assert encoded_bytes(tilted) > encoded_bytes(reference)


def test_no_field_of_a_message_weighs_nothing():
    def leaves(m):
        if is_dataclass(m):
            return [leaf for f in fields(m) for leaf in leaves(getattr(m, f.name))]
        return [m]

    reference = resting_reference(np.zeros(3), 0.0, 0)
    message = PlanMessage(
        0, force_plan(2, 3), reference, fan_out(reference, np.arange(3) * 2 * np.pi / 3, 0)
    )
    assert all(encoded_bytes(leaf) > 0 for leaf in leaves(message))
