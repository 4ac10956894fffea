# SPDX-License-Identifier: Apache-2.0
"""Tests of `plant.mujoco_plant`, `plant.build`, `plant.start` and `plant.events`."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.errors import ConfigError, SkyhaulError
from skyhaul.geometry.quaternion import quat_rotate
from skyhaul.geometry.shapes import Box, Capsule, Sphere
from skyhaul.model.formation import hover_state, hover_wrenches
from skyhaul.model.mixer import rotors_to_wrench, wrench_to_rotors
from skyhaul.model.step import step
from skyhaul.model.team import PointPayload, RigidPayload, Team, Vehicle, VehicleOverride
from skyhaul.plant.mujoco_plant import STEP_S, MujocoPlant
from skyhaul.types import GRAVITY_MPS2
from skyhaul.world.obstacles import Appearance, Line, Obstacle
from skyhaul.world.scenario import (
    AirStart,
    CableCut,
    FlyInStart,
    GoTo,
    GroundStart,
    Gust,
    HookRelease,
    HoverTask,
    Scenario,
    VehicleDies,
    Wind,
    World,
)

AIR = AirStart(payload_m=(5.0, 5.0, 5.0))
IDEAL = Vehicle(motor_lag_s=0.0, drag_ns_per_m=0.0)
UP = np.array([0.0, 0.0, 1.0])


def ideal(n, rigid=True, **more):
    payload = RigidPayload(drag_ns_per_m=0.0) if rigid else PointPayload(drag_ns_per_m=0.0)
    return Team(count=n, vehicle=IDEAL, payload=payload, **more)


def plant_of(team=None, start=AIR, seed=0, obstacles=(), wind=None, **more):
    world = World(obstacles=tuple(obstacles), wind=wind or Wind())
    team = team or Team()
    more = {"task": HoverTask(), **more}
    return MujocoPlant(Scenario(team=team, world=world, start=start, **more), seed)


def run(plant, steps, command=None):
    """Truths of some steps, rotors held."""
    command = plant.truth().rotor_thrust if command is None else command
    return [plant.step(command) for _ in range(steps)]


def ball(name="ball", center=(5.0, 5.0, 1.0), **more):
    return Obstacle(name=name, shape=Sphere(radius_m=0.2), center_m=center, **more)


@pytest.mark.parametrize("rigid", [True, False])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 6, 8])
def test_hover_is_equilibrium_from_the_first_truth_on(n, rigid):
    strong = replace(IDEAL, thrust_max_n=6.0)  # one alone must lift the load
    plant = plant_of(replace(ideal(n, rigid), vehicle=strong))
    first = plant.truth()
    assert np.max(np.abs(first.accel_W)) < 2e-3
    last = run(plant, 250)[-1]
    np.testing.assert_allclose(last.team.p_WB, first.team.p_WB, atol=2e-4)
    np.testing.assert_allclose(last.team.p_WL, first.team.p_WL, atol=2e-4)


@pytest.mark.parametrize("rigid", [True, False])
def test_tensions_carry_the_weight_in_hover(rigid):
    truth = plant_of(Team(payload=RigidPayload() if rigid else PointPayload())).truth()
    pull = -truth.cables.tension @ truth.cables.dir_W
    np.testing.assert_allclose(pull, 0.232 * GRAVITY_MPS2 * UP, atol=1e-3)


@pytest.mark.parametrize("rigid", [True, False])
def test_accelerations_and_tensions_obey_newton_in_motion(rigid):
    """m a = thrust + tension + weight for every body, and the load turns as the hooks pull it."""
    team = ideal(3, rigid)
    plant, arrays = plant_of(team), team.arrays()
    rng = np.random.default_rng(0)
    state = hover_state(team, np.array([5.0, 5.0, 5.0]))
    state = replace(state, v_WL=rng.normal(size=3), w_WL_L=0.3 * rng.normal(size=3) * rigid)
    rotors = wrench_to_rotors(team, hover_wrenches(team)) + 0.05 * rng.normal(size=(3, 4))
    plant.set_taut(state, rotors)
    for truth in run(plant, 200, rotors)[20::20]:
        pull = truth.cables.tension[:, None] * truth.cables.dir_W  # on the vehicles
        thrust = quat_rotate(truth.team.q_WB, rotors.sum(axis=1)[:, None] * UP)
        weight = -GRAVITY_MPS2 * UP
        np.testing.assert_allclose(
            truth.accel_W[1:], (thrust + pull) / arrays.m_B[:, None] + weight, atol=1e-6
        )
        load = -pull.sum(axis=0) / arrays.m_L + weight
        np.testing.assert_allclose(truth.accel_W[0], load, atol=1e-6)


def test_acceleration_is_the_derivative_of_velocity():
    plant = plant_of(ideal(4))
    command = plant.truth().rotor_thrust * np.array([[1.05], [1.0], [0.97], [1.0]])
    truths = run(plant, 150, command)[50:]
    v = np.array([np.vstack([t.team.v_WL, t.team.v_WB]) for t in truths])
    a = np.array([t.accel_W for t in truths])
    slope = (v[2:] - v[:-2]) / (2.0 * STEP_S)
    np.testing.assert_allclose(a[1:-1], slope, atol=0.02)


def test_cable_states_are_geometry_and_its_derivative():
    team = ideal(4)
    plant = plant_of(team)
    command = plant.truth().rotor_thrust * np.array([[1.05], [1.0], [0.97], [1.0]])
    truths = run(plant, 100, command)
    for before, now, after in zip(truths[60:], truths[61:], truths[62:], strict=False):
        hooks = now.team.p_WL + quat_rotate(now.team.q_WL[None], team.hooks_L())
        along = hooks - now.team.p_WB
        np.testing.assert_allclose(now.cables.length, np.linalg.norm(along, axis=1), rtol=1e-12)
        np.testing.assert_allclose(now.cables.dir_W, along / now.cables.length[:, None], atol=1e-12)
        rate = (after.cables.dir_W - before.cables.dir_W) / (2.0 * STEP_S)
        np.testing.assert_allclose(np.cross(now.cables.w_W, now.cables.dir_W), rate, atol=1e-4)
        assert np.max(np.abs(np.sum(now.cables.w_W * now.cables.dir_W, axis=1))) < 1e-12


@pytest.mark.parametrize(("n", "rigid"), [(3, True), (4, False)])
def test_the_plant_follows_the_exact_taut_dynamics(n, rigid):
    """1 s of free swing; `benchmarks/plant_oracle.py` flies 5 s, free and driven."""
    team = ideal(n, rigid)
    plant, rng = plant_of(team), np.random.default_rng(n)
    exact = hover_state(team, np.array([5.0, 5.0, 5.0]))
    w = rng.uniform(-0.3, 0.3, (n, 3))
    w -= np.sum(w * exact.cable_dir_W, axis=1, keepdims=True) * exact.cable_dir_W
    exact = replace(exact, v_WL=rng.uniform(-0.5, 0.5, 3), cable_w_W=w)
    rotors = wrench_to_rotors(team, hover_wrenches(team))
    plant.set_taut(exact, rotors)
    for truth in run(plant, 500, rotors):
        exact = step(team, exact, rotors_to_wrench(team, rotors), STEP_S)
        assert np.linalg.norm(truth.team.p_WL - exact.p_WL) < 5e-5
    np.testing.assert_allclose(truth.cables.dir_W, exact.cable_dir_W, atol=2e-4)
    np.testing.assert_allclose(truth.team.q_WL, exact.q_WL, atol=2e-4)


def test_rotor_moments_turn_the_vehicle_as_the_mixer_says():
    team = ideal(3)
    J = np.array(team.vehicle.inertia_kgm2)
    for axis in range(3):
        wrench = hover_wrenches(team)
        wrench[0, 1 + axis] += 1e-3
        truth = run(plant_of(team), 10, wrench_to_rotors(team, wrench))[-1]
        expected = np.zeros(3)
        expected[axis] = 1e-3 / J[axis] * 10 * STEP_S
        np.testing.assert_allclose(truth.team.w_WB_B[0], expected, atol=1e-5)


def test_a_slack_cable_does_not_pull_and_a_climbing_vehicle_snaps_it_taut():
    plant = plant_of(start=GroundStart(payload_m=(5.0, 5.0)))
    truth = plant.truth()
    np.testing.assert_array_equal(truth.cables.tension, 0.0)
    assert np.all(truth.cables.length < 1.0)
    truths = run(plant, 350, np.full((4, 4), 1.0))  # every vehicle climbs
    tension = np.array([t.cables.tension for t in truths])
    length = np.array([t.cables.length for t in truths])
    assert np.max(tension) > 3.0
    assert np.all(tension[length < 0.9999] == 0.0)
    assert np.max(length) < 1.03


def test_standing_on_the_ground_is_rest():
    plant = plant_of(start=GroundStart(payload_m=(5.0, 5.0)))
    first, last = plant.truth(), run(plant, 250)[-1]
    assert np.max(np.abs(first.accel_W)) < 1e-6
    np.testing.assert_allclose(last.team.p_WB, first.team.p_WB, atol=1e-6)
    np.testing.assert_allclose(last.team.p_WL, first.team.p_WL, atol=1e-6)
    names = {(c.body_a, c.body_b) for c in first.contacts}
    assert names == {("payload", "room"), *((f"vehicle {i}", "room") for i in range(4))}


def test_the_default_ring_stands_at_the_azimuths_of_the_hooks():
    team = Team(count=5)
    p = plant_of(team, GroundStart(payload_m=(5.0, 4.0))).truth().team.p_WB[:, :2] - [5.0, 4.0]
    np.testing.assert_allclose(np.hypot(*p.T), 0.7, atol=1e-6)
    np.testing.assert_allclose(
        np.exp(1j * np.arctan2(p[:, 1], p[:, 0])), np.exp(1j * team.azimuths_rad), atol=1e-6
    )


@pytest.mark.parametrize("rigid", [True, False])
def test_drag_is_linear_in_the_speed_through_the_air(rigid):
    """With open hooks the load falls as m v' = -m g - d (v - wind)."""
    payload = RigidPayload(drag_ns_per_m=0.1) if rigid else PointPayload(drag_ns_per_m=0.1)
    wind = Wind(mean_mps=(3.0, 0.0, 0.0))
    plant = plant_of(Team(payload=payload), wind=wind)
    for i in range(4):
        plant.release_hook(i)
    truth = run(plant, 200)[-1]
    keep = np.exp(-0.1 / 0.232 * 0.4)
    steady = np.array([3.0, 0.0, -0.232 * GRAVITY_MPS2 / 0.1])
    np.testing.assert_allclose(truth.team.v_WL, steady * (1.0 - keep), rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(truth.wind_W, [3.0, 0.0, 0.0])


def test_drag_slows_translation_but_not_rotation():
    vehicle = Vehicle(motor_lag_s=0.0, drag_ns_per_m=0.5, thrust_min_n=0.0)
    team = Team(vehicle=vehicle, payload=RigidPayload(drag_ns_per_m=0.5))
    plant = plant_of(team)
    state = hover_state(team, np.array([5.0, 5.0, 5.0]))
    state = replace(state, w_WL_L=1.5 * UP, w_WB_B=np.tile(2.0 * UP, (4, 1)))
    plant.set_taut(state, np.zeros((4, 4)))
    for i in range(4):
        plant.release_hook(i)
    truth = run(plant, 200, np.zeros((4, 4)))[-1]
    fall = 0.25 * GRAVITY_MPS2 / 0.5 * (1.0 - np.exp(-0.5 / 0.25 * 0.4))
    np.testing.assert_allclose(truth.team.v_WB[:, 2], -fall, rtol=1e-6)
    np.testing.assert_allclose(truth.team.w_WB_B[:, 2], 2.0, rtol=1e-9)
    np.testing.assert_allclose(truth.team.w_WL_L, 1.5 * UP, atol=1e-9)


def test_same_seed_same_bits_and_other_seeds_differ():
    wind = Wind(turbulence_mps=1.0, gusts=(Gust(start_s=0.0, duration_s=1.0, peak_mps=(1, 0, 0)),))
    mover = ball(motion=Line(velocity_mps=(0.5, 0.0, 0.0), length_m=3.0))
    ends = [run(plant_of(seed=s, wind=wind, obstacles=[mover]), 100)[-1] for s in (3, 3, 4)]
    np.testing.assert_array_equal(ends[0].team.p_WB, ends[1].team.p_WB)
    np.testing.assert_array_equal(ends[0].wind_W, ends[1].wind_W)
    assert np.max(np.abs(ends[0].wind_W - ends[2].wind_W)) > 0.01
    assert abs(ends[0].obstacles.p_WO[0, 0] - ends[2].obstacles.p_WO[0, 0]) > 0.01


def test_a_released_hook_lets_the_vehicle_go_and_drops_out_of_the_clearance():
    obstacle = ball(center=(5.45, 5.45, 5.5))  # beside cable 0
    plant = plant_of(obstacles=[obstacle])
    near = plant.truth().clearance_m
    plant.release_hook(0)
    truth = run(plant, 1)[-1]
    np.testing.assert_array_equal(truth.attached, [False, True, True, True])
    assert truth.cables.tension[0] == 0.0
    assert truth.clearance_m > near + 0.01
    truth = run(plant, 100)[-1]
    assert truth.cables.length[0] > 1.01
    assert truth.team.p_WL[2] < 5.0


def test_fly_in_starts_open_and_a_hook_closes_only_within_reach():
    spots = ((4.5, 5.0), (8.0, 5.0), (5.0, 4.5))
    start = FlyInStart(payload_m=(5.0, 5.0), vehicles_m=spots)
    plant = plant_of(Team(count=3), start)
    assert not plant.truth().attached.any()
    assert [plant.attach_hook(i) for i in range(3)] == [True, False, True]
    truth = run(plant, 1)[-1]
    np.testing.assert_array_equal(truth.attached, [True, False, True])
    truths = run(plant, 300, np.full((3, 4), 0.9))
    assert truths[-1].cables.length[1] > 2.9
    assert max(t.cables.length[0] for t in truths) < 1.03


def test_events_play_at_their_time_and_a_cut_cable_stays_cut():
    """Cables 2 and 3 are opened while the vehicles stand within reach."""
    events = (
        VehicleDies(vehicle=1, at_s=0.02),
        CableCut(vehicle=2, at_s=0.03),
        HookRelease(vehicle=3, at_s=0.04),
    )
    plant = plant_of(ideal(4), GroundStart(payload_m=(5.0, 5.0)), events=events)
    truths = run(plant, 25)
    stamps = np.array([t.stamp_us for t in truths])
    died = np.array([not t.alive[1] for t in truths])
    np.testing.assert_array_equal(died, stamps > 20_000)
    assert truths[-1].alive[[0, 2, 3]].all()
    np.testing.assert_array_equal([not t.attached[2] for t in truths], stamps > 30_000)
    np.testing.assert_array_equal([not t.attached[3] for t in truths], stamps > 40_000)
    assert truths[-1].rotor_thrust[1].max() == 0.0
    assert not plant.attach_hook(2)
    assert plant.attach_hook(3)


def test_a_vehicle_dies_once_the_load_is_so_far_along():
    event = VehicleDies(vehicle=0, at_progress=0.25)
    goal = GoTo(goal_m=(5.0, 5.0, 7.0))
    plant = plant_of(ideal(4), events=(event,), task=goal)
    truths = run(plant, 700, 1.1 * plant.truth().rotor_thrust)
    height = np.array([t.team.p_WL[2] for t in truths])
    died = np.array([not t.alive[0] for t in truths])
    assert 0 < np.argmax(died) == np.argmax(height >= 5.5) + 1


def test_where_the_goal_is_the_start_all_of_the_way_is_done():
    event = VehicleDies(vehicle=0, at_progress=0.5)
    here = tuple(float(c) for c in plant_of().truth().team.p_WL)
    truths = run(plant_of(events=(event,), task=GoTo(goal_m=here)), 2)
    assert not truths[-1].alive[0]


def test_clearance_falls_to_a_contact_that_is_told_once():
    """A ball falls onto vehicle 0 from above, at 1 m/s."""
    top = plant_of().truth().team.p_WB[0]
    mover = ball("falling", (top[0], top[1], top[2] + 0.5), motion=Line(velocity_mps=(0, 0, -1)))
    plant = plant_of(obstacles=[mover])
    truths = [plant.truth(), *run(plant, 150)]
    contacts = [c for t in truths for c in t.contacts]
    assert [(c.body_a, c.body_b) for c in contacts][:1] == [("vehicle 0", "falling")]
    touch = contacts[0].stamp_us
    at_touch = next(t for t in truths if t.stamp_us == touch)
    assert at_touch.clearance_m <= 0.0
    assert all(t.clearance_m > 0.0 for t in truths if t.stamp_us < touch)
    assert abs(at_touch.v_WO[0, 2] + 1.0) < 1e-12
    assert truths[-1].team.p_WB[0, 2] < top[2] - 1e-3  # pushed down: contacts act


class Colliding(MujocoPlant):
    """Looks for contacts at every step, needed or not."""

    def _collide(self, wanted):
        super()._collide(True)


def test_contacts_are_only_left_out_where_there_are_none():
    """Balls pass by, come to hit and appear inside the payload; the load falls to the floor."""
    near, top = (4.4, 5.0, 5.0), plant_of().truth().team.p_WB[0]
    obstacles = (
        ball("passing", near, motion=Line(velocity_mps=(0.0, 1.0, 0.0))),
        ball("falling", (top[0], top[1], top[2] + 0.6), motion=Line(velocity_mps=(0, 0, -2))),
        ball("sudden", (5.0, 5.0, 4.9), appears=Appearance(at_s=0.2)),
    )
    world = World(obstacles=obstacles)
    for start in (AIR, replace(AIR, payload_m=(5.0, 5.0, 0.3))):
        scenario = Scenario(team=Team(), world=world, start=start, task=HoverTask())
        lazy, eager = MujocoPlant(scenario, 0), Colliding(scenario, 0)
        command, skipped, touched = np.full((4, 4), 0.3), 0, 0
        for _ in range(300):
            a, b = lazy.step(command), eager.step(command)
            for field in ("p_WL", "q_WL", "v_WL", "p_WB", "q_WB", "v_WB", "w_WB_B"):
                np.testing.assert_array_equal(getattr(a.team, field), getattr(b.team, field))
            np.testing.assert_array_equal(a.accel_W, b.accel_W)
            skipped += not lazy._colliding
            touched += len(a.contacts)
        assert touched > 0
        assert 0 < skipped < 300


def test_an_obstacle_is_nowhere_until_it_appears():
    late = ball(center=(5.0, 5.0, 5.2), appears=Appearance(at_s=0.1))
    plant = plant_of(obstacles=[late])
    truths = run(plant, 60)
    before = [t for t in truths if t.stamp_us < 100_000]
    after = [t for t in truths if t.stamp_us >= 100_000]
    assert not any(t.present[0] or t.contacts for t in before)
    assert all(t.present[0] for t in after)
    assert np.isinf(before[-1].clearance_m)
    assert after[0].clearance_m < 0.0
    assert {c.body_a for c in after[0].contacts} >= {"payload"}


def test_what_has_appeared_by_distance_stays():
    """It appears as the load falls towards it, and is still there when the load is gone."""
    pillar = Obstacle(
        name="pillar",
        shape=Capsule(radius_m=0.1, length_m=0.2),
        center_m=(5.0, 5.0, 4.0),
        appears=Appearance(distance_m=0.5),
    )
    team = ideal(3)
    plant = plant_of(team, obstacles=[pillar])
    assert not plant.truth().present[0]
    state = hover_state(team, np.array([5.0, 5.0, 5.0]))
    rotors = plant.truth().rotor_thrust
    plant.set_taut(replace(state, v_WL=np.array([0.0, 0.0, -1.0])), rotors)
    assert run(plant, 200, rotors)[-1].present[0]
    plant.set_taut(replace(state, p_WL=np.array([9.0, 9.0, 9.0])), rotors)
    assert run(plant, 1, rotors)[-1].present[0]


def test_heavier_vehicles_and_longer_cables_are_used():
    overrides = (VehicleOverride(index=1, mass_kg=0.3, cable_length_m=1.2),)
    plant = plant_of(ideal(4, overrides=overrides))
    truth = plant.truth()
    np.testing.assert_allclose(truth.cables.length, [1.0, 1.2, 1.0, 1.0], atol=1e-4)
    assert np.max(np.abs(truth.accel_W)) < 2e-3


def test_rotor_commands_of_the_wrong_shape_are_refused():
    with pytest.raises(SkyhaulError, match=r"shape \(4, 4\), got \(4,\)"):
        plant_of().step(np.ones(4))


def test_a_truth_never_changes_once_it_is_given():
    """Nothing in a truth is a view of memory that the next step writes to."""
    plant = plant_of(obstacles=[ball(motion=Line(velocity_mps=(0.5, 0.0, 0.0)))])
    truth = plant.truth()
    kept = [truth.team.p_WB.copy(), truth.obstacles.p_WO.copy(), truth.rotor_thrust.copy()]
    kept += [truth.accel_W.copy(), truth.cables.tension.copy(), truth.attached.copy()]
    plant.release_hook(0)
    run(plant, 20, np.full((4, 4), 0.2))
    now = [truth.team.p_WB, truth.obstacles.p_WO, truth.rotor_thrust]
    now += [truth.accel_W, truth.cables.tension, truth.attached]
    for before, after in zip(kept, now, strict=True):
        np.testing.assert_array_equal(after, before)


def test_a_bad_start_is_refused_in_one_sentence():
    def twice(xy):
        return GroundStart(payload_m=(5.0, 5.0), vehicles_m=((4.6, 4.6), (4.6, 5.4), (5.4, 5), xy))

    cases = [
        (plant_of, {"start": twice((5.4, 5.05))}, r"vehicles 2 and 3 are 0.05 m apart"),
        (plant_of, {"start": twice((7.0, 5.0))}, r"cable 3 is too short.*1.9\d m from its hook"),
        (
            plant_of,
            {"start": AirStart(payload_m=(5, 5, 12.5))},
            r"vehicle 0 is not inside the room",
        ),
        (plant_of, {"start": GroundStart(payload_m=(-1.95, 5))}, r"payload is not inside the room"),
        (plant_of, {"obstacles": [ball(center=(5, 5, 5.2))]}, r"payload is inside ball"),
        (
            plant_of,
            {
                "start": GroundStart(payload_m=(5, 5)),
                "obstacles": [
                    Obstacle(name="wall", shape=Box(size_m=(0.1, 0.1, 2)), center_m=(5.3, 5.3, 1))
                ],
            },
            r"cable 0 is inside wall",
        ),
        (plant_of, {"events": (VehicleDies(vehicle=4, at_s=1.0),)}, r"no vehicle 4"),
        (plant_of, {"events": (VehicleDies(vehicle=1, at_progress=0.5),)}, r"at_progress"),
    ]
    for build, arguments, message in cases:
        with pytest.raises(ConfigError, match=message) as caught:
            build(**arguments)
        assert "\n" not in str(caught.value)
