# SPDX-License-Identifier: Apache-2.0
"""The world as cameras see it: built once per scenario, posed from a truth each time.

Objects are what has a name: the six faces of the room, the obstacles, the payload, the vehicles,
the cables, in this order. An object's index is the id in images and labels; what is no object is
`SKY`. Objects but the room consist of parts: boxes, spheres, capsules and threads, which are
capsules so thin that a pixel sees past them (cables).
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.geometry.shapes import BOX, CAPSULE, SPHERE, ShapeArrays, pose_shapes
from skyhaul.model.team import Team
from skyhaul.plant.api import Truth
from skyhaul.sensors.api import TagCalibration
from skyhaul.sensors.imaging.arrays import (
    ROOM_FACES,
    THREAD,
    Balls,
    Hall,
    Objects,
    Parts,
    SceneArrays,
)
from skyhaul.sensors.imaging.materials import Materials, make_materials
from skyhaul.sensors.imaging.plate import tag_on
from skyhaul.sensors.imaging.pose import pose_cables, pose_object, pose_parts
from skyhaul.types import Array, IntArray
from skyhaul.world.scenario import World

ObjectKind = Literal["room", "static", "mover", "payload", "vehicle", "cable"]


GRAIN_PER_M = 1.7
"""Periods of the grain on the room's faces per metre."""


@dataclass(frozen=True, eq=False)
class Scene:
    """The world as cameras see it; `pose` moves it in place."""

    names: tuple[str, ...]  # of each object
    kinds: tuple[ObjectKind, ...]
    arrays: SceneArrays
    hooks_L: Array  # (n, 3) [m]
    tag: TagCalibration | None  # on the load

    @property
    def first_vehicle(self) -> int:
        """Object id of vehicle 0; vehicle i is i more, cable i as many again as there are."""
        return self.kinds.index("vehicle")

    def vehicle_id(self, i: int) -> int:
        """Object id of vehicle i."""
        return self.first_vehicle + i

    def pose(self, truth: Truth) -> None:
        """Move everything to where it is in truth."""
        objects, first = self.arrays.objects, len(ROOM_FACES)
        m, n = len(truth.present), truth.team.n
        there = slice(first, first + m)
        objects.present[there] = truth.present
        objects.p_WO[there], objects.R_WO[there] = truth.obstacles.p_WO, truth.obstacles.R_WO
        objects.v_WO[there] = truth.v_WO
        team, load = truth.team, first + m
        pose_object(objects, load, team.p_WL, team.q_WL, team.v_WL, team.w_WL_L)
        for i in range(n):
            row = load + 1 + i
            pose_object(objects, row, team.p_WB[i], team.q_WB[i], team.v_WB[i], team.w_WB_B[i])
        objects.present[load + 1 + n :] = truth.attached
        pose_cables(objects, self.arrays.parts, load, self.hooks_L)
        pose_parts(self.arrays.parts, objects, self.arrays.balls)


def build_scene(team: Team, world: World, seed: int = 0) -> Scene:
    """The scene of a scenario, everything at its place of rest; `Scene.pose` moves it.

    Args:
        team: Its vehicles, cables and load.
        world: Room and obstacles.
        seed: Draws the textures.
    """
    names, kinds = object_names(team, world)
    x, y = team.payload.size_m[:2] if team.payload.kind == "rigid" else (1.0, 1.0)
    materials = make_materials(world.room, (x, y), seed)
    parts = _parts(team, world, materials)
    arrays = SceneArrays(
        parts, _objects(len(kinds), world), _balls(parts), _hall(world, materials),
        materials.atlas, np.array([-0.3, 0.25, 0.92]) / np.linalg.norm([-0.3, 0.25, 0.92]),
    )  # fmt: skip
    pose_parts(arrays.parts, arrays.objects, arrays.balls)
    hooks_L = np.ascontiguousarray(team.hooks_L())
    return Scene(names, kinds, arrays, hooks_L, tag_on(team.payload))


def object_names(team: Team, world: World) -> tuple[tuple[str, ...], tuple[ObjectKind, ...]]:
    """Name and kind of every object of a scenario's scene, by its id."""
    names: list[str] = list(ROOM_FACES)
    kinds: list[ObjectKind] = ["room"] * len(ROOM_FACES)
    for o in world.obstacles:
        names.append(o.name)
        kinds.append("static" if o.motion.kind == "static" else "mover")
    names += ["payload", *(f"vehicle {i}" for i in range(team.count))]
    names += [f"cable {i}" for i in range(team.count)]
    kinds += ["payload", *["vehicle"] * team.count, *["cable"] * team.count]  # type: ignore[list-item]
    return tuple(names), tuple(kinds)


class _Row(NamedTuple):
    """One part before it is in the table."""

    kind: int
    object: int
    size: tuple[float, float, float]
    p_OP: tuple[float, float, float]
    R_OP: Array
    face: IntArray
    period: float
    gain: float


