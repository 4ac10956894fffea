# SPDX-License-Identifier: Apache-2.0
"""A made-up flight whose every metric is known in closed form."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from skyhaul.comms.api import Envelope
from skyhaul.control.api import ForcePlan, Solution, SolveStatus, VehicleCommand
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.geometry.shapes import Box, Capsule, ShapeArrays, Sphere, pose_shapes
from skyhaul.mission.api import Outcome, Phase, Replan, Solve, Tick, Trigger
from skyhaul.model.state import CableState, TeamState
from skyhaul.model.team import Team
from skyhaul.perception.api import TeamEstimate
from skyhaul.planning.api import Plan, PlanStatus, ReferencePlan, ReferenceStatus, RefSample
from skyhaul.plant.api import Contact, Truth
from skyhaul.world.obstacles import Line, Obstacle
from skyhaul.world.scenario import GoTo, Scenario, World

STEP_US = 2_000
OFFSET_M = 0.03
SHIFT = np.array([OFFSET_M, 0.0, 0.0])
SWING_RAD = 0.05
TENSION_N, THRUST_N = 0.6, 3.2
RADIUS_M, RATE = 1.5, 0.5
CARRY_US, HOVER_US = 1_000_000, 5_000_000


@dataclass(frozen=True)
class Faults:
    """What goes wrong in the made-up flight."""

    contacts: tuple[Contact, ...] = ()
    slack_at_us: int | None = None
    touch_at_us: int | None = None
    dead_from_us: int | None = None
    let_go_from_us: int | None = None
    success: bool = True
    kill_at_us: int | None = None


@dataclass(frozen=True)
class ArcReference:
    """A reference along the circle."""

    start_us: int
    end_us: int

    def sample(self, t_us: np.ndarray) -> RefSample:
        p = np.zeros((len(t_us), 7, 3))
        p[:, 0] = [arc(min(t, self.end_us)) for t in t_us]
        return RefSample(p, np.tile(np.eye(3), (len(t_us), 7, 1, 1)))


def arc(t_us: float) -> np.ndarray:
    """Reference position: rest, a quarter of an hour glass of circle, rest."""
    a = RATE * (min(max(t_us, CARRY_US), HOVER_US) - CARRY_US) * 1e-6
    return np.array([RADIUS_M * np.cos(a), RADIUS_M * np.sin(a), 1.0 + 0.3 * a])


def scenario(n: int = 4) -> Scenario:
    goal = arc(HOVER_US) + SHIFT
    obstacles = (
        Obstacle(name="wall", shape=Box(size_m=(0.4, 0.4, 2.0), yaw_deg=30.0), center_m=(3, 3, 1)),
        Obstacle(name="ball", shape=Sphere(radius_m=0.2), center_m=(0, 0, 2),
                 motion=Line(velocity_mps=(0.3, 0.0, 0.1), length_m=4.0)),
        Obstacle(name="post", shape=Capsule(radius_m=0.1, length_m=1.0), center_m=(-3, 1, 1)),
    )  # fmt: skip
    return Scenario(
        name="made-up",
        team=Team(count=n),
        world=World(obstacles=obstacles),
        task=GoTo(goal_m=tuple(goal.tolist()), hold_s=1.0),
    )


def phase_at(t_us: int) -> Phase:
    if t_us < 500_000:
        return Phase.TAUTEN
    if t_us < CARRY_US:
        return Phase.LIFT
    return Phase.CARRY if t_us < HOVER_US else Phase.HOVER


@cache
def formation(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vehicles from the load, (n, 3), true and flat cable directions, (n, 3)."""
    team = scenario(n).team
    out = team.formation_dirs_L()
    side = np.column_stack([-out[:, 1], out[:, 0], np.zeros(n)])
    side /= np.linalg.norm(side, axis=1)[:, None]
    flat = -(np.cos(SWING_RAD) * out + np.sin(SWING_RAD) * side)
    return team.hooks_L() + team.cable_length_m * out, -out, flat


@cache
def obstacles_at_start(n: int) -> ShapeArrays:
    obstacles = scenario(n).world.obstacles
    return pose_shapes([o.shape for o in obstacles], np.array([o.center_m for o in obstacles]))


