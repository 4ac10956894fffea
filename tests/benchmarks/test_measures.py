# SPDX-License-Identifier: Apache-2.0
"""What the benchmarks of flights take from a run, on made-up runs with known answers."""

from pathlib import Path

import numpy as np
import pytest
from circle_tracking import at_speed, laps_at_speed
from fly import Flown, Job, chosen, fly_one, without_movers
from lost_vehicle import aftermath
from paper_seeds import NEAR_M, arrival, compare, taken_until_s
from result_file import median, numbers, spread, successes
from thrust_prediction import thrust_error

from skyhaul.evaluation.columns import Layout
from skyhaul.evaluation.events import ContactEvent, Events
from skyhaul.evaluation.folder import Origin
from skyhaul.evaluation.series import Run
from skyhaul.geometry.shapes import Sphere
from skyhaul.mission.config import RunConfig
from skyhaul.model.envelope import TeamShape
from skyhaul.world.load import load_config
from skyhaul.world.obstacles import Obstacle
from skyhaul.world.scenario import CircleTask, GoTo, Scenario, World

N = 4


def run_of(scenario: Scenario, rows: int, movers: tuple[int, ...] = ()) -> Run:
    """A run at rest: everything zero, level, alive, attached and airborne."""
    layout = Layout(N, movers)
    series = {key: np.zeros((rows, *block.shape)) for key, block in layout.blocks.items()}
    series["t"] = 10_000.0 * np.arange(rows)
    series["load"][:, 3] = series["ref"][:, 3] = 1.0
    for key in ("airborne", "vehicle_alive", "cable_attached"):
        series[key][:] = 1.0
    origin = Origin(0, "", {}, "")
    return Run(Path(), scenario, origin, layout, ("carry",), series, Events())


def circle_run() -> Run:
    """A circle of 4 s a lap: 4 s from rest to speed, three laps, 4 s to rest."""
    task = CircleTask(radius_m=1.0, period_s=4.0, laps=3)
    run = run_of(Scenario(task=task), 2001)
    speed = 0.5 * np.pi * np.minimum(1.0, np.minimum(run.t_s, 20.0 - run.t_s) / 4.0)
    angle = np.cumsum(speed) * 0.01
    run.series["ref"][:, 7:10] = speed[:, None] * np.stack(
        [-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1
    )
    return run


def test_the_circle_is_at_speed_between_run_up_and_run_out() -> None:
    first_s, last_s = at_speed(circle_run(), 0.5 * np.pi)
    assert first_s == pytest.approx(4.0, abs=0.02)
    assert last_s == pytest.approx(16.0, abs=0.02)


def test_only_the_second_and_third_lap_count() -> None:
    run = circle_run()
    t = run.t_s
    run.series["load"][:, 0] = np.where((t > 8.1) & (t < 15.9), 0.007, 0.5)
    run.series["load"][(t > 7.9) & (t <= 8.1), 0] = 0.007
    run.series["load"][(t >= 15.9) & (t < 16.05), 0] = 0.007
    found = laps_at_speed(run)
    assert found["lap_rmse_mm"] == pytest.approx(7.0, abs=1e-9)
    assert found["lap_max_mm"] == pytest.approx(7.0, abs=1e-9)


def test_a_circle_with_too_few_laps_is_refused() -> None:
    run = circle_run()
    run.series["ref"][1400:, 7:10] = 0.0
    with pytest.raises(ValueError, match="too few laps"):
        laps_at_speed(run)


def test_the_thrust_error_is_relative_to_the_prediction_and_leaves_out_who_does_not_carry() -> None:
    run = run_of(Scenario(), 100)
    run.series["vehicle_thrust_plan"][:] = 2.0
    run.series["vehicle_rotor"][:] = 0.25 * 2.0 * 1.03
    run.series["vehicle_alive"][50:, 1] = 0.0
    run.series["vehicle_rotor"][50:, 1] = 0.0
    run.series["airborne"][:10] = 0.0
    run.series["vehicle_rotor"][:10] = 9.0
    found = thrust_error(run)
    assert found["thrust_rows"] == 40 * N + 50 * (N - 1)
    for key in ("rms", "mean", "p95", "max"):
        assert found[f"thrust_error_{key}_percent"] == pytest.approx(3.0)


def straight_run(detour_m: float) -> Run:
    """Straight to the goal at 1 m/s from 10 m off, after 2 s on the floor; then to and fro."""
    run = run_of(Scenario(task=GoTo(goal_m=(10.0, 0.0, 1.0))), 1201 + round(200 * detour_m))
    t = run.t_s
    x = np.clip(t - 2.0, 0.0, 10.0)
    away = np.clip(t - 12.0, 0.0, None)
    x -= np.minimum(away, 2.0 * detour_m - away).clip(0.0)
    run.series["load"][:, 0], run.series["load"][:, 2] = x, 1.0
    run.series["airborne"][t < 2.0] = 0.0
    return run


def flown(run: Run) -> dict[str, object]:
    p = run.series["load"][run.airborne, 0:3]
    path_m = float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum())
    times = {"mission_time_s": float(run.t_s[-1]), "payload_path_m": path_m}
    return {"mission_success": True, **times, **arrival(run), "goal_free_s": 0.0}


