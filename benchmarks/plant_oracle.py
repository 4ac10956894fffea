# SPDX-License-Identifier: Apache-2.0
"""Claim: the plant follows the exact taut dynamics within 0.5 mm over 5 s and keeps its energy.

Free swing: thrusts held at hover, load and cables start with random velocities. Driven: from
rest, thrusts and moments vary. Both without drag, wind and motor lag: then `model.step` is exact.
"""

from dataclasses import replace
from functools import cache
from typing import Any

import mujoco
import numpy as np
from provenance import provenance, write_report

from skyhaul.geometry.quaternion import quat_conj, quat_log, quat_mul
from skyhaul.geometry.shapes import pose_shapes
from skyhaul.model.dynamics import vehicle_motion
from skyhaul.model.formation import hover_state, hover_wrenches
from skyhaul.model.mixer import rotors_to_wrench, wrench_to_rotors
from skyhaul.model.state import TautState
from skyhaul.model.step import step
from skyhaul.model.team import PointPayload, RigidPayload, Team, Vehicle
from skyhaul.plant.build import SOLIMP, SOLREF, build_model, place
from skyhaul.plant.mujoco_plant import STEP_S, MujocoPlant
from skyhaul.plant.start import start_state
from skyhaul.types import Array
from skyhaul.world.scenario import AirStart, HoverTask, Room, Scenario, World

DURATION_S = 5.0
START = np.array([0.0, 0.0, 20.0])
SEEDS = range(5)


def ideal_team(n: int, rigid: bool) -> Team:
    """A team whose rotors have no lag and whose bodies no drag."""
    payload = RigidPayload(drag_ns_per_m=0.0) if rigid else PointPayload(drag_ns_per_m=0.0)
    return Team(count=n, vehicle=Vehicle(motor_lag_s=0.0, drag_ns_per_m=0.0), payload=payload)


def swinging(team: Team, seed: int) -> TautState:
    """Hover formation with random velocities of load and cables."""
    rng = np.random.default_rng(seed)
    rest = _rest(team)
    rigid = team.payload.kind == "rigid"
    rate = 0.5 if rigid else 0.2  # the vehicles over a point mass fly closer together
    w = rng.uniform(-rate, rate, (team.count, 3))
    along = np.sum(w * rest.cable_dir_W, axis=1, keepdims=True)
    return replace(
        rest,
        v_WL=rng.uniform(-0.5, 0.5, 3),
        w_WL_L=rng.uniform(-0.5, 0.5, 3) if rigid else np.zeros(3),
        cable_w_W=w - along * rest.cable_dir_W,
    )


@cache
def _rest(team: Team) -> TautState:
    """Hover at the start."""
    return hover_state(team, START)


def wrenches_at(team: Team, state: TautState, t: float, driven: bool, seed: int) -> Array:
    """Thrusts and moments of the vehicles at a state of the oracle, (n, 4)."""
    wrench = hover_wrenches(team)
    if driven:
        phase = np.random.default_rng([seed, 1]).uniform(0.0, 6.28, (team.count, 4))
        wave = np.sin(2.0 * np.pi * np.array([0.7, 1.0, 1.3, 0.9]) * t + phase)
        wrench = wrench + np.array([0.2, 5e-3, 5e-3, 5e-3]) * wave
        turned = quat_log(quat_mul(quat_conj(_rest(team).q_WB), state.q_WB))
        p_WB, v_WB = vehicle_motion(team, state)
        climb = p_WB[:, 2] - vehicle_motion(team, _rest(team))[0][:, 2]
        wrench[:, 0] -= 2.0 * climb + 1.0 * v_WB[:, 2]
        wrench[:, 1:] -= 0.05 * turned + 0.01 * state.w_WB_B  # holds the vehicles near hover
    return wrench


def fly(n: int, rigid: bool, driven: bool, seed: int) -> dict[str, float]:
    """One flight of plant and oracle side by side."""
    team = ideal_team(n, rigid)
    room = Room(min_m=(-50.0, -50.0, 0.0), max_m=(50.0, 50.0, 100.0))
    start = AirStart(payload_m=(0.0, 0.0, float(START[2])))
    plant = MujocoPlant(
        Scenario(team=team, world=World(room=room), start=start, task=HoverTask()), 0
    )
    exact = _rest(team) if driven else swinging(team, seed)
    rotors = wrench_to_rotors(team, wrenches_at(team, exact, 0.0, driven, seed))
    truth = plant.set_taut(exact, rotors)
    force_W = rotation_z_axes(truth.team.q_WB) * rotors.sum(axis=1)[:, None]
    worst, slackest, energies, kinetic = 0.0, np.inf, [], []
    for k in range(round(DURATION_S / STEP_S)):
        rotors = wrench_to_rotors(team, wrenches_at(team, exact, k * STEP_S, driven, seed))
        truth = plant.step(rotors)
        exact = step(team, exact, rotors_to_wrench(team, rotors), STEP_S)
        worst = max(worst, float(np.linalg.norm(truth.team.p_WL - exact.p_WL)))
        if truth.contacts:
            raise RuntimeError(f"bodies touch: choose calmer motion: {truth.contacts}")
        if truth.cables.tension.min() == 0.0:
            raise RuntimeError("a cable is slack: the oracle does not hold; choose calmer motion")
        slackest = min(slackest, float(truth.cables.tension.min()))
        moving, total = plant_energy(team, truth.team, force_W)
        energies.append(total)
        kinetic.append(moving)
    result = {"payload_difference_mm": 1e3 * worst, "min_tension_n": slackest}
    if not driven:
        drift = np.max(np.abs(np.array(energies) - energies[0])) / max(kinetic)
        result["energy_drift_percent"] = 100.0 * float(drift)
    return result


