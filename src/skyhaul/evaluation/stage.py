# SPDX-License-Identifier: Apache-2.0
"""Draws a recorded flight at any time: room, obstacles, team, paths."""

from dataclasses import dataclass

import numpy as np

from skyhaul.evaluation import mesh
from skyhaul.evaluation.messages import LOAD_COLOR, MOVER_COLOR, STATIC_COLOR, VEHICLE_COLORS
from skyhaul.evaluation.raster import Camera, Image, draw_lines, draw_triangles, shade
from skyhaul.evaluation.series import Run
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.shapes import shape_size
from skyhaul.types import Array
from skyhaul.world.scenario import GoTo

Solid = tuple[mesh.Mesh, Array]
"""A mesh in place and its colour."""

SKY_TOP, SKY_BOTTOM = np.array([0.90, 0.93, 0.97]), np.array([0.97, 0.975, 0.985])
FLOOR, GRID = np.array([0.905, 0.92, 0.94]), np.array([0.80, 0.825, 0.86])
SHADOW, CABLE, BODY = np.full(3, 0.74), np.full(3, 0.2), np.full(3, 0.25)
EDGE, PLAN, GOAL = np.full(3, 0.66), np.array([0.20, 0.47, 0.87]), np.array([0.13, 0.62, 0.45])


@dataclass(frozen=True)
class Look:
    """What is drawn."""

    exposures: int = 1
    """How often the team is drawn along its way, the last time in full."""
    plan: bool = True
    """The reference in force."""
    line_px: float = 1.5
    """Width of thin lines [px]."""


