# SPDX-License-Identifier: Apache-2.0
"""Leaves of ROS 2 messages (see `ros2.cdr`) from the objects of a flight."""

from functools import cache
from typing import Any

import numpy as np

from skyhaul.geometry.kernels import R_to_quat, quat_inv_rotate
from skyhaul.geometry.shapes import BOX, CAPSULE, SPHERE, Shape, shape_size
from skyhaul.jit import njit
from skyhaul.model.team import Team
from skyhaul.perception.api import Track
from skyhaul.types import US_PER_S, Array, Mask, TimeUs

Leaves = tuple[Any, ...]

FRAME = "world"
CUBE_MARKER, SPHERE_MARKER, CYLINDER_MARKER, LINE_LIST = 1, 2, 3, 5
"""Values of visualization_msgs/Marker.type."""

IDENTITY = (0.0, 0.0, 0.0, 1.0)
VEHICLE_COLORS = (
    (0.20, 0.47, 0.87), (0.91, 0.49, 0.14), (0.13, 0.62, 0.45), (0.78, 0.30, 0.58),
    (0.55, 0.41, 0.83), (0.67, 0.58, 0.13), (0.12, 0.65, 0.76), (0.85, 0.30, 0.30),
)  # fmt: skip
"""One colour per vehicle, the same in log, report, figures and video."""
LOAD_COLOR = (0.93, 0.74, 0.22)
STATIC_COLOR, MOVER_COLOR = (0.55, 0.58, 0.63), (0.84, 0.27, 0.27)


def stamp(t_us: TimeUs) -> tuple[int, int]:
    """builtin_interfaces/Time."""
    return t_us // US_PER_S, t_us % US_PER_S * 1000


def header(t_us: TimeUs, frame: str = FRAME) -> Leaves:
    """std_msgs/Header."""
    return t_us // US_PER_S, t_us % US_PER_S * 1000, frame


def pose(p: Array, q: Array) -> Leaves:
    """geometry_msgs/Pose or Transform; q is (w, x, y, z) here and (x, y, z, w) there."""
    x, y, z = p.tolist()
    qw, qx, qy, qz = q.tolist()
    return x, y, z, qx, qy, qz, qw


def odometry(t_us: TimeUs, child: str, body: Array, pose_cov: Array, twist_cov: Array) -> Leaves:
    """nav_msgs/Odometry of a body state (13,), layout of `types.LOAD_P`; its v in child axes."""
    return (
        *header(t_us), child, *pose(body[0:3], body[3:7]), pose_cov, *twist(body), twist_cov,
    )  # fmt: skip


def twist(body: Array) -> Leaves:
    """geometry_msgs/Twist of a body state (13,), in the body's axes."""
    return *quat_inv_rotate(body[3:7], body[7:10]), *body[10:13].tolist()


def poses_and_twists(bodies: Array) -> tuple[list[list[float]], list[list[float]]]:
    """What `pose` and `twist` give for each of some body states, (k, 13)."""
    out = np.empty_like(bodies)
    _reorder(bodies, out)
    rows = out.tolist()
    return [row[:7] for row in rows], [row[7:] for row in rows]


@njit
def _reorder(bodies: Array, out: Array) -> None:
    """Body states (k, 13) as x, y, z, qx, qy, qz, qw, then velocity and rate in body axes."""
    for k in range(bodies.shape[0]):
        b, o = bodies[k], out[k]
        o[0], o[1], o[2], o[3], o[4], o[5], o[6] = b[0], b[1], b[2], b[4], b[5], b[6], b[3]
        o[7], o[8], o[9] = quat_inv_rotate(b[3:7], b[7:10])
        o[10], o[11], o[12] = b[10], b[11], b[12]


def marker(
    t_us: TimeUs,
    ns: str,
    index: int,
    kind: int,
    at: Leaves,
    scale: tuple[float, ...],
    rgba: tuple[float, ...],
    points: tuple[tuple[float, ...], ...] = (),
    colors: tuple[tuple[float, ...], ...] = (),
) -> Leaves:
    """visualization_msgs/Marker that stays until it is replaced."""
    return (
        *header(t_us), ns, index, kind, 0, *at, *scale, *rgba, 0, 0, False, points, colors,
        "", *header(0, ""), "", (), (), "", "", "", (), False,
    )  # fmt: skip


