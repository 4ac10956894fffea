# SPDX-License-Identifier: Apache-2.0
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skyhaul.errors import FileError
from skyhaul.evaluation.energy import EnergyModel, compute_energy_j, rotor_power_factor
from skyhaul.evaluation.judge import fault_of
from skyhaul.evaluation.metrics import attitude_error, evaluate, run_metrics
from skyhaul.evaluation.series import load_run
from skyhaul.evaluation.shortest import _full_map, _statics
from skyhaul.geometry.quaternion import quat_exp, quat_mul
from skyhaul.model.envelope import team_shape
from skyhaul.plant.api import Contact
from skyhaul.world.scenario import CircleTask, HoverTask

Flight = Callable[..., Path]

KEYS = """
    mission_success mission_time_s distance_to_goal_m payload_path_m path_ratio collisions
    min_clearance_m min_quad_distance_m min_tension_n max_tension_n slack_time_s
    max_thrust_ratio payload_swing_rms_deg tracking_rmse_m tracking_max_m attitude_rmse_deg
    nmpc_solves nmpc_solves_per_s nmpc_solve_ms_p50 nmpc_solve_ms_p99 nmpc_failures replans
    plan_ms_p50 plan_ms_p99 reaction_mover_ms_p50 reaction_mover_ms_p99 reaction_static_ms_p50
    reaction_static_ms_p99 messages bytes_sent rotor_energy_j compute_energy_j radio_energy_j
    real_time_factor vio_ate_m vio_ate_percent map_precision map_recall detection_recall
    detection_latency_ms track_rmse_m events_total gnn_events_per_s gnn_skipped_fraction
"""


@pytest.fixture(scope="module")
def metrics(run_folder: Path) -> dict[str, object]:
    return evaluate(run_folder)


def test_metrics_have_every_key_of_the_contract(metrics: dict, run_folder: Path) -> None:
    assert [k for k in KEYS.split() if k not in metrics] == []
    assert json.loads((run_folder / "metrics.json").read_text()) == metrics
    assert metrics["vio_ate_m"] is None


def test_tracking_is_what_the_flight_was_made_with(metrics: dict) -> None:
    assert metrics["tracking_rmse_m"] == pytest.approx(0.03)
    assert metrics["tracking_max_m"] == pytest.approx(0.03)
    assert metrics["attitude_rmse_deg"] == pytest.approx(0.0, abs=1e-9)
    assert metrics["payload_swing_rms_deg"] == pytest.approx(np.degrees(0.05))


def test_the_path_is_the_arc(metrics: dict) -> None:
    arc = 4.0 * 0.5 * np.hypot(1.5, 0.3)
    chord = np.hypot(3.0 * np.sin(1.0), 0.6)
    assert metrics["payload_path_m"] == pytest.approx(arc, rel=1e-4)
    assert metrics["path_ratio"] == pytest.approx(arc / chord, rel=2e-2)


def test_extremes_and_energies_are_closed_forms(metrics: dict) -> None:
    assert metrics["min_clearance_m"] == pytest.approx(0.4, abs=1e-6)
    assert metrics["min_tension_n"] == metrics["max_tension_n"] == 0.6
    assert metrics["max_thrust_ratio"] == pytest.approx(3.2 / 4.24)
    disc = np.pi * 0.05**2
    power = 16 * 0.8**1.5 / (0.6 * np.sqrt(2.0 * 1.225 * disc))
    assert metrics["rotor_energy_j"] == pytest.approx(7.002 * power, rel=1e-9)
    assert metrics["compute_energy_j"] == pytest.approx(5.0 * 2.0)
    assert metrics["radio_energy_j"] == pytest.approx(13_000 * 1e-6)
    assert metrics["real_time_factor"] == pytest.approx(2.0)


def test_counts(metrics: dict) -> None:
    assert (metrics["nmpc_solves"], metrics["replans"], metrics["messages"]) == (13, 1, 13)
    assert (metrics["triggers_start"], metrics["triggers_plan_age"]) == (1, 13)
    assert metrics["nmpc_solves_per_s"] == pytest.approx(13 / 6.01)
    assert (metrics["compute_cpu_s_plant"], metrics["compute_cpu_s_control"]) == (4.0, 2.0)


def test_a_good_flight_is_done(metrics: dict) -> None:
    assert metrics["mission_success"] is True
    assert metrics["collisions"] == 0


def test_contacts_count_from_lift_off_on(fly_into: Flight, tmp_path: Path) -> None:
    contacts = (
        Contact(200_000, "vehicle 1", "room"),
        Contact(3_000_000, "vehicle 1", "ball"),
        Contact(3_002_000, "cable 2", "wall"),
    )
    metrics = evaluate(fly_into(tmp_path / "r", contacts=contacts))
    assert metrics["collisions"] == 2
    assert metrics["mission_success"] is False
    assert metrics["outcome"] == "vehicle 1 touched ball at 3.00 s, the first of 2 contacts"


def test_a_lost_vehicle_may_fall(fly_into: Flight, tmp_path: Path) -> None:
    contacts = (Contact(4_000_000, "vehicle 0", "room"),)
    folder = fly_into(tmp_path / "r", contacts=contacts, dead_from_us=3_000_000)
    metrics = evaluate(folder)
    assert (metrics["collisions"], metrics["collisions_lost_vehicle"]) == (1, 1)
    assert metrics["min_tension_n"] == 0.6
    assert metrics["slack_time_s"] == 0.0
    assert metrics["mission_success"] is True


