# SPDX-License-Identifier: Apache-2.0
"""What every recorder must bear. A new one adds one entry to RECORDERS."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.comms.api import Envelope
from skyhaul.control.api import ForcePlan, Solution, SolveStatus, VehicleCommand
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.mapping.api import OccupancyGrid
from skyhaul.mapping.mapper import static_map
from skyhaul.mission.api import Outcome, Phase, Replan, Solve, Tick, Trigger
from skyhaul.mission.replay import TrackRecorder
from skyhaul.model.envelope import TeamShape
from skyhaul.perception.team.truth import TruthTeam
from skyhaul.planning.api import Plan, PlanStatus, ReferencePlan, ReferenceStatus
from skyhaul.planning.reference import resting_reference
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.sensors.perfect import PerfectState
from skyhaul.world.scenario import AirStart, HoverTask, Scenario

SCENARIO = Scenario(start=AirStart(payload_m=(5.0, 5.0, 5.0)), task=HoverTask())
RECORDERS = [
    lambda folder: RunRecorder(folder, SCENARIO, 0),
    lambda folder: TrackRecorder(RunRecorder(folder, SCENARIO, 0)),
]

every_recorder = pytest.mark.parametrize("make", RECORDERS, ids=["run-folder", "track"])
END = Outcome(success=True, reason="task done", end_us=0, cpu_s={"plant": 0.1}, wall_s=0.2)
GRID = OccupancyGrid(np.zeros((4, 4, 4), bool), np.zeros(3), 0.1)
WORLD = static_map(GRID, TeamShape(radius_m=0.3, above_m=0.4, below_m=0.1))


def ticks(count, phase=Phase.CARRY):
    """Ticks of a team that falls freely; everything that may be nan is."""
    plant, n = MujocoPlant(SCENARIO, 0), 4
    for k in range(count):
        truth = plant.truth() if k == 0 else plant.step(np.zeros((n, 4)))
        estimate = TruthTeam().step((), PerfectState().read(truth))[1]
        yield Tick(
            truth=truth,
            estimate=estimate,
            phase=phase,
            reference=np.full(13, np.nan),
            command=VehicleCommand(np.zeros(n), *np.zeros((3, n, 3))),
            rotor_cmd=np.zeros((n, 4)),
            planned_force_W=np.full((n, 3), np.nan),
            planned_thrust=np.full(n, np.nan),
            flat_cable_dir_W=np.full((n, 3), np.nan),
        )


def force_plan(k, n=4):
    return ForcePlan(
        0, np.linspace(0.0, 2.0, k), np.tile(np.eye(13)[3], (k, 1)), np.zeros((k, 3)),
        np.zeros((k, n, 3)), np.zeros((k, n, 3)), np.zeros((k, n, 3, 12)), np.zeros((k, n)),
        np.ones(n, dtype=bool),
    )  # fmt: skip


def tell_everything(recorder):
    """Every kind of news, in every outcome."""
    reference = resting_reference(np.array([5.0, 5.0, 5.0]), 0.0, 0)
    recorder.trigger(Trigger(0, "start", "the flight begins"))
    for status in SolveStatus:
        solution = Solution(status, force_plan(3), np.nan, 0, 0.0, 1.0)
        recorder.solve(Solve(0, "start", solution))
    for status in PlanStatus:
        path = Plan(status)
        recorder.replan(
            Replan(0, "start", ReferencePlan(ReferenceStatus.NO_PATH, path, None), False, 1.0)
        )
    recorder.reference(0, reference)
    recorder.map(WORLD)
    recorder.message(Envelope("status", 0, 0, 0, 120, object()))


@every_recorder
def test_a_flight_may_end_before_it_began(make, tmp_path):
    make(tmp_path / "run").close(replace(END, success=False))


@every_recorder
@pytest.mark.parametrize("phase", list(Phase))
def test_every_phase_may_be_the_first_and_the_last(make, tmp_path, phase):
    recorder = make(tmp_path / "run")
    for tick in ticks(11, phase):
        recorder.tick(tick)
    recorder.close(END)


@every_recorder
def test_all_news_may_come_before_the_first_tick_and_in_any_outcome(make, tmp_path):
    recorder = make(tmp_path / "run")
    tell_everything(recorder)
    for tick in ticks(11):
        recorder.tick(tick)
    tell_everything(recorder)
    recorder.close(END)


@every_recorder
def test_nothing_that_is_told_is_changed(make, tmp_path):
    recorder = make(tmp_path / "run")
    for tick in ticks(11):
        load, thrust = tick.truth.team.load, tick.truth.rotor_thrust.copy()
        recorder.tick(tick)
        np.testing.assert_array_equal(tick.truth.team.load, load)
        np.testing.assert_array_equal(tick.truth.rotor_thrust, thrust)
    recorder.close(END)
