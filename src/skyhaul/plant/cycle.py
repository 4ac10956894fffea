# SPDX-License-Identifier: Apache-2.0
"""What a step of the plant computes beside MuJoCo, as three calls into compiled code.

NamedTuples come as plain tuples of their fields (`Leaves`), which cross the border in a third of
the time.
"""

from typing import Any

import numpy as np

from skyhaul.geometry.shapes import ShapeArrays
from skyhaul.jit import njit
from skyhaul.model.team import TeamArrays
from skyhaul.plant.clearance import Surroundings, TouchMemory, update_touches
from skyhaul.plant.observe import (
    Constraints,
    Observation,
    fastest,
    observe,
    place_obstacles,
    write_forces,
)
from skyhaul.plant.rotors import rotor_lag
from skyhaul.types import Array, Mask
from skyhaul.world.motion import MotionTable, motion_state

Leaves = tuple[Any, ...]

ALONE_M, FASTEST_MPS, JUMP_M = 0.2, 20.0, 0.02
"""Two bodies that are farther apart than this [m], no faster than this along any axis [m/s], do
not meet within a step, nor an obstacle that goes no farther than this along any axis in it [m]."""


@njit
def drive(
    team: Leaves,
    inputs: tuple[Array, Array],
    constants: tuple[Array, Array],
    now: tuple[Array, Mask, Array],
    thrust: Array,
    dt: float,
) -> None:
    """Rotors over the next dt, and their forces into MuJoCo: `rotor_lag`, then `write_forces`.

    Args:
        team: Leaves of `TeamArrays`.
        inputs: MuJoCo's controls and forces on the joints, written.
        constants: Mixer and drag.
        now: Commanded thrusts (n, 4) [N], who is alive (n,), wind (3,) [m/s].
        thrust: Thrusts, (n, 4) [N]; from now to dt later.
        dt: Time to advance [s].
    """
    command, alive, wind = now
    mean = np.empty_like(thrust)
    rotor_lag(TeamArrays(*team), alive, command, dt, thrust, mean)
    write_forces(inputs[0], inputs[1], constants[0], mean, wind, constants[1])


@njit
def move(table: Leaves, t: float, present: Mask, mocap: Array, p_WO: Array, v_WO: Array) -> float:
    """Obstacles to where they are at time t [s]: into MuJoCo, and their motion into p_WO, v_WO.

    Args:
        table: Leaves of `MotionTable`.
        t: Time [s].
        present: Which of them exist, (m,).
        mocap: MuJoCo's places, written.
        p_WO: (m, 3) [m], written.
        v_WO: (m, 3) [m/s], written.

    Returns:
        See `place_obstacles`.
    """
    motion_state(MotionTable(*table), t, p_WO, v_WO)
    return place_obstacles(mocap, p_WO, present)


@njit
def look(
    team: Leaves,
    motion: tuple[Array, Array, Array],
    rows: Leaves,
    bodies: Leaves,
    out: Leaves,
    attached: Mask,
    obstacles: Leaves,
    around: Leaves,
    touches: Leaves,
) -> tuple[bool, float, int, bool]:
    """Read MuJoCo out, then find what touches: `observe` and `update_touches`.

    Args:
        team: Leaves of `TeamArrays`.
        motion: MuJoCo's qpos, qvel, qacc.
        rows: Leaves of `Constraints`.
        bodies: Leaves of the team's `ShapeArrays`.
        out: Leaves of `Observation`, written.
        attached: Cables that are attached, (n,).
        obstacles: Leaves of their `ShapeArrays`.
        around: Leaves of the rest of `Surroundings`.
        touches: Leaves of `TouchMemory`, updated.

    Returns:
        Whether the accelerations are finite; clearance [m]; how many contacts began; whether
        payload and vehicles are so far from everything that the next step makes no contact.
    """
    shapes = ShapeArrays(*bodies)
    qpos, qvel, qacc = motion
    finite = observe(
        TeamArrays(*team), qpos, qvel, qacc, Constraints(*rows), shapes, Observation(*out)
    )
    surroundings = Surroundings(ShapeArrays(*obstacles), *around)
    clearance, begun, gap = update_touches(shapes, attached, surroundings, TouchMemory(*touches))
    alone = gap > ALONE_M and fastest(qvel, TeamArrays(*team).rigid) < FASTEST_MPS
    return finite, clearance, begun, alone