class Stage:
    """A run, ready to be drawn."""

    def __init__(self, run: Run) -> None:
        self._run = run
        team, vehicle = run.scenario.team, run.scenario.team.vehicle
        size = [shape_size(o.shape) for o in run.scenario.world.obstacles]
        self._bodies = [mesh.solid(kind, s).placed(R, np.zeros(3)) for kind, s, R in size]
        payload = team.payload
        half = 0.5 * np.array(payload.size_m) if payload.kind == "rigid" else None
        radius = payload.radius_m if payload.kind == "point" else 0.0
        self._load = mesh.box(half) if half is not None else mesh.capsule(radius, 0.0)
        self._hub = mesh.cylinder(0.42 * vehicle.arm_m, 0.45 * vehicle.half_height_m, 12)
        self._rotor = mesh.cylinder(vehicle.rotor_radius_m, 0.003, 18)
        reach = vehicle.arm_m / np.sqrt(2.0)
        corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]], dtype=np.float64)
        self._rotors = np.column_stack([reach * corners, np.full(4, 0.6 * vehicle.half_height_m)])
        self._hooks = team.hooks_L()

    def overview(self, k: int | None = None) -> Camera:
        """A camera that sees the whole way, or that follows the load at row k."""
        way = self._run.series["load"][:, 0:3]
        direction = np.array([0.52, -0.76, 0.40])
        direction /= np.linalg.norm(direction)
        if k is not None:
            target = way[k] + np.array([0.0, 0.0, 0.45])
            return Camera(target + 5.0 * direction, target)
        low, high = way.min(axis=0) - 0.6, way.max(axis=0) + np.array([0.6, 0.6, 1.4])
        target, span = 0.5 * (low + high), float(np.linalg.norm(high - low))
        return Camera(target + 1.18 * max(3.0, span) * direction, target)

    def draw(self, k: int, camera: Camera, width: int, height: int, look: Look) -> Image:
        """The scene at row k."""
        image = Image.blank(width, height, SKY_TOP, SKY_BOTTOM)
        self._floor(image, camera, look)
        rows = [*self._spread(k, look.exposures - 1), k]
        solids = self._obstacles(k)
        for row in rows:
            solids += self._team(row)
        corners = np.concatenate([m.p for m, _ in solids])
        normals = np.concatenate([m.n for m, _ in solids])
        rgb = np.concatenate([np.broadcast_to(c, (len(m.p), 3)) for m, c in solids])
        flat = corners.copy()
        flat[:, :, 2] = 0.004
        opaque = np.ones(len(flat))
        draw_triangles(image, camera, flat, np.broadcast_to(SHADOW, flat.shape), opaque)
        draw_triangles(image, camera, corners, shade(normals, rgb, corners, camera.p_WC), opaque)
        for row in rows:
            self._cables(image, camera, row, look)
        self._paths(image, camera, k, look)
        self._glass(image, camera, rows)
        return image

    def _spread(self, k: int, count: int) -> list[int]:
        """Rows from lift-off on, before row k, evenly spread over the way of the load."""
        first = int(np.argmax(self._run.airborne)) if self._run.airborne.any() else 0
        way = self._run.series["load"][first : k + 1, 0:3]
        if not count or len(way) < 2:
            return []
        length = np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))
        at = np.arange(count) / count * length[-1]
        return [first + int(r) for r in np.searchsorted(length, at)]

    def _obstacles(self, k: int) -> list[Solid]:
        run, out = self._run, []
        movers = run.layout.movers
        for j, (body, o) in enumerate(zip(self._bodies, run.scenario.world.obstacles, strict=True)):
            if j not in movers:
                out.append((body.placed(np.eye(3), np.array(o.center_m)), np.array(STATIC_COLOR)))
            elif run.series["obstacle_present"][k, movers.index(j)] > 0.0:
                p = run.series["obstacle_p"][k, movers.index(j)]
                out.append((body.placed(np.eye(3), p), np.array(MOVER_COLOR)))
        return out

    def _team(self, k: int) -> list[Solid]:
        s = self._run.series
        load = s["load"][k]
        out = [(self._load.placed(quat_to_R(load[3:7]), load[0:3]), np.array(LOAD_COLOR))]
        for i in range(self._run.layout.n):
            R = quat_to_R(s["vehicle_q"][k, i])
            hub = self._hub.placed(R, s["vehicle_p"][k, i])
            out.append((hub, np.array(VEHICLE_COLORS[i])))
        return out

    def _glass(self, image: Image, camera: Camera, rows: list[int]) -> None:
        """Rotor discs and the goal: what one sees through."""
        run, task = self._run, self._run.scenario.task
        items = []
        for k in rows:
            for i in range(run.layout.n):
                R, p = quat_to_R(run.series["vehicle_q"][k, i]), run.series["vehicle_p"][k, i]
                discs = [self._rotor.placed(R, p + R @ offset) for offset in self._rotors]
                items += [(disc, np.array(VEHICLE_COLORS[i]), 0.6) for disc in discs]
        if isinstance(task, GoTo):
            ball = mesh.capsule(task.within_m, 0.0).placed(np.eye(3), np.array(task.goal_m))
            items.append((ball, GOAL, 0.18))
        for body, color, alpha in items:
            rgb = np.broadcast_to(color, (len(body.p), 3))
            lit = shade(body.n, rgb, body.p, camera.p_WC)
            draw_triangles(image, camera, body.p, lit, np.full(len(body.p), alpha))

    def _cables(self, image: Image, camera: Camera, k: int, look: Look) -> None:
        s = self._run.series
        R, p = quat_to_R(s["load"][k, 3:7]), s["load"][k, 0:3]
        joined = s["cable_attached"][k] > 0.0
        hooks, places = (p + self._hooks @ R.T)[joined], s["vehicle_p"][k][joined]
        draw_lines(image, camera, hooks, places, _same(CABLE, hooks), look.line_px)
        for i in range(self._run.layout.n):
            centre = np.broadcast_to(s["vehicle_p"][k, i], (4, 3))
            tips = centre + self._rotors @ quat_to_R(s["vehicle_q"][k, i]).T
            draw_lines(image, camera, centre, tips, _same(BODY, tips), 1.5 * look.line_px)

    def _paths(self, image: Image, camera: Camera, k: int, look: Look) -> None:
        way = self._run.series["load"][: k + 1 : 5, 0:3]
        width = 2.0 * look.line_px
        draw_lines(image, camera, way[:-1], way[1:], _same(LOAD_COLOR, way[1:]), width)
        t_s = self._run.t_s[k] + 1e-6
        plans = [r.p_WD for r in self._run.events.references if r.t_s <= t_s]
        if look.plan and plans:
            p = plans[-1]
            draw_lines(image, camera, p[:-1], p[1:], _same(PLAN, p[1:]), 1.3 * look.line_px)

    def _floor(self, image: Image, camera: Camera, look: Look) -> None:
        room = self._run.scenario.world.room
        low, high = np.array(room.min_m), np.array(room.max_m)
        step = 1.0 if max(high - low) <= 40.0 else 10.0
        x, y = np.arange(low[0], high[0] + 1e-9, step), np.arange(low[1], high[1] + 1e-9, step)
        corner = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]) * step
        cells = np.stack(np.meshgrid(x[:-1], y[:-1], indexing="ij"), axis=-1).reshape(-1, 1, 2)
        tiles = np.insert(cells + corner, 2, 0.0, axis=2).reshape(-1, 3, 3)
        draw_triangles(
            image, camera, tiles, np.broadcast_to(FLOOR, tiles.shape), np.ones(len(tiles))
        )
        a = [(v, low[1], 0.001) for v in x] + [(low[0], v, 0.001) for v in y]
        b = [(v, high[1], 0.001) for v in x] + [(high[0], v, 0.001) for v in y]
        draw_lines(image, camera, np.array(a), np.array(b), _same(GRID, np.array(a)), 0.8)
        back = np.array([low[0], high[1]])
        edges = [
            ((*back, 0.0), (*back, high[2])),
            ((*back, 0.0), (high[0], high[1], 0.0)),
            ((*back, 0.0), (low[0], low[1], 0.0)),
        ]
        ends = np.array(edges)
        draw_lines(image, camera, ends[:, 0], ends[:, 1], _same(EDGE, ends[:, 0]), look.line_px)


def _same(color: Array | tuple[float, ...], like: Array) -> Array:
    """One colour for every row."""
    return np.broadcast_to(np.asarray(color, dtype=np.float64), (len(like), 3))