def rotation_z_axes(q_WB: Array) -> Array:
    """Body z axes in W, (n, 4) -> (n, 3)."""
    w, x, y, z = q_WB.T
    return np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def plant_energy(team: Team, state, force_W: Array) -> tuple[float, float]:  # noqa: ANN001
    """Kinetic energy, and total energy with the potential of constant thrusts [J]."""
    a = team.arrays()
    turning = np.sum(a.J_B * state.w_WB_B**2)
    turning += np.sum(a.J_L * state.w_WL_L**2) if a.rigid else 0.0
    moving = a.m_L * np.sum(state.v_WL**2) + np.sum(a.m_B[:, None] * state.v_WB**2)
    kinetic = 0.5 * (moving + turning)
    height = a.m_L * state.p_WL[2] + np.sum(a.m_B * state.p_WB[:, 2])
    return float(kinetic), float(kinetic + a.g * height - np.sum(force_W * state.p_WB))


def main() -> None:
    """Fly all cases and write the result."""
    cases = {}
    for n, rigid, driven in (
        (3, True, False),
        (4, True, False),
        (4, False, False),
        (3, True, True),
        (4, True, True),
        (4, False, True),
    ):
        name = f"{'driven' if driven else 'free'}_{n}_{'rigid' if rigid else 'point'}"
        runs = [fly(n, rigid, driven, seed) for seed in SEEDS]
        keys = runs[0].keys()
        cases[name] = {
            k: {"median": float(np.median([r[k] for r in runs])), "worst": worst_of(k, runs)}
            for k in keys
        }
        print(name, {k: v["worst"] for k, v in cases[name].items()})
    report = {
        "claim": "plant vs exact taut dynamics over 5 s: <= 0.5 mm payload, energy < 0.5 %",
        "rows": rows(cases),
        "duration_s": DURATION_S,
        "step_s": STEP_S,
        "solref": SOLREF,
        "solimp": SOLIMP,
        "seeds": list(SEEDS),
        "cases": cases,
        "snap_tension_n_after_0.15_m": {n: snap_tension(n, 0.15) for n in (3, 4)},
        **provenance(),
    }
    write_report("plant_oracle", report)


def snap_tension(n: int, drop_m: float) -> float:
    """Largest tension when the load falls into slack cables of a hovering team [N]."""
    scenario = Scenario(team=ideal_team(n, rigid=True), start=AirStart(payload_m=(5.0, 5.0, 5.0)))
    start = start_state(scenario)
    nothing = pose_shapes([], np.zeros((0, 3)))
    model = build_model(scenario.team, scenario.world.room, nothing, ())
    data = mujoco.MjData(model)
    place(model, data, start)
    data.qpos[2] += drop_m
    largest = 0.0
    for _ in range(300):
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        cables = data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON
        largest = max(largest, float(np.max(data.efc_force[cables], initial=0.0)))
    return largest


def rows(cases: dict[str, Any]) -> list[dict[str, object]]:
    """Rows of the README's table: the worst of all seeds and teams."""

    def worst(key: str, kind: str) -> float:
        return max(float(c[key]["worst"]) for name, c in cases.items() if name.startswith(kind))

    mm, energy = "payload_difference_mm", "energy_drift_percent"
    return [
        {
            "measure": f"plant vs `model.step`, 5 s {text}: largest payload difference",
            "value": worst(mm, kind),
            "unit": "mm",
            "bar": "<= 0.5",
        }
        for kind, text in (("free", "free swing"), ("driven", "driven"))
    ] + [
        {
            "measure": "the same, free swing: energy drift, of the largest kinetic energy",
            "value": worst(energy, "free"),
            "unit": "%",
            "bar": "< 0.5",
        }
    ]


def worst_of(key: str, runs: list[dict[str, float]]) -> float:
    """Largest, or for the tension smallest, value over the seeds."""
    values = [r[key] for r in runs]
    return min(values) if key == "min_tension_n" else max(values)


if __name__ == "__main__":
    main()
