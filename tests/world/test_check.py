# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.errors import ConfigError
from skyhaul.model.team import Team
from skyhaul.world.check import hover_thrusts
from skyhaul.world.load import load_config
from skyhaul.world.scenario import Scenario


def refusal(name: str, *overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_config(Scenario, name, overrides)
    assert str(caught.value).startswith(f"{name}: ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_hover_thrusts_balance_the_weight_and_the_cable_angle() -> None:
    team = Team(count=5, cable_angle_deg=30.0)
    arrays, thrust = team.arrays(), hover_thrusts(team)
    tension = arrays.m_L * arrays.g / 5 / np.cos(team.cable_angle_rad)
    up = arrays.m_B * arrays.g + tension * np.cos(team.cable_angle_rad)
    out = tension * np.sin(team.cable_angle_rad)
    np.testing.assert_allclose(thrust, np.hypot(up, out))
    assert 5 * (up[0] - arrays.m_B[0] * arrays.g) == pytest.approx(arrays.m_L * arrays.g)


def test_the_largest_accelerations_take_the_whole_thrust() -> None:
    """Straight up, and level, all forces of the hovering formation turned into g + a."""
    team = load_config(Scenario, "paper").team
    arrays, g = team.arrays(), team.arrays().g
    most = {"a_max_mps2": 3.90, "a_brake_mps2": 9.58}
    for name, a in most.items():
        total = np.array([0.0, 0.0, g + a]) if name == "a_max_mps2" else np.array([a, 0.0, g])
        thrust = hover_thrusts(team).max() * np.linalg.norm(total) / g
        assert thrust == pytest.approx(arrays.thrust_max[0], rel=2e-3)
        assert load_config(Scenario, "paper", [f"limits.{name}={a - 0.01}"])


@pytest.mark.parametrize(
    ("overrides", "part"),
    [
        (["task.goal_m=[9, 9, 20]"], "task.goal_m: (9, 9, 20) lies outside the map"),
        (["task.goal_m=[-3, 0, 5]"], "task.goal_m: (-3, 0, 5) lies outside the map"),
        (["task.goal_m=[11.8, 9, 9]"], "the team does not fit between the walls"),
        (["task.goal_m=[9, 9, 12.5]"], "the team does not fit between the walls"),
        (["task.goal_m=[2.2, 2.2, 2.2]"], "would touch obstacle 'cube 1'; move it away"),
        (["task.goal_m=[3.2, 4.2, 3.5]"], "would touch obstacle 'cube 2'"),
        (["world.map.size_m=[5, 5, 5]"], "task.goal_m: (9, 9, 9) lies outside the map"),
        (["world.map.origin_m=[50, 0, 0]"], "the map and the room do not overlap"),
        (["world.obstacles[1].name=cube 1"], "'cube 1' is the name of obstacle 0 already"),
        (["team.payload.mass_kg=2"], "team: vehicle 0 needs"),
        (
            ["limits.v_max_mps=50", "limits.a_max_mps2=60", "limits.j_max_mps3=500"],
            "limits.a_max_mps2: must be <= 3.90 m/s^2, got 60.0: vehicle 0 needs 72% of its thrust",
        ),
        (["task.kind=hover", "limits.a_max_mps2=10"], "limits.a_max_mps2: must be <= 9.58 m/s^2"),
        (["limits.a_brake_mps2=10"], "limits.a_brake_mps2: must be <= 9.58 m/s^2, got 10"),
        (["limits.v_max_mps=200"], "limits.v_max_mps: must be <= 84.65 m/s, got 200"),
        (["team.cable_length_m=0.2"], "is too short for 4 vehicles 0.5 m apart"),
        (["team.cable_length_m=0.55"], "vehicle 0 stands 0.57 m from its hook"),
        (["start.vehicles_m[1]=[0.1, 0]"], "vehicles 0 and 1 stand 0.10 m apart"),
        (["start.vehicles_m=[[0, 0], [1, 1], [1, 0]]"], "3 places for 4 vehicles"),
        (["start.vehicles_m[0]=[-5, 0]"], "vehicles_m[0]: (-5, 0) lies outside the map"),
        (["start.payload_m=[-5, 0]"], "start.payload_m: (-5, 0) lies outside the map"),
        (["events=[{kind: cable-cut, vehicle: 4, at_s: 1}]"], "no vehicle 4; allowed: 0 to 3"),
        (["team.azimuths_deg=[0, 30, 60, 180]"], "leave 180 deg around the load free"),
        (
            ["team.hooks_m=[[0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0], [0.1, -0.1, 0]]"],
            "team.hooks_m: the hooks leave",
        ),
        (
            ["team.hooks_m=[[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]]"],
            "would lean across the load from its hook (",
        ),
        (
            [
                "team.azimuths_deg=[0, 60, 180, 270]",
                "team.hooks_m=[[0.05, 0.15, 0], [0.15, -0.05, 0], [-0.1, 0, 0], [0, -0.1, 0]]",
            ],
            "team.hooks_m: cables 0 and 1 would cross between load and vehicles",
        ),
        (
            ["team={count: 2, azimuths_deg: [0, 180]}", "start.vehicles_m=null"],
            "missions fly 3 to 8 vehicles, got 2",
        ),
    ],
)
def test_an_impossible_scenario_is_refused_in_one_sentence(overrides: list[str], part: str) -> None:
    assert part in refusal("paper", *overrides)


BESIDE = "{name: b, center_m: [1.3, 0, 0.15], shape: {kind: box, size_m: [1.2, 1.6, 0.3]}}"
LID = "{name: b, center_m: [0, 0, 0.6], shape: {kind: box, size_m: [1.6, 1.6, 0.1]}}"
HIGH = "{name: b, center_m: [0, 0, 2.5], shape: {kind: box, size_m: [1.6, 1.6, 0.1]}}"
AWAY = "{name: b, center_m: [1.8, 0, 0.15], shape: {kind: box, size_m: [1.2, 1.6, 0.3]}}"
PASSING = (
    "{name: b, center_m: [0, 0, 0.6], shape: {kind: sphere, radius_m: 0.2}, "
    "motion: {kind: line, velocity_mps: [1, 0, 0], length_m: 5}}"
)
LATER = "{name: b, center_m: [0, 0, 0.6], shape: {kind: sphere, radius_m: 0.2}, appears: {at_s: 9}}"


GROUND = "start={kind: ground, payload_m: [0, 0]}"
FLY_IN = "start={kind: fly-in, payload_m: [0, 0], vehicles_m: [[3, 3], [-1, 3], [-1, -3], [3, -3]]}"


@pytest.mark.parametrize("start", [GROUND, FLY_IN])
@pytest.mark.parametrize("obstacle", [BESIDE, LID])
def test_a_take_off_among_obstacles_that_stand_is_refused(obstacle: str, start: str) -> None:
    """A box beside the team and a lid over it: nothing can step aside while the floor holds."""
    words = refusal("lost-vehicle", f"world.obstacles=[{obstacle}]", start)
    assert "start.payload_m: over (0, 0) the team" in words
    assert "would touch obstacle 'b' as it takes off" in words


@pytest.mark.parametrize("obstacle", [HIGH, AWAY, PASSING, LATER])
def test_what_is_high_away_or_not_always_there_does_not_forbid_a_take_off(obstacle: str) -> None:
    load_config(Scenario, "lost-vehicle", [f"world.obstacles=[{obstacle}]"])


def test_a_take_off_beside_a_wall_is_refused() -> None:
    words = refusal("lost-vehicle", "world.room.min_m=[-0.7, -4, 0]", "world.obstacles=[]")
    assert "does not fit between the walls; the load must stand within" in words


def test_a_blocked_goal_names_a_height_that_is_accepted() -> None:
    sentence = refusal("paper", "task.goal_m=[2.2, 2.2, 2.0]")
    height = sentence.split("height ")[1].split(" m")[0]
    goal = load_config(Scenario, "paper", [f"task.goal_m=[2.2, 2.2, {height}]"]).task
    assert goal.kind == "goto"
    assert abs(goal.goal_m[2] - float(height)) < 1e-12


def test_progress_needs_a_goal() -> None:
    event = "events=[{kind: vehicle-dies, vehicle: 0, at_progress: 0.5}]"
    assert "only a task with a goal has progress" in refusal("circle", event)


def test_an_air_start_inside_an_obstacle_is_refused() -> None:
    start = "start={kind: air, payload_m: [2.2, 2.2, 2.2]}"
    assert "start.payload_m: at (2.2, 2.2, 2.2)" in refusal("paper", start)


@pytest.mark.parametrize("n", range(3, 9))
@pytest.mark.parametrize("name", ["paper", "circle"])
def test_any_number_of_vehicles_flies_with_default_places(name: str, n: int) -> None:
    places = [f"team.count={n}", "team.azimuths_deg=null", "team.hooks_m=null"]
    start = ["start.vehicles_m=null"] if name == "paper" else []
    assert load_config(Scenario, name, places + start).team.count == n


def test_a_hook_on_a_tall_load_is_as_high_as_the_load() -> None:
    tall = ["team.payload.size_m=[0.2, 0.2, 0.4]", "team.payload.hook_height_m=0.2"]
    flat, up = np.hypot(0.5, 0.5) - 0.1414, 0.4 - 0.03
    distance = np.hypot(flat, up)
    length = f"team.cable_length_m={distance - 1e-3}"
    assert f"stands {distance:.2f} m from its hook" in refusal("paper", *tall, length)
    load_config(Scenario, "paper", [*tall, f"team.cable_length_m={distance + 1e-3}"])
