# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo model of a scenario.

The load and every vehicle are free bodies (a point-mass load has three slides: it does not turn),
each cable is a spatial tendon from hook to vehicle that pulls when it is longer than the cable,
each obstacle is a mocap body, the room is six planes. Frames sit at centres of mass.

A tendon at its limit is a soft constraint with time constant `SOLREF[0]`, critically damped. This
sets how hard a slack cable jerks taut: a load that falls 0.15 m into the four slack cables of a
hovering team meets 16 N in each (25 N with 4 ms, 9 N with 20 ms). State it with any snap tension.
"""

import mujoco
import numpy as np

from skyhaul.geometry.shapes import BOX, CAPSULE, SPHERE, ShapeArrays
from skyhaul.model.dynamics import vehicle_motion
from skyhaul.model.state import TautState
from skyhaul.model.team import Team, TeamArrays
from skyhaul.plant.api import PLANT_STEP_US
from skyhaul.plant.start import StartState
from skyhaul.types import GRAVITY_MPS2, US_PER_S, Array
from skyhaul.world.scenario import Room

SOLREF = (0.01, 1.0)
"""Time constant [s] and damping ratio of a cable at its limit."""
SOLIMP = (0.99, 0.99, 0.001, 0.5, 2.0)
"""Impedance of a cable at its limit: 1 would be rigid."""
OPEN_M = 1e4
"""Length limit of the tendon of an open hook [m]."""
NOWHERE = (0.0, 0.0, -1e3)
"""Place of obstacles that are not there yet [m]."""
TEAM_BIT, WORLD_BIT = 1, 2

_OFF = mujoco.mjtDisableBit
_NOT_NEEDED = (_OFF.mjDSBL_AUTORESET, _OFF.mjDSBL_MIDPHASE, _OFF.mjDSBL_ISLAND)
"""A divergence shall be seen; no body has many geoms; the cables make the team one island."""

_GEOM = {
    SPHERE: mujoco.mjtGeom.mjGEOM_SPHERE,
    BOX: mujoco.mjtGeom.mjGEOM_BOX,
    CAPSULE: mujoco.mjtGeom.mjGEOM_CAPSULE,
}


def build_model(
    team: Team, room: Room, obstacles: ShapeArrays, names: tuple[str, ...]
) -> mujoco.MjModel:
    """Compile the model.

    Bodies: world, payload, vehicles 0 .. n-1, obstacles 0 .. m-1. Controls: thrust along z_B of
    each vehicle, n. Linear drag is damping of the bodies' translation; body moments and the force
    of the moving air come as forces on the joints, which is cheaper than as controls.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = PLANT_STEP_US / US_PER_S
    spec.option.gravity = (0.0, 0.0, -GRAVITY_MPS2)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    for flag in _NOT_NEEDED:
        spec.option.disableflags |= int(flag)
    _add_room(spec, room)
    _add_payload(spec, team)
    for i in range(team.count):
        _add_vehicle(spec, team, i)
        _add_cable(spec, team, i)
    for j, name in enumerate(names):
        _add_obstacle(spec, obstacles, j, f"obstacle {name}")
    model = spec.compile()
    _set_drag(model, team)
    return model


def _add_room(spec: mujoco.MjSpec, room: Room) -> None:
    for k in range(3):
        for corner, sign in ((room.min_m, 1.0), (room.max_m, -1.0)):
            normal, place = np.zeros(3), np.zeros(3)
            normal[k], place[k], quat = sign, corner[k], np.empty(4)
            mujoco.mju_quatZ2Vec(quat, normal)
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_PLANE,
                size=(0.0, 0.0, 1.0),
                pos=place,
                quat=quat,
                contype=WORLD_BIT,
                conaffinity=0,
            )


def _add_payload(spec: mujoco.MjSpec, team: Team) -> None:
    payload = team.payload
    body = spec.worldbody.add_body(name="payload")
    if payload.kind == "rigid":
        body.add_freejoint()
        _set_mass(body, payload.mass_kg, payload.J_L)
        kind, size = mujoco.mjtGeom.mjGEOM_BOX, 0.5 * np.array(payload.size_m)
    else:
        for axis in np.eye(3):
            body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        _set_mass(body, payload.mass_kg, np.full(3, 0.4 * payload.mass_kg * payload.radius_m**2))
        kind, size = mujoco.mjtGeom.mjGEOM_SPHERE, np.array([payload.radius_m, 0.0, 0.0])
    body.add_geom(type=kind, size=size, contype=TEAM_BIT, conaffinity=TEAM_BIT | WORLD_BIT)
    for i, p_LA in enumerate(team.hooks_L()):
        body.add_site(name=f"hook {i}", pos=p_LA)