def test_arrival_is_the_first_time_near_the_goal() -> None:
    found = arrival(straight_run(0.0))
    assert found["lift_off_s"] == pytest.approx(2.0)
    assert found["near_goal_s"] == pytest.approx(2.0 + 10.0 - NEAR_M, abs=0.02)
    assert found["near_goal_m"] == pytest.approx(10.0 - NEAR_M, abs=0.02)


def test_what_happens_at_the_goal_is_set_aside_and_nothing_else() -> None:
    still, away = flown(straight_run(0.0)), flown(straight_run(3.0))
    found = compare(away, still)
    assert found["wait_at_goal_s"] == pytest.approx(6.0, abs=0.02)
    assert found["time_ratio"] == pytest.approx(1.0, abs=1e-9)
    assert found["path_ratio_still"] == pytest.approx(1.0, abs=1e-9)
    assert found["whole_time_ratio"] == pytest.approx(18.0 / 12.0, abs=1e-3)
    assert found["whole_path_ratio"] == pytest.approx(1.6, abs=1e-3)


def test_a_wait_on_the_way_counts() -> None:
    still, late = flown(straight_run(0.0)), flown(straight_run(0.0))
    for key in ("lift_off_s", "near_goal_s", "mission_time_s"):
        late[key] = float(str(late[key])) + 6.0
    found = compare(late, still)
    assert found["time_ratio"] == pytest.approx(1.5)
    assert found["from_lift_off_ratio"] == pytest.approx(1.0)
    assert found["wait_at_goal_s"] == pytest.approx(0.0, abs=1e-9)


def test_a_goal_that_is_taken_is_waited_for_from_when_the_load_would_be_there() -> None:
    still, late = flown(straight_run(0.0)), flown(straight_run(0.0))
    for key in ("near_goal_s", "mission_time_s"):
        late[key] = float(str(late[key])) + 6.0
    found = compare(late | {"goal_free_s": 15.0}, still)
    assert found["time_ratio"] == pytest.approx(1.5)
    assert found["wait_for_goal_s"] == pytest.approx(15.0 - 2.0 - 10.0 + NEAR_M, abs=0.02)
    assert found["time_ratio_goal_free"] == pytest.approx(
        (18.0 - float(found["wait_for_goal_s"])) / 12.0
    )
    assert compare(late, still)["wait_for_goal_s"] == 0.0