def tick_at(s: Scenario, t_us: int, faults: Faults) -> Tick:
    n, team = s.team.count, s.team
    airborne = t_us >= CARRY_US
    p_WL = arc(t_us) + SHIFT
    p_WL[2] = p_WL[2] if airborne else 0.5 * team.payload.size_m[2]
    moving = CARRY_US <= t_us < HOVER_US
    v_WL = (arc(t_us + 1) - arc(t_us)) * 1e6 if moving else np.zeros(3)
    p_LB, cable_dir, flat = formation(n)
    p_WB = p_WL + p_LB
    q = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    tension = np.full(n, TENSION_N)
    tension[-1] = 0.0 if t_us == faults.slack_at_us else TENSION_N
    dead = faults.dead_from_us is not None and t_us >= faults.dead_from_us
    alive = np.ones(n, dtype=bool)
    alive[0] = not dead
    attached = alive.copy()
    attached[0] &= faults.let_go_from_us is None or t_us < faults.let_go_from_us
    tension[0] = 0.0 if dead else TENSION_N
    state = TeamState(p_WL, q[0].copy(), v_WL, np.zeros(3), p_WB, q, np.tile(v_WL, (n, 1)),
                      np.zeros((n, 3)))  # fmt: skip
    cables = CableState(cable_dir, np.zeros((n, 3)), tension, np.full(n, team.cable_length_m))
    solids = obstacles_at_start(n)
    velocity = np.zeros((3, 3))
    velocity[1] = (0.3, 0.0, 0.1)
    truth = Truth(
        t_us, state, cables, attached, alive, np.full((n, 4), THRUST_N / 4),
        np.zeros((1 + n, 3)),
        solids._replace(p_WO=solids.p_WO + velocity * t_us * 1e-6),
        velocity, np.ones(3, dtype=bool), np.zeros(3),
        -0.01 if t_us == faults.touch_at_us else 0.5 + 0.1 * np.sin(t_us * 1e-6),
        tuple(c for c in faults.contacts if c.stamp_us == t_us),
    )  # fmt: skip
    nan13, nan3 = np.full(13, np.nan), np.full((n, 3), np.nan)
    ref = np.r_[arc(t_us), 1.0, np.zeros(3), v_WL, np.zeros(3)]
    estimate = TeamEstimate(t_us, state, cables, alive.copy(), np.full(n, THRUST_N), np.eye(12))
    command = VehicleCommand(np.full(n, THRUST_N), np.zeros((n, 3)), np.zeros((n, 3)),
                             np.zeros((n, 3)))  # fmt: skip
    return Tick(
        truth, estimate, phase_at(t_us), ref if airborne else nan13, command,
        np.full((n, 4), THRUST_N / 4), np.zeros((n, 3)) if airborne else nan3,
        np.full(n, THRUST_N) if airborne else np.full(n, np.nan), flat if airborne else nan3,
    )  # fmt: skip


def solve_at(t_us: int, n: int, wall_ms: float) -> Solve:
    k = 5
    plan = ForcePlan(
        t_us, np.linspace(0.0, 2.0, k), np.zeros((k, 13)), np.zeros((k, 3)), np.zeros((k, n, 3)),
        np.zeros((k, n, 3)), np.arange(k * n * 36.0).reshape(k, n, 3, 12), np.full((k, n), 3.0),
        np.ones(n, dtype=bool),
    )  # fmt: skip
    return Solve(t_us, "plan_age", Solution(SolveStatus.OK, plan, 1e-6, 9, 0.0, wall_ms))


def fly(
    recorder: RunRecorder, s: Scenario, until_us: int = 7_000_000, faults: Faults | None = None
) -> None:
    """Feed a whole flight to a recorder."""
    wrong = faults or Faults()
    n = s.team.count
    for t_us in range(0, until_us + 1, STEP_US):
        tick = tick_at(s, t_us, wrong)
        recorder.tick(tick)
        if t_us == CARRY_US:
            recorder.trigger(Trigger(t_us, "start", "the flight begins"))
            path = Plan(PlanStatus.FOUND, np.array([arc(CARRY_US), arc(HOVER_US)]))
            reference = ArcReference(t_us, HOVER_US)
            result = ReferencePlan(ReferenceStatus.OK, path, reference, 0, True)
            recorder.replan(Replan(t_us, "start", result, True, 12.0))
            recorder.reference(t_us, reference)
        if t_us >= CARRY_US and t_us % 500_000 == 0:
            recorder.trigger(Trigger(t_us, "plan_age", "the plan is 0.5 s old"))
            recorder.solve(solve_at(t_us, n, 2.0))
            recorder.message(Envelope("plan", 0, t_us, t_us, 1000, None))
    recorder.close(Outcome(wrong.success, "the load is at the goal" if wrong.success else "gave up",
                           until_us, {"plant": 4.0, "control": 2.0}, 3.5))  # fmt: skip


@pytest.fixture(scope="session")
def fly_into() -> Callable[..., Path]:
    """Fly into a folder: `fly_into(folder, n=4, seed=0, **faults)`."""

    def run(folder: Path, n: int = 4, seed: int = 0, **faults: object) -> Path:
        s = scenario(n)
        fly(RunRecorder(folder, s, seed), s, faults=replace(Faults(), **faults))
        return folder

    return run


@pytest.fixture(scope="session")
def made_up() -> ModuleType:
    """The parts of the flight: `scenario()`, `tick_at(...)`, `Faults`."""
    return sys.modules[__name__]


@pytest.fixture(scope="session")
def run_folder(fly_into: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight without faults; read only."""
    return fly_into(tmp_path_factory.mktemp("runs") / "good")
