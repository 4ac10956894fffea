# SPDX-License-Identifier: Apache-2.0
"""Short flights in closed loop, all stages real."""

import json
from unittest.mock import Mock

import numpy as np
import pytest

from skyhaul.errors import ConfigError, FileError
from skyhaul.evaluation.metrics import evaluate
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.evaluation.series import load_run
from skyhaul.mission.api import Phase
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.world.load import load_config

HOVER = ("task.duration_s=2",)
LIFT_OFF = ("time_limit_s=8",)


def fly_into(folder, scenario, entries=(), seed=0, progress=None):
    config = load_config(RunConfig, scenario, entries)
    return fly(config, seed, RunRecorder(folder, config, seed), progress)


@pytest.fixture(scope="module")
def lift_off(tmp_path_factory):
    """The first seconds of `crossing`, from the floor, seed 3."""
    folder = tmp_path_factory.mktemp("flights") / "lift-off"
    return fly_into(folder, "crossing", LIFT_OFF, seed=3), folder


def test_a_hover_stays_where_it_is_and_ends_as_done(tmp_path):
    outcome = fly_into(tmp_path / "run", "hover", HOVER)
    assert outcome.success, outcome.reason
    metrics = evaluate(tmp_path / "run")
    assert metrics["mission_success"]
    assert metrics["collisions"] == 0
    assert metrics["tracking_max_m"] < 0.01
    assert metrics["attitude_rmse_deg"] < 1.0
    assert metrics["min_tension_n"] > 0.1
    assert metrics["nmpc_failures"] == 0
    assert 2.9 < metrics["mission_time_s"] < 4.0


def test_the_same_flight_gives_the_same_bytes(lift_off, tmp_path):
    _, first = lift_off
    fly_into(tmp_path / "again", "crossing", LIFT_OFF, seed=3)
    assert (tmp_path / "again" / "states.parquet").read_bytes() == (
        first / "states.parquet"
    ).read_bytes()


def test_another_seed_is_another_flight(lift_off, tmp_path):
    fly_into(tmp_path / "other", "crossing", ("time_limit_s=0.1",), seed=4)
    movers = [load_run(f).series["obstacle_p"][0] for f in (lift_off[1], tmp_path / "other")]
    assert np.linalg.norm(movers[0] - movers[1], axis=1).min() > 0.01


def test_a_flight_from_the_floor_lifts_off_without_a_jerk(lift_off):
    outcome, folder = lift_off
    assert "time limit" in outcome.reason
    run = load_run(folder)
    assert [name for name, _, _ in run.phase_spans] == ["tauten", "lift", "carry"]
    assert run.series["load"][-1, 2] > 0.2
    assert np.nanmax(run.series["cable_tension_max"]) < 2.0  # no snap: 0.6 N at hover
    height = run.series["load"][:, 2]
    assert np.diff(height[height > 0.06]).min() > -1e-3  # once up it does not sink back


def test_the_outcome_names_the_time_of_every_stage(lift_off):
    outcome, _ = lift_off
    stages = {"perception", "mapping", "planning", "nmpc", "agents", "logging", "plant"}
    assert set(outcome.cpu_s) == stages
    assert all(spent > 0.0 for spent in outcome.cpu_s.values())
    assert sum(outcome.cpu_s.values()) < 1.2 * outcome.wall_s
    assert outcome.end_us == 8_002_000  # the step after the one that the judge looked at


def test_progress_is_told_ten_times_a_second(tmp_path):
    told = []
    fly_into(tmp_path / "run", "hover", ("time_limit_s=0.5",), progress=told.append)
    assert [p.t_us for p in told] == [100_000 * k for k in range(6)]
    assert {p.phase for p in told} == {Phase.CARRY}
    assert np.isnan(told[0].goal_distance_m)
    assert told[0].limit_us == 500_000


def test_an_interrupt_leaves_a_readable_run_folder(tmp_path):
    def stop(progress):
        if progress.t_us == 700_000:
            raise KeyboardInterrupt

    outcome = fly_into(tmp_path / "run", "hover", HOVER, progress=stop)
    assert not outcome.success
    assert outcome.reason == "interrupted"
    metrics = evaluate(tmp_path / "run")
    assert json.loads((tmp_path / "run" / "metrics.json").read_text()) == metrics
    assert metrics["mission_success"] is False
    assert "interrupted" in metrics["outcome"]
    run = load_run(tmp_path / "run")
    assert run.t_s[-1] == pytest.approx(0.7)
    assert run.events.outcome.reason == "interrupted"


def test_an_interrupt_before_the_first_step_leaves_a_readable_run_folder(tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("skyhaul.mission.flight.MujocoPlant", stop)
    outcome = fly_into(tmp_path / "run", "hover", HOVER)
    assert (outcome.reason, outcome.end_us) == ("interrupted", 0)
    assert evaluate(tmp_path / "run")["outcome"] == "interrupted"


def test_a_plant_that_diverges_fails_the_mission_and_keeps_what_was_flown(tmp_path, monkeypatch):
    step = MujocoPlant.step

    def burst(plant, rotor_cmd):
        if plant.truth().stamp_us == 100_000:
            plant._data.qvel[:] = np.nan
        return step(plant, rotor_cmd)

    monkeypatch.setattr(MujocoPlant, "step", burst)
    outcome = fly_into(tmp_path / "run", "hover", HOVER)
    assert (outcome.success, outcome.end_us) == (False, 100_000)
    assert outcome.reason == "the plant diverged at 0.102 s"
    metrics = evaluate(tmp_path / "run")
    assert metrics["mission_success"] is False
    assert "diverged" in metrics["outcome"]
    assert len(load_run(tmp_path / "run").t_s) == 11


def test_a_recorder_that_fails_ends_the_flight_with_its_reason(tmp_path, monkeypatch):
    def full(recorder, tick):
        raise FileError("the disk is full")

    monkeypatch.setattr(RunRecorder, "tick", full)
    with pytest.raises(FileError, match="the disk is full"):
        fly_into(tmp_path / "run", "hover", HOVER)
    assert load_run(tmp_path / "run").events.outcome.reason == "broken off: the disk is full"


def test_a_fault_of_ours_is_passed_on_and_closes_the_folder(tmp_path):
    def burst(progress):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fly_into(tmp_path / "run", "hover", HOVER, progress=burst)
    outcome = load_run(tmp_path / "run").events.outcome
    assert outcome.reason == "broken off by a fault of the program"
    assert not outcome.success


def test_a_flight_refuses_an_estimator_that_it_has_no_readings_for():
    config = load_config(RunConfig, "hover", ["perception.obstacles.kind=events"])
    with pytest.raises(ConfigError, match="recorded events only"):
        fly(config, 0, Mock())
