# SPDX-License-Identifier: Apache-2.0
"""Time by stage, on clocks that the test turns."""

import pytest

import skyhaul.mission.stopwatch as module
from skyhaul.mission.stopwatch import Stopwatch


class Clock:
    """Wall and CPU time, moved by hand."""

    def __init__(self):
        self.wall = self.cpu = 100.0

    def perf_counter(self):
        return self.wall

    def process_time(self):
        return self.cpu

    def work(self, seconds, share=1.0):
        self.wall += seconds
        self.cpu += share * seconds


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


def test_a_stage_inside_another_counts_only_once(clock):
    watch = Stopwatch()
    with watch.stage("outer"):
        clock.work(1.0)
        with watch.stage("inner"):
            clock.work(2.0)
            with watch.stage("innermost"):
                clock.work(4.0)
            clock.work(8.0)
        clock.work(16.0)
    assert watch.cpu_s() == {"outer": 17.0, "inner": 10.0, "innermost": 4.0}


def test_stages_add_up_over_their_calls_and_to_the_time_within_stages(clock):
    watch = Stopwatch()
    for _ in range(3):
        clock.work(0.5)  # outside of any stage
        with watch.stage("a"):
            clock.work(1.0)
            with watch.stage("a"):
                clock.work(1.0)
        with watch.stage("b"):
            clock.work(0.25)
    assert watch.cpu_s() == pytest.approx({"a": 6.0, "b": 0.75})


def test_waiting_for_the_machine_is_not_charged(clock):
    watch = Stopwatch()
    with watch.stage("a"):
        clock.work(2.0, share=0.5)
    with watch.stage("b"):
        clock.work(2.0, share=0.5)
    assert watch.cpu_s() == pytest.approx({"a": 1.0, "b": 1.0})


def test_an_exception_closes_its_stage(clock):
    watch = Stopwatch()

    def interrupted():
        clock.work(1.0)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), watch.stage("outer"), watch.stage("inner"):
        interrupted()
    clock.work(5.0)
    with watch.stage("after"):
        clock.work(2.0)
    assert watch.cpu_s() == pytest.approx({"inner": 1.0, "outer": 0.0, "after": 2.0})


def test_a_watch_without_stages_is_empty():
    assert Stopwatch().cpu_s() == {}
