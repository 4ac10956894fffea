# SPDX-License-Identifier: Apache-2.0
"""Results take effect at once, or after the time they took."""

import pytest

from skyhaul.mission.latency import Pending


@pytest.mark.parametrize("wall_ms", [0.0, 3.0, 900.0])
def test_without_latency_a_result_is_there_at_once_and_once(wall_ms):
    pending = Pending("none")
    assert pending.take(0) is None
    pending.put(10_000, wall_ms, "plan")
    assert pending.busy
    assert pending.take(10_000) == "plan"
    assert pending.take(10_000) is None
    assert not pending.busy


def test_with_measured_latency_it_waits_for_its_wall_time():
    pending = Pending("measured")
    pending.put(10_000, 12.5, "plan")
    assert pending.take(22_499) is None
    assert pending.busy
    assert pending.take(22_500) == "plan"
    assert pending.take(22_500) is None


def test_a_newer_result_takes_the_place_of_one_that_waits():
    pending = Pending("measured")
    pending.put(0, 100.0, "old")
    pending.put(10_000, 20.0, "new")
    assert pending.take(29_999) is None
    assert pending.take(30_000) == "new"
    assert pending.take(200_000) is None


def test_what_is_dropped_never_arrives():
    pending = Pending("measured")
    pending.put(0, 10.0, "plan")
    pending.drop()
    assert not pending.busy
    assert pending.take(10**9) is None
