# SPDX-License-Identifier: Apache-2.0
"""Claim: one plant step, clearance and truth included, takes at most 150 us of one core.

Four vehicles hover among 0 to 20 obstacles that move; CPU time, with a calibration loop timed in
the same run (5e6 iterations of pure Python).
"""

import json

import numpy as np
from provenance import provenance, write_report
from timing import REPEATS, cpu_us

from skyhaul.geometry.distance import bounding_radius
from skyhaul.geometry.shapes import Box, Capsule, Shape, Sphere, pose_shapes
from skyhaul.model.formation import hover_state
from skyhaul.model.team import Team
from skyhaul.plant.clearance import Surroundings, touch_memory, update_touches
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.plant.observe import Constraints, observation, observe, team_bodies
from skyhaul.types import Array
from skyhaul.world.obstacles import CyclicPath, Obstacle
from skyhaul.world.scenario import AirStart, HoverTask, Scenario, World

START = np.array([5.0, 5.0, 5.0])


def obstacles(count: int, seed: int) -> tuple[Obstacle, ...]:
    """Movers of all shapes, 2 to 6 m from the team, that run small rounds."""
    rng = np.random.default_rng(seed)
    shapes: list[Shape] = [
        Sphere(radius_m=0.3),
        Box(size_m=(0.4, 0.5, 1.5), yaw_deg=20.0),
        Capsule(radius_m=0.2, length_m=1.0, axis=(1.0, 0.3, 0.5)),
    ]
    out = []
    for j in range(count):
        u = rng.normal(size=3)
        p = START + u / np.linalg.norm(u) * rng.uniform(2.0, 6.0)
        corners = tuple(tuple(float(x) for x in p + 0.3 * rng.normal(size=3)) for _ in range(3))
        motion = CyclicPath(points_m=corners, speed_mps=0.5)
        place = (float(p[0]), float(p[1]), float(p[2]))
        out.append(Obstacle(name=f"o{j}", shape=shapes[j % 3], center_m=place, motion=motion))
    return tuple(out)


def step_us(count: int) -> dict[str, float]:
    """One step of the plant among `count` obstacles, the team hovering."""
    start = AirStart(payload_m=(5.0, 5.0, 5.0))
    world = World(obstacles=obstacles(count, 0))
    plant = MujocoPlant(Scenario(world=world, start=start, task=HoverTask()), 0)
    rotors: Array = plant.truth().rotor_thrust
    return cpu_us(lambda: plant.step(rotors), 1000)


def clearance_us(count: int) -> dict[str, float]:
    """Only the clearance and contacts of nine bodies to `count` obstacles."""
    team = Team()
    movers = obstacles(count, 0)
    field = pose_shapes([o.shape for o in movers], np.array([o.center_m for o in movers]))
    reach = np.array([bounding_radius(field, j) for j in range(count)])
    around = Surroundings(
        field, reach, np.ones(count, dtype=np.bool_), np.zeros(3), np.full(3, 20.0)
    )
    bodies, memory = team_bodies(team), touch_memory(4, count)
    nothing = np.zeros(0, dtype=np.int32)
    rest = hover_state(team, START)
    plant = MujocoPlant(Scenario(start=AirStart(payload_m=(5.0, 5.0, 5.0)), task=HoverTask()), 0)
    s = plant.truth().team
    poses = np.column_stack([s.p_WB, s.q_WB])
    qpos = np.concatenate([rest.p_WL, rest.q_WL, poses.ravel()])
    zero = np.zeros(30)
    rows = Constraints(nothing, nothing, np.zeros(0))
    observe(team.arrays(), qpos, zero, zero, rows, bodies, observation(4))
    attached = np.ones(4, dtype=np.bool_)
    return cpu_us(lambda: update_touches(bodies, attached, around, memory), 5000)


def main() -> None:
    """Time everything and write the result."""
    steps = {m: step_us(m) for m in (0, 6, 20)}
    report = {
        "claim": "one plant step of 4 vehicles, truth and clearance included: <= 150 us CPU",
        "rows": [
            {
                "measure": "plant step, 4 vehicles, 20 movers, clearance and truth included",
                "value": steps[20]["median"],
                "unit": "us CPU",
                "bar": "<= 150",
            }
        ],
        "step_us": steps,
        "clearance_us": {m: clearance_us(m) for m in (6, 20)},
        "repeats": REPEATS,
        **provenance(),
    }
    write_report("plant_speed", report)
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