def team_markers(t_us: TimeUs, team: Team, load: Array, p_WB: Array, q_WB: Array,
                 p_WA: Array, attached: Mask) -> Leaves:  # fmt: skip
    """Payload, vehicles and cables as one visualization_msgs/MarkerArray."""
    payload, vehicle = team.payload, team.vehicle
    out = []
    at = pose(load[0:3], load[3:7])
    if payload.kind == "rigid":
        out.append(marker(t_us, "payload", 0, CUBE_MARKER, at, payload.size_m, (*LOAD_COLOR, 1.0)))
    else:
        d = 2.0 * payload.radius_m
        out.append(marker(t_us, "payload", 0, SPHERE_MARKER, at, (d, d, d), (*LOAD_COLOR, 1.0)))
    size = (2.0 * vehicle.radius_m, 2.0 * vehicle.radius_m, 2.0 * vehicle.half_height_m)
    points: list[tuple[float, ...]] = []
    for i in range(len(p_WB)):
        color = (*VEHICLE_COLORS[i], 0.9)
        where = pose(p_WB[i], q_WB[i])
        out.append(marker(t_us, "vehicle", i, CYLINDER_MARKER, where, size, color))
        if attached[i]:
            points += [tuple(p_WA[i].tolist()), tuple(p_WB[i].tolist())]
    width = (max(2.0 * team.cable_radius_m, 0.005), 0.0, 0.0)
    origin = (0.0, 0.0, 0.0, *IDENTITY)
    line = (0.15, 0.15, 0.15, 1.0)
    out.append(marker(t_us, "cable", 0, LINE_LIST, origin, width, line, tuple(points)))
    return (out,)


@cache
def _posture(shape: Shape) -> tuple[int, Array, Array, Array]:
    """Kind, sizes, rotation and quaternion of a shape, which keeps them."""
    kind, size, R = shape_size(shape)
    return kind, size, R, np.array(R_to_quat(R))


def obstacle_markers(t_us: TimeUs, ns: str, index: int, shape: Shape, p: Array) -> list[Leaves]:
    """One obstacle; a capsule takes three markers, at `marker_places`."""
    kind, size, _, q = _posture(shape)
    rgba = (*(MOVER_COLOR if ns == "mover" else STATIC_COLOR), 0.9)
    d, length = 2.0 * float(size[0]), 2.0 * float(size[1])
    solids = {
        SPHERE: ((SPHERE_MARKER, (d, d, d)),),
        BOX: ((CUBE_MARKER, tuple((2.0 * size).tolist())),),
        CAPSULE: ((CYLINDER_MARKER, (d, d, length)), *(2 * [(SPHERE_MARKER, (d, d, d))])),
    }[kind]
    places = marker_places(shape, p)
    return [
        marker(t_us, ns, 3 * index + k, solid, pose(place, q), scale, rgba)
        for k, ((solid, scale), place) in enumerate(zip(solids, places, strict=True))
    ]


def marker_places(shape: Shape, p: Array) -> list[Array]:
    """Centres of an obstacle's markers, (3,) each: of a capsule also its two ends [m]."""
    kind, size, R, _ = _posture(shape)
    if kind != CAPSULE:
        return [p]
    return [p, *(p + s * float(size[1]) * R[:, 2] for s in (-1.0, 1.0))]


def room_marker(low: tuple[float, ...], high: tuple[float, ...]) -> Leaves:
    """Edges of the room as one marker."""
    corner = [low, high]
    points: list[tuple[float, ...]] = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for a in (0, 1):
            for b in (0, 1):
                for end in (0, 1):
                    p = [0.0, 0.0, 0.0]
                    p[axis], p[u], p[v] = corner[end][axis], corner[a][u], corner[b][v]
                    points.append(tuple(p))
    at = (0.0, 0.0, 0.0, *IDENTITY)
    rgba = (0.5, 0.5, 0.5, 1.0)
    return marker(0, "room", 0, LINE_LIST, at, (0.02, 0.0, 0.0), rgba, tuple(points))


def track(item: Track) -> Leaves:
    """skyhaul_msgs/Track."""
    kind, size, _ = shape_size(item.shape)
    name = {SPHERE: "sphere", BOX: "box", CAPSULE: "capsule"}[kind]
    return (
        *stamp(item.stamp_us), item.track_id, name, *size.tolist(),
        *pose(item.p_WO, np.array(R_to_quat(item.R_WO))), *item.v_WO.tolist(),
        item.covariance.ravel(), item.tube_base_m, item.growth_mps,
    )  # fmt: skip
