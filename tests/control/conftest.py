# SPDX-License-Identifier: Apache-2.0
"""Closed loop of the tests: the taut model with rotor lag, flown by plan and vehicle controller."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pytest

from skyhaul.control.api import ControlRequest
from skyhaul.control.geometric import Geometric
from skyhaul.control.vehicle import CableTracking
from skyhaul.model import (
    RigidPayload,
    TautState,
    Team,
    cable_state,
    flat_outputs,
    rotors_to_wrench,
    team_state,
    tensions,
    wrench_to_rotors,
)
from skyhaul.model.dynamics import pack, unpack
from skyhaul.model.step import integrate
from skyhaul.perception.api import TeamEstimate
from skyhaul.planning.api import RefSample
from skyhaul.world.scenario import Limits

TICK_S = 2e-3


@dataclass(frozen=True)
class Circle:
    """Level circle at constant speed; a `Reference`."""

    radius_m: float = 1.0
    period_s: float = 10.0
    height_m: float = 2.0
    start_us: int = 0
    end_us: int = 10**9

    def sample(self, t_us):
        t, w = 1e-6 * np.atleast_1d(t_us), 2.0 * np.pi / self.period_s
        p, R = np.zeros((len(t), 7, 3)), np.zeros((len(t), 7, 3, 3))
        R[:, 0] = np.eye(3)
        for k in range(7):
            p[:, k, 0] = self.radius_m * w**k * np.cos(w * t + 0.5 * np.pi * k)
            p[:, k, 1] = self.radius_m * w**k * np.sin(w * t + 0.5 * np.pi * k)
        p[:, 0, 2] = self.height_m
        return RefSample(p, R)


@dataclass(frozen=True)
class Hold:
    """Rest at a place; a `Reference`."""

    p_WD: tuple = (0.0, 0.0, 2.0)
    start_us: int = 0
    end_us: int = 0

    def sample(self, t_us):
        t = np.atleast_1d(t_us)
        p, R = np.zeros((len(t), 7, 3)), np.zeros((len(t), 7, 3, 3))
        p[:, 0], R[:, 0] = self.p_WD, np.eye(3)
        return RefSample(p, R)


class Flight(NamedTuple):
    """Log of a flight, one row per tick."""

    t: np.ndarray
    load: np.ndarray  # (k, 13)
    reference: np.ndarray  # (k, 3)
    cable_dir_W: np.ndarray  # (k, n, 3)
    force_W: np.ndarray  # (k, n, 3) wanted
    tension: np.ndarray  # (k, n)
    thrust: np.ndarray  # (k, n) given
    thrust_wanted: np.ndarray  # (k, n)
    slack_W: np.ndarray  # (k, 6) wrench given up
    state: TautState

    @property
    def error_m(self):
        return np.linalg.norm(self.load[:, :3] - self.reference, axis=1)

    def rmse_m(self, after_s=0.0):
        return float(np.sqrt(np.mean(self.error_m[self.t >= after_s] ** 2)))


@dataclass(frozen=True)
class ClosedLoop:
    """Taut model, rotor lag, `CableTracking` under any `PayloadController`."""

    team: Team
    tracking: CableTracking = field(default_factory=CableTracking)
    controller: object = field(default_factory=Geometric)
    replan_s: float = 1.0
    push_W: tuple = (0.0, 0.0, 0.0)  # steady force on the load, through its weight

    def start_on(self, reference):
        """The flat state of the reference at its start, and the thrusts that go with it."""
        sample, n = reference.sample(np.zeros(1)), self.team.count
        flat = flat_outputs(self.team, sample.p_WD[0], sample.R_WD[0], np.zeros((n, 3)))
        state = TautState(
            p_WL=sample.p_WD[0, 0].copy(),
            q_WL=np.array([1.0, 0.0, 0.0, 0.0]),
            v_WL=sample.p_WD[0, 1].copy(),
            w_WL_L=flat.w_WL_L,
            cable_dir_W=flat.cable_dir_W[0],
            cable_w_W=flat.cable_w_W,
            q_WB=flat.q_WB,
            w_WB_B=flat.w_WB_B,
        )
        return state, wrench_to_rotors(self.team, flat.wrench)

    def fly(self, reference, seconds, state=None, rotors=None):
        team, n = self.team, self.team.count
        if state is None:
            state, rotors = self.start_on(reference)
        controller = self.controller.build(team, Limits())
        tracker = self.tracking.build(team)
        memory, plan_memory, plan = tracker.init(n), controller.init(), None
        arrays, log = team.arrays(), []
        lag = arrays.motor_lag
        share = 1.0 - np.exp(-TICK_S / lag) if lag > 0.0 else 1.0
        replan = round(self.replan_s / TICK_S)
        for k in range(round(seconds / TICK_S)):
            t_us = round(1e6 * k * TICK_S)
            estimate = perfect_estimate(team, state, rotors, t_us)
            if k % replan == 0:
                request = ControlRequest(
                    stamp_us=t_us,
                    load=estimate.team.load,
                    force_W=np.zeros((n, 3)) if plan is None else command.force_W,  # noqa: F821
                    dforce_W=np.zeros((n, 3)) if plan is None else command.dforce_W,  # noqa: F821
                    active=np.ones(n, dtype=bool),
                    reference=reference,
                    world_map=None,
                )
                plan_memory, solution = controller.solve(plan_memory, request)
                plan = solution.plan
            memory, command = tracker.step(memory, estimate, plan, np.zeros(n))
            log.append(
                (
                    1e-6 * t_us,
                    estimate.team.load,
                    reference.sample(np.array([t_us])).p_WD[0, 0],
                    state.cable_dir_W,
                    command.force_W,
                    estimate.cables.tension,
                    estimate.thrust,
                    command.thrust,
                    command.wrench_slack_W,
                )
            )
            before = rotors
            rotors = rotors + share * (command.rotor_cmd - rotors)
            x = pack(state)
            mean = command.rotor_cmd + (before - command.rotor_cmd) * (
                lag * share / TICK_S if lag > 0.0 else 0.0
            )
            assert integrate(arrays, x, rotors_to_wrench(team, mean), TICK_S, 1e-9)
            if any(self.push_W):
                x[7:10] += TICK_S * np.array(self.push_W) / total_mass(team)
            state = unpack(x)
        return Flight(*(np.array(column) for column in zip(*log, strict=True)), state)


def total_mass(team):
    return team.payload.mass_kg + float(np.sum(team.arrays().m_B))


def perfect_estimate(team, state, rotors, t_us):
    """What a perfect estimator knows of a taut state."""
    bodies = team_state(team, state)
    tension = tensions(team, state, rotors_to_wrench(team, rotors))
    return TeamEstimate(
        stamp_us=t_us,
        team=bodies,
        cables=cable_state(team, bodies, tension),
        attached=np.ones(team.count, dtype=bool),
        thrust=rotors.sum(axis=1),
        load_covariance=np.zeros((12, 12)),
    )


def without_drag(team):
    """The team without drag, as the taut model has none."""
    return replace(
        team,
        vehicle=replace(team.vehicle, drag_ns_per_m=0.0),
        payload=replace(team.payload, drag_ns_per_m=0.0),
    )


@pytest.fixture
def team():
    return without_drag(Team())


@pytest.fixture
def triangle():
    """Three vehicles with the 0.278 kg load of the circles."""
    return without_drag(Team(count=3, payload=RigidPayload(mass_kg=0.278)))


@pytest.fixture
def closed_loop():
    return ClosedLoop


@pytest.fixture
def references():
    return Circle, Hold


@pytest.fixture(name="still_air")
def still_air_fixture():
    return without_drag


@pytest.fixture(name="perfect_estimate")
def perfect_estimate_fixture():
    return perfect_estimate