@pytest.mark.parametrize("other", ["vehicle 1", "payload", "cable 2", "ball"])
@pytest.mark.parametrize("lost", ["vehicle 0", "cable 0"])
def test_a_lost_vehicle_may_not_fall_on_anybody(
    fly_into: Flight, tmp_path: Path, lost: str, other: str
) -> None:
    contacts = (Contact(4_000_000, other, lost),)
    metrics = evaluate(fly_into(tmp_path / "r", contacts=contacts, dead_from_us=3_000_000))
    assert (metrics["collisions"], metrics["collisions_lost_vehicle"]) == (1, 0)
    assert metrics["outcome"] == f"{other} touched {lost} at 4.00 s"


def test_a_vehicle_that_was_let_go_and_still_flies_may_not_fall(
    fly_into: Flight, tmp_path: Path
) -> None:
    contacts = (Contact(4_000_000, "vehicle 0", "room"),)
    metrics = evaluate(fly_into(tmp_path / "r", contacts=contacts, let_go_from_us=3_000_000))
    assert (metrics["collisions"], metrics["collisions_lost_vehicle"]) == (1, 0)
    assert metrics["mission_success"] is False


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ({"touch_at_us": 3_004_000}, "the clearance fell to -0.010 m"),
        ({"slack_at_us": 3_004_000}, "a cable was slack for 0.002 s after lift-off"),
        ({"success": False}, "gave up"),
    ],
)
def test_a_claimed_success_is_checked(
    fly_into: Flight, tmp_path: Path, fault: dict, sentence: str
) -> None:
    metrics = evaluate(fly_into(tmp_path / "r", **fault))
    assert metrics["mission_success"] is False
    assert metrics["outcome"] == sentence


def test_attitude_error_is_the_angle_between_the_two_attitudes(run_folder: Path) -> None:
    run = load_run(run_folder)
    desired = quat_exp(np.array([0.4, -1.1, 0.7]))
    turned = quat_mul(desired, quat_exp(np.array([0.03, 0.04, 0.0])))
    series = dict(run.series)
    series["load"], series["ref"] = run.series["load"].copy(), run.series["ref"].copy()
    series["load"][:, 3:7], series["ref"][:, 3:7] = turned, desired
    np.testing.assert_allclose(attitude_error(replace(run, series=series))[run.airborne], 0.05)
    series["load"][:, 3:7] *= -1.0
    np.testing.assert_allclose(attitude_error(replace(run, series=series))[run.airborne], 0.05)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({}, None),
        ({"goal_m": (9.0, 9.0, 9.0)}, "the load was not held at the goal"),
        ({"below_mps": 1e-9, "hold_s": 2.5}, "the load was not held at the goal"),
        ({"hold_s": 8.0}, "the load was not held at the goal"),
    ],
)
def test_a_claimed_arrival_is_checked(
    run_folder: Path, metrics: dict, change: dict, fault: str | None
) -> None:
    run = load_run(run_folder)
    task = replace(run.scenario.task, **change)
    assert fault_of(replace(run, scenario=replace(run.scenario, task=task)), metrics) == fault


@pytest.mark.parametrize("task", [HoverTask(within_m=0.3), CircleTask(within_m=0.3)])
def test_laps_count_only_near_their_reference(
    run_folder: Path, metrics: dict, task: HoverTask | CircleTask
) -> None:
    run = load_run(run_folder)
    run = replace(run, scenario=replace(run.scenario, task=task))
    assert fault_of(run, metrics | {"tracking_max_m": 0.29}) is None
    assert fault_of(run, metrics | {"tracking_max_m": 0.41}) == (
        "the load was 0.41 m off its reference; task.within_m allows 0.3 m"
    )


def test_a_path_that_did_not_arrive_has_no_ratio(run_folder: Path) -> None:
    run = load_run(run_folder)
    task = replace(run.scenario.task, goal_m=(5.0, 5.0, 5.0))
    away = replace(run, scenario=replace(run.scenario, task=task))
    assert run_metrics(away, EnergyModel())["path_ratio"] is None


def test_slack_before_lift_off_is_no_fault(fly_into: Flight, tmp_path: Path) -> None:
    metrics = evaluate(fly_into(tmp_path / "r", slack_at_us=996_000))
    assert metrics["mission_success"] is True
    assert metrics["min_tension_n"] == 0.6


def test_a_folder_without_a_run_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="is no run folder: it has no config"):
        evaluate(tmp_path)


def test_hover_power_of_a_rotor_is_momentum_theory() -> None:
    model = EnergyModel(figure_of_merit=1.0, air_density_kgpm3=1.2)
    thrust, radius = 2.0, 0.1
    induced = np.sqrt(thrust / (2.0 * 1.2 * np.pi * radius**2))
    assert rotor_power_factor(model, radius) * thrust**1.5 == pytest.approx(thrust * induced)


def test_simulating_the_world_costs_the_team_no_energy() -> None:
    model = EnergyModel(compute_w=4.0)
    assert compute_energy_j(model, {"plant": 10.0, "logging": 3.0, "nmpc": 2.0}) == 8.0


@pytest.mark.parametrize("wrong", [{"figure_of_merit": 0.0}, {"compute_w": -1.0}])
def test_impossible_constants_are_refused(wrong: dict) -> None:
    with pytest.raises(ValueError, match="must"):
        EnergyModel(**wrong)


@pytest.mark.parametrize("margin_m", [0.1, 0.4])
def test_the_shortest_clear_path_keeps_the_margin_of_the_run(
    run_folder: Path, tmp_path: Path, margin_m: float
) -> None:
    copy = shutil.copytree(run_folder, tmp_path / "run")
    text = (copy / "config.yaml").read_text("utf-8")
    (copy / "config.yaml").write_text(text + f"planning: {{margin_m: {margin_m}}}\n", "utf-8")
    run = load_run(copy)
    world_map = _full_map(run, _statics(run.scenario))
    assert world_map.shape == team_shape(run.scenario.team, margin_m)