def _parts(team: Team, world: World, materials: Materials) -> Parts:
    rows: list[_Row] = []
    first = len(ROOM_FACES)
    shapes = pose_shapes([o.shape for o in world.obstacles], np.zeros((len(world.obstacles), 3)))
    origin, level = (0.0, 0.0, 0.0), np.eye(3)
    for j, kind in enumerate(shapes.kind.tolist()):
        a, b, c = shapes.size[j].tolist()
        face, period = materials.obstacle_faces(j), _obstacle_period(shapes, j)
        rows.append(_Row(kind, first + j, (a, b, c), origin, level, face, period, 1.0))
    load = first + len(world.obstacles)
    rows.append(_payload(team, load, materials))
    for i in range(team.count):
        rows += _vehicle(team, load + 1 + i, materials.vehicle_faces(i))
    for i, length in enumerate(team.cable_lengths_m()):
        size = (team.cable_radius_m, 0.5 * float(length), 0.0)
        face, row = materials.plain_faces(), load + 1 + team.count + i
        rows.append(_Row(THREAD, row, size, origin, level, face, 1.0, 0.12))
    k = len(rows)
    return Parts(
        kind=np.array([r.kind for r in rows], dtype=np.int64),
        object=np.array([r.object for r in rows], dtype=np.int64),
        size=np.array([r.size for r in rows], dtype=np.float64),
        p_OP=np.array([r.p_OP for r in rows], dtype=np.float64),
        R_OP=np.array([r.R_OP for r in rows]),
        face=np.array([r.face for r in rows], dtype=np.int64),
        period=np.array([r.period for r in rows], dtype=np.float64),
        gain=np.array([r.gain for r in rows], dtype=np.float64),
        p_WP=np.zeros((k, 3)),
        R_WP=np.zeros((k, 3, 3)),
    )


def _obstacle_period(shapes: ShapeArrays, j: int) -> float:
    """Whole periods span a box about once per 0.6 m; a ball carries one on each of six sides."""
    size = shapes.size[j]
    if shapes.kind[j] == BOX:
        edge = 2.0 * float(np.median(size))
        return edge / max(1.0, round(edge / 0.6))
    return 2.0 * float(size[0])


def _payload(team: Team, row: int, materials: Materials) -> _Row:
    origin, level = (0.0, 0.0, 0.0), np.eye(3)
    payload = team.payload
    if payload.kind == "point":
        size = (payload.radius_m, 0.0, 0.0)
        face = materials.plain_faces()
        return _Row(SPHERE, row, size, origin, level, face, 2.0 * payload.radius_m, 0.6)
    x, y, z = payload.size_m
    face = materials.payload_faces()
    return _Row(BOX, row, (0.5 * x, 0.5 * y, 0.5 * z), origin, level, face, max(x, y), 1.0)


def _vehicle(team: Team, row: int, face: IntArray) -> list[_Row]:
    """A body, two crossed arms, four motors."""
    v, level, rows = team.vehicle, np.eye(3), []
    body = (0.45 * v.arm_m, 0.35 * v.arm_m, 0.6 * v.half_height_m)
    rows.append(_Row(BOX, row, body, (0.0, 0.0, 0.0), level, face, 0.9 * v.arm_m, 1.0))
    for sign in (1.0, -1.0):
        z = np.array([1.0, sign, 0.0]) / np.sqrt(2.0)
        R = np.column_stack([np.cross(z, [0.0, 0.0, 1.0]), [0.0, 0.0, 1.0], z])
        size = (0.07 * v.arm_m, v.arm_m, 0.0)
        rows.append(_Row(CAPSULE, row, size, (0.0, 0.0, 0.0), R, face, v.arm_m, 0.5))
    for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        p = (x * v.arm_m / np.sqrt(2.0), y * v.arm_m / np.sqrt(2.0), 0.2 * v.half_height_m)
        size = (0.14 * v.arm_m, 0.4 * v.half_height_m, 0.0)
        rows.append(_Row(CAPSULE, row, size, p, level, face, 0.4 * v.arm_m, 0.8))
    return rows


def _objects(m: int, world: World) -> Objects:
    """Obstacles at their own places, everything else at the origin."""
    p = np.zeros((m, 3))
    R = np.tile(np.eye(3), (m, 1, 1))
    first, k = len(ROOM_FACES), len(world.obstacles)
    shapes = pose_shapes(
        [o.shape for o in world.obstacles], np.array([o.center_m for o in world.obstacles])
    )
    p[first : first + k], R[first : first + k] = shapes.p_WO, shapes.R_WO
    return Objects(np.ones(m, dtype=np.bool_), p, R, np.zeros((m, 3)), np.zeros((m, 3)))


def _balls(parts: Parts) -> Balls:
    """One ball around a box or sphere; a string of them along a capsule."""
    part, along, share = [], [], []
    for k, kind in enumerate(parts.kind.tolist()):
        count = 1
        if kind in (CAPSULE, THREAD):
            radius, half = parts.size[k, :2]
            count = int(np.clip(np.ceil(half / (radius + 0.03)), 1, 12))
        part += [k] * count
        along += [(2.0 * i + 1.0) / count - 1.0 for i in range(count)]
        share += [1.0 / count] * count
    b = len(part)
    return Balls(
        np.array(part, dtype=np.int64), np.array(along), np.array(share),
        np.zeros((b, 3)), np.zeros(b),
    )  # fmt: skip


def _hall(world: World, materials: Materials) -> Hall:
    return Hall(
        low=np.array(world.room.min_m, dtype=np.float64),
        high=np.array(world.room.max_m, dtype=np.float64),
        face=materials.room_faces,
        period=materials.room_periods,
        light=np.array([0.86, 0.94, 0.98, 0.82, 1.05, 0.72]),
        opening=materials.opening,
        detail=materials.detail,
        detail_per_m=GRAIN_PER_M,
        clouds=materials.clouds,
    )
