# SPDX-License-Identifier: Apache-2.0
"""A small stack, estimates of a team at rest, a bus, and a recorder that remembers."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest

from skyhaul.comms.in_process import InProcess
from skyhaul.mission.config import RunConfig
from skyhaul.mission.setup import build_stack
from skyhaul.mission.stopwatch import Stopwatch
from skyhaul.model import cable_state, hover_state, team_state
from skyhaul.perception.api import ObstacleEstimate, TeamEstimate
from skyhaul.world.load import load_config

QUICK = ("control.payload.kind=geometric",)


@dataclass
class Notes:
    """A recorder that keeps what it is told."""

    ticks: list = field(default_factory=list)
    triggers: list = field(default_factory=list)
    replans: list = field(default_factory=list)
    references: list = field(default_factory=list)
    solves: list = field(default_factory=list)
    maps: list = field(default_factory=list)
    messages: list = field(default_factory=list)
    outcomes: list = field(default_factory=list)

    def tick(self, tick):
        self.ticks.append(tick)

    def trigger(self, trigger):
        self.triggers.append(trigger)

    def replan(self, replan):
        self.replans.append(replan)

    def reference(self, stamp_us, reference):
        self.references.append((stamp_us, reference))

    def solve(self, solve):
        self.solves.append(solve)

    def map(self, world_map):
        self.maps.append(world_map)

    def message(self, envelope):
        self.messages.append(envelope)

    def close(self, outcome):
        self.outcomes.append(outcome)


@cache
def state_at(team, p_WL):
    return team_state(team, hover_state(team, np.array(p_WL, dtype=np.float64)))


def hovering(team, t_us=0, p_WL=(0.0, 0.0, 1.5), tension=None, attached=None):
    """Estimate of a team that hovers in formation."""
    state, n = state_at(team, tuple(float(x) for x in p_WL)), team.count
    tension = np.full(n, 0.6) if tension is None else np.array(tension, dtype=np.float64)
    return TeamEstimate(
        stamp_us=t_us,
        team=state,
        cables=cable_state(team, state, tension),
        attached=np.ones(n, dtype=bool) if attached is None else np.array(attached),
        thrust=np.full(n, 3.0),
        load_covariance=np.zeros((12, 12)),
    )


@dataclass
class Ensemble:
    """Stack, bus, recorder and watch that belong together."""

    stack: object
    bus: object
    notes: Notes
    watch: Stopwatch

    def estimate(self, t_us=0, **changes):
        return hovering(self.stack.team, t_us, **changes)

    def nothing_seen(self, t_us=0):
        return ObstacleEstimate(t_us, (), ())


def ensemble_of(stack, **comms):
    notes = Notes()
    bus = InProcess(**comms).build(stack.team.count, 0, notes.message)
    return Ensemble(stack, bus, notes, Stopwatch())


@pytest.fixture(scope="session")
def stack():
    """Four vehicles that hover in the air, flown by the geometric controller."""
    return build_stack(load_config(RunConfig, "hover", QUICK))


@pytest.fixture(scope="session")
def ground_stack():
    """Four vehicles on the floor, bound for a goal in an empty room."""
    entries = (
        *QUICK,
        "start={kind: ground, payload_m: [0, 0]}",
        "task={kind: goto, goal_m: [2.5, 2, 2.5]}",
    )
    return build_stack(load_config(RunConfig, "hover", entries))


@pytest.fixture
def ensemble(stack):
    return ensemble_of(stack)


@pytest.fixture
def make_ensemble():
    return ensemble_of


@pytest.fixture
def make_estimate():
    return hovering


@pytest.fixture
def with_mission():
    """A stack with other mission parameters: `with_mission(stack, name=value)`."""

    def change(stack, **entries):
        return replace(stack, mission=replace(stack.mission, **entries))

    return change