def test_a_goal_is_taken_while_a_mover_is_beside_the_team_there() -> None:
    world = World(
        obstacles=(Obstacle(name="ball", shape=Sphere(radius_m=0.2), center_m=(10.0, 0.0, 1.0)),)
    )
    run = run_of(Scenario(task=GoTo(goal_m=(10.0, 0.0, 1.0)), world=world), 1001, movers=(0,))
    shape = TeamShape(radius_m=0.7, above_m=1.0, below_m=0.2)
    run.series["obstacle_present"][:] = 1.0
    run.series["obstacle_p"][:, 0] = np.array([10.0, 0.0, 1.0])
    run.series["obstacle_p"][:, 0, 1] = run.t_s  # leaves at 1 m/s
    assert taken_until_s(run, shape, 10.0) == pytest.approx(0.7 + 0.2 + 0.3, abs=0.02)
    assert taken_until_s(run, shape, 0.5) == pytest.approx(0.5, abs=0.02)
    run.series["obstacle_present"][:] = 0.0
    assert taken_until_s(run, shape, 10.0) == 0.0


def test_a_flight_for_a_benchmark_has_its_metrics_and_measures() -> None:
    flight = fly_one(Job("hover", overrides=("task.duration_s=1",), measures=(_rows,)))
    assert flight.success
    assert flight.metrics["program_faults"] == 0
    assert flight.metrics["rows"] > 100


def _rows(run: Run) -> dict[str, object]:
    return {"rows": len(run.t_s)}


def test_a_failed_flight_is_compared_with_nothing() -> None:
    still = flown(straight_run(0.0))
    assert compare(still | {"mission_success": False}, still) == {}
    assert compare({"mission_success": False}, still) == {}


def test_the_fall_of_the_dead_vehicle_is_told_from_other_contacts() -> None:
    run = run_of(Scenario(), 500)
    t = run.t_s
    run.series["vehicle_alive"][t >= 2.0, 1] = 0.0
    run.series["load"][:, 2] = 3.0 - np.where((t > 2.5) & (t < 3.0), 0.1, 0.0)
    run.series["load"][t < 1.0, 2] = 0.5
    half = np.deg2rad(16.0) / 2.0
    run.series["load"][t > 3.5, 3:7] = [np.cos(half), 0.0, np.sin(half), 0.0]
    run.events.contacts += [
        ContactEvent(2.8, "vehicle 1", "room", airborne=True, lost=True),
        ContactEvent(2.7, "vehicle 1", "post", airborne=True, lost=True),
        ContactEvent(2.9, "payload", "room", airborne=True, lost=False),
        ContactEvent(0.1, "payload", "room", airborne=False, lost=False),
    ]
    found = aftermath(run)
    assert found["lost_at_s"] == pytest.approx(2.0)
    assert found["drop_m"] == pytest.approx(0.1)
    assert found["lowest_after_m"] == pytest.approx(2.9)
    assert found["tilt_after_deg"] == pytest.approx(16.0)
    assert found["contacts_of_the_fall"] == 1
    assert found["contacts_other"] == 2


def test_without_movers_the_two_cubes_are_left_and_nothing_else_changes() -> None:
    config = load_config(RunConfig, "paper")
    still = without_movers(config)
    assert [o.name for o in still.world.obstacles] == ["cube 1", "cube 2"]
    assert still.world.map == config.world.map
    assert still.task == config.task
    assert without_movers(load_config(RunConfig, "sudden")).world.obstacles == ()


def test_statistics_leave_out_flights_without_the_value() -> None:
    job = Job("paper", case="a")
    values = (0.001, 0.003, None, 0.008)
    flights = [Flown(job, {"x": v, "mission_success": v is not None}) for v in values]
    assert numbers(flights, "x") == [0.001, 0.003, 0.008]
    assert median(flights, "x") == 0.003
    assert spread(flights, "x", 1e3) == "3 (1 .. 8)"
    assert spread(flights, "y") == "none"
    assert median(flights, "y") is None
    assert successes(flights) == "3/4"
    assert chosen(flights, case="b") == []
