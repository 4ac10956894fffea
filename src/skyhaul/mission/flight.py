# SPDX-License-Identifier: Apache-2.0
"""One flight from start to end: plant, sensors, perception, crew, recorder."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from skyhaul.errors import DivergenceError, SkyhaulError
from skyhaul.mission.api import Outcome, Phase, Recorder
from skyhaul.mission.check import check_flight
from skyhaul.mission.config import RunConfig
from skyhaul.mission.crew import Crew
from skyhaul.mission.hindrance import at_goal
from skyhaul.mission.judge import FLYING_ON, Judge, Verdict
from skyhaul.mission.looking import obstacle_look
from skyhaul.mission.loop import cycle
from skyhaul.mission.sensing import team_sensing
from skyhaul.mission.setup import build_stack
from skyhaul.mission.stopwatch import Stopwatch
from skyhaul.mission.ticks import TickMaker
from skyhaul.mission.vehicle import Actuation, command_of
from skyhaul.model.envelope import team_shape
from skyhaul.perception.api import ObstacleEstimate, TeamEstimate
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.types import US_PER_S, Array, TimeUs
from skyhaul.world.scenario import GoTo

_PROGRESS_PERIOD_US = 100_000
_JUDGE_PERIOD_US = 10_000
INTERRUPTED = "interrupted"
"""Reason of a flight that Ctrl-C ended."""


@dataclass(frozen=True, eq=False)
class FlightProgress:
    """How far a flight is."""

    t_us: TimeUs
    limit_us: TimeUs
    phase: Phase
    speed_mps: float  # of the load
    goal_distance_m: float  # nan without a goal


ShowProgress = Callable[[FlightProgress], None]


def fly(
    config: RunConfig, seed: int, recorder: Recorder, progress: ShowProgress | None = None
) -> Outcome:
    """Fly a scenario to its end.

    Args:
        config: Scenario and stack.
        seed: Sets obstacle phases, wind and noise.
        recorder: Is told everything, and closed when the flight is over, interrupted or not.
        progress: Called ten times per simulated second.

    Returns:
        How it ended. An interrupt ends the flight without success; it is not passed on. Neither
        is a plant that diverges.

    Raises:
        ConfigError: When the stack cannot fly the scenario; see `check_flight`.
        SkyhaulError: When the flight is impossible, or the disk takes no more; the recorder has
            been told before.
    """
    flight, verdict = None, _failed("broken off by a fault of the program")
    try:
        check_flight(config)
        flight = Flight(config, seed, recorder)
        verdict = flight.run(progress)
    except KeyboardInterrupt:
        verdict = _failed(INTERRUPTED)
    except SkyhaulError as fault:
        verdict = _failed(f"broken off: {fault}")
        raise
    finally:
        unflown = Outcome(success=False, reason=verdict.reason, end_us=0, cpu_s={}, wall_s=0.0)
        outcome = flight.outcome(verdict) if flight else unflown
        recorder.close(outcome)
    return outcome


def _failed(reason: str) -> Verdict:
    return Verdict(over=True, success=False, reason=reason)


class Flight:
    """Everything that lives during one flight."""

    def __init__(self, config: RunConfig, seed: int, recorder: Recorder) -> None:
        self._config, self._recorder = config, recorder
        self._began_s = time.perf_counter()
        self._watch = Stopwatch()
        self._plant = MujocoPlant(config, seed)
        self._truth = self._plant.truth()
        bus = config.comms.build(config.team.count, seed, recorder.message)
        self._crew = Crew(build_stack(config), bus, recorder, self._watch)
        self._ticks = TickMaker(config.team)
        self._judge, self._judged = Judge(config), Judge(config).init()
        self._team = team_sensing(config, seed, self._truth, self._watch)
        self._obstacles = obstacle_look(config, self._watch)

    def run(self, progress: ShowProgress | None) -> Verdict:
        """Cycle until the judge ends the flight, or the plant diverges."""
        try:
            return self._run(progress)
        except DivergenceError as fault:
            return _failed(str(fault))

    def _run(self, progress: ShowProgress | None) -> Verdict:
        verdict = FLYING_ON
        while not verdict.over:
            t_us = self._truth.stamp_us
            with self._watch.stage("perception"):
                estimate, obstacles = self._perceive()
            with self._watch.stage("agents"):
                actuations = cycle(self._crew, t_us, estimate, obstacles)
                command = command_of(actuations)
            with self._watch.stage("logging"):
                self._recorder.tick(
                    self._ticks.make(self._truth, estimate, self._crew.leader, command)
                )
            with self._watch.stage("plant"):
                self._actuate(actuations, command.rotor_cmd)
            if progress is not None and t_us % _PROGRESS_PERIOD_US == 0:
                progress(self._progress(t_us, estimate))
            if t_us % _JUDGE_PERIOD_US == 0:
                self._judged, verdict = self._judge.step(
                    self._judged, t_us, self._crew.leader.phase, estimate
                )
        return self._with_cause(verdict)

    def _with_cause(self, verdict: Verdict) -> Verdict:
        """The verdict at the time limit, with what kept the mission from its end."""
        leader, config = self._crew.leader, self._config
        why = leader.hindrance(self._truth.stamp_us)
        if not verdict.timed_out or why is None:
            return verdict
        name = None
        if isinstance(config.task, GoTo):
            shape = team_shape(config.team, config.planning.margin_m)
            names = tuple(o.name for o in config.world.obstacles)
            name = at_goal(self._truth, shape, np.array(config.task.goal_m), names)
        return replace(verdict, reason=f"{verdict.reason}: {why.sentence(name)}")

    def outcome(self, verdict: Verdict) -> Outcome:
        """How it ended, with the time it took."""
        return Outcome(
            success=verdict.success,
            reason=verdict.reason,
            end_us=self._truth.stamp_us,
            cpu_s=self._watch.cpu_s(),
            wall_s=time.perf_counter() - self._began_s,
        )

    def _perceive(self) -> tuple[TeamEstimate, ObstacleEstimate | None]:
        """p(t) and, when it is due, o(t)."""
        estimate = self._team.estimate(self._truth)
        return estimate, self._obstacles.look(self._truth, estimate, self._team.readings)

    def _actuate(self, actuations: list[Actuation], rotor_cmd: Array) -> None:
        for i, act in enumerate(actuations):
            if act.release:
                self._plant.release_hook(i)
            if act.attach:
                self._plant.attach_hook(i)
        self._truth = self._plant.step(rotor_cmd)

    def _progress(self, t_us: TimeUs, estimate: TeamEstimate) -> FlightProgress:
        task, p_WL = self._config.task, estimate.team.p_WL
        goal = np.array(task.goal_m) if isinstance(task, GoTo) else np.full(3, np.nan)
        return FlightProgress(
            t_us=t_us,
            limit_us=round(self._config.time_limit_s * US_PER_S),
            phase=self._crew.leader.phase,
            speed_mps=float(np.linalg.norm(estimate.team.v_WL)),
            goal_distance_m=float(np.linalg.norm(p_WL - goal)),
        )