def _add_vehicle(spec: mujoco.MjSpec, team: Team, i: int) -> None:
    vehicle = team.vehicle
    body = spec.worldbody.add_body(name=f"vehicle {i}")
    body.add_freejoint()
    _set_mass(body, team.arrays().m_B[i], np.array(vehicle.inertia_kgm2))
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(vehicle.radius_m, vehicle.half_height_m, 0.0),
        contype=TEAM_BIT,
        conaffinity=TEAM_BIT | WORLD_BIT,
    )
    body.add_site(name=f"vehicle {i}")
    lift = (0, 0, 1, 0, 0, 0)
    spec.add_actuator(
        trntype=mujoco.mjtTrn.mjTRN_SITE, target=f"vehicle {i}", gear=lift
    ).set_to_motor()


def _add_cable(spec: mujoco.MjSpec, team: Team, i: int) -> None:
    tendon = spec.add_tendon(name=f"cable {i}")
    tendon.wrap_site(f"hook {i}")
    tendon.wrap_site(f"vehicle {i}")
    tendon.limited = True
    tendon.range = (0.0, team.cable_lengths_m()[i])
    tendon.solref_limit, tendon.solimp_limit = SOLREF, SOLIMP


def _add_obstacle(spec: mujoco.MjSpec, obstacles: ShapeArrays, j: int, name: str) -> None:
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(obstacles.R_WO[j]).ravel())
    body = spec.worldbody.add_body(name=name, mocap=True, pos=obstacles.p_WO[j], quat=quat)
    body.add_geom(
        type=_GEOM[int(obstacles.kind[j])],
        size=obstacles.size[j],
        contype=WORLD_BIT,
        conaffinity=0,
    )


def _set_mass(body: mujoco.MjsBody, mass: float, inertia: Array) -> None:
    body.mass, body.inertia, body.ipos = mass, inertia, np.zeros(3)
    body.explicitinertial = True


def _set_drag(model: mujoco.MjModel, team: Team) -> None:
    """Damp translations only: a free joint's own damping would hold rotations too."""
    model.dof_damping[:3] = team.payload.drag_ns_per_m
    first = 6 if team.payload.kind == "rigid" else 3
    for i in range(team.count):
        model.dof_damping[first + 6 * i : first + 6 * i + 3] = team.vehicle.drag_ns_per_m


def place(model: mujoco.MjModel, data: mujoco.MjData, start: StartState) -> None:
    """Put everything where it starts, at rest; vehicles' moments 0, the wind as it is."""
    load = [start.p_WL, start.q_WL] if model.nv == 6 * (1 + len(start.p_WB)) else [start.p_WL]
    data.qpos[:] = np.concatenate([*load, np.column_stack([start.p_WB, start.q_WB]).ravel()])
    data.qfrc_applied[-6 * len(start.p_WB) :].reshape(-1, 6)[:, 3:] = 0.0
    data.ctrl[:] = start.rotor_thrust.sum(axis=1)
    mujoco.mj_forward(model, data)


def set_taut_state(
    model: mujoco.MjModel, data: mujoco.MjData, team: TeamArrays, state: TautState
) -> None:
    """Write a taut state into qpos and qvel."""
    p_WB, v_WB = vehicle_motion(team, state)
    q, w = ([state.q_WL], [state.w_WL_L]) if team.rigid else ([], [])
    poses, rates = np.column_stack([p_WB, state.q_WB]), np.column_stack([v_WB, state.w_WB_B])
    data.qpos[:] = np.concatenate([state.p_WL, *q, poses.ravel()])
    data.qvel[:] = np.concatenate([state.v_WL, *w, rates.ravel()])
    data.qacc_warmstart[:] = 0.0


def relax(model: mujoco.MjModel, data: mujoco.MjData, start: StartState) -> None:
    """From the places of the start to equilibrium with soft cables and floor, still time 0.

    Cables in the air are stretched by what their tension asks (some 0.01 mm). On the ground the
    bodies sink into the floor (some 0.1 mm).
    """
    if start.airborne:
        _stretch(model, data, start)
    else:
        _settle(model, data)
    mujoco.mj_forward(model, data)


def _settle(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    for _ in range(250):
        mujoco.mj_step(model, data)
    data.qvel[:], data.qacc_warmstart[:], data.time = 0.0, 0.0, 0.0


def _stretch(model: mujoco.MjModel, data: mujoco.MjData, start: StartState) -> None:
    """Move the vehicles outward until the cables' constraint carries the wanted tension at rest.

    At rest the constraint force is k r / R (stiffness, stretch, regularisation): MuJoCo manual,
    "Computation", solver parameters.
    """
    n = len(start.p_WB)
    vehicles = data.qpos[-7 * n :].reshape(n, 7)
    length, stretch = model.tendon_range[:, 1], np.full(n, 1e-6)
    for _ in range(8):
        mujoco.mj_kinematics(model, data)
        for i in range(n):
            hook, center = data.site(f"hook {i}").xpos, vehicles[i, :3]
            out = (center - hook) / np.linalg.norm(center - hook)
            vehicles[i, :3] = hook + (length[i] + stretch[i]) * out
        mujoco.mj_forward(model, data)
        rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON
        stiffness, weight = data.efc_KBIP[rows, 0], data.efc_D[rows]
        stretch[data.efc_id[rows]] = start.tension[data.efc_id[rows]] / (stiffness * weight)
