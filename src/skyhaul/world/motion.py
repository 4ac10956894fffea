# SPDX-License-Identifier: Apache-2.0
"""Where every obstacle is over time: motions turned into tables for one numba kernel.

Each motion is a sequence of pieces of constant acceleration, repeated with a period, plus a
turning vector for circles. Velocities are continuous:

- A corner of a cycle is cut by a piece of constant acceleration that begins and ends the same
  distance from it: `CORNER_M` or `CORNER_S` at speed, whichever is more, but never more than half
  of an adjoining leg.
- At its own position a cycle comes to rest (for `dwell_s`, or for an instant), so that it passes
  that place exactly; likewise a line at both of its ends. Speeding up and slowing down takes the
  same distance as a corner.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skyhaul.errors import ConfigError
from skyhaul.geometry.distance import team_clearance
from skyhaul.geometry.shapes import ShapeArrays, pose_shapes
from skyhaul.jit import njit
from skyhaul.model.envelope import TeamShape
from skyhaul.types import US_PER_S, Array, IntArray, Mask, TimeUs
from skyhaul.world.obstacles import Circle, CyclicPath, Line, Motion, Obstacle
from skyhaul.world.scenario import World

CORNER_M = 0.25
CORNER_S = 0.25


class Piece(NamedTuple):
    """p = p0 + v0 s + a s^2 / 2, s since `start_s`."""

    start_s: float
    p0: Array
    v0: Array
    a: Array


class MotionTable(NamedTuple):
    """Motions of m obstacles with k pieces in all, for the kernel."""

    first: IntArray  # (m + 1,) row of the first piece of each obstacle
    start: Array  # (k,) time within the period at which a piece begins [s]
    p0: Array  # (k, 3) [m]
    v0: Array  # (k, 3) [m/s]
    a: Array  # (k, 3) [m/s^2]
    period: Array  # (m,) [s], inf: none
    phase: Array  # (m,) [s]
    spin: Array  # (m,) turning rate of circles [rad/s], else 0
    cosine: Array  # (m, 3) p += cosine cos(spin t) + sine sin(spin t) [m]
    sine: Array  # (m, 3) [m]


class AppearanceTable(NamedTuple):
    """When obstacles come into being, for the kernel."""

    at_s: Array  # (m,) -inf: from the start; inf: by distance only
    distance: Array  # (m,) [m], -inf: never by distance
    team: tuple[float, float, float]  # radius, above, below of the team's shape [m]


@dataclass(frozen=True, eq=False)
class MovingObstacles:
    """The obstacles of a world with the phases of one seed; see `ObstacleField`."""

    names: tuple[str, ...]
    shapes: ShapeArrays  # at rest; p_WO is not the position over time
    motions: MotionTable
    appearances: AppearanceTable
    always: bool  # every obstacle is there from the start

    def state_at(self, t_us: TimeUs) -> tuple[Array, Array]:
        """Centres (m, 3) [m] and velocities (m, 3) [m/s], fresh arrays."""
        m = len(self.names)
        p_WO, v_WO = np.empty((m, 3)), np.empty((m, 3))
        motion_state(self.motions, t_us / US_PER_S, p_WO, v_WO)
        return p_WO, v_WO

    def shapes_at(self, t_us: TimeUs) -> ShapeArrays:
        """Shapes at a time; the centres are a fresh array."""
        return self.shapes._replace(p_WO=self.state_at(t_us)[0])

    def velocities_at(self, t_us: TimeUs) -> Array:
        """Velocities of the centres, (m, 3) [m/s]."""
        return self.state_at(t_us)[1]

    def present(self, t_us: TimeUs, p_WL: Array) -> Mask:
        """Which obstacles are there now, (m,); see `ObstacleField.present`."""
        if self.always:
            return np.ones(len(self.names), dtype=np.bool_)
        return _present(self.appearances, t_us / US_PER_S, p_WL, self.shapes_at(t_us))


def obstacle_field(world: World, seed: int, shape: TeamShape | None = None) -> MovingObstacles:
    """The moving obstacles of a world.

    Args:
        world: The world.
        seed: 0 keeps the phases of the file; others draw each phase evenly from its period, with
            a generator seeded by (seed, index of the obstacle).
        shape: The team's shape, without margin; needed when an obstacle appears at a distance.

    Raises:
        ConfigError: when two names or two points in a row of a cycle are the same.
    """
    obstacles = world.obstacles
    names = tuple(o.name for o in obstacles)
    if len(set(names)) < len(names):
        raise ConfigError(f"obstacles must have unique names, got {', '.join(names)}")
    m = len(obstacles)
    centers = np.array([o.center_m for o in obstacles]).reshape(m, 3)
    return MovingObstacles(
        names=names,
        shapes=pose_shapes([o.shape for o in obstacles], centers),
        motions=_motion_table(obstacles, seed),
        appearances=_appearance_table(obstacles, shape),
        always=all(o.appears is None for o in obstacles),
    )


def _motion_table(obstacles: tuple[Obstacle, ...], seed: int) -> MotionTable:
    m = len(obstacles)
    pieces: list[Piece] = []
    first = np.zeros(m + 1, dtype=np.int64)
    period, phase, spin = np.full(m, np.inf), np.zeros(m), np.zeros(m)
    cosine, sine = np.zeros((m, 3)), np.zeros((m, 3))
    for j, o in enumerate(obstacles):
        p = np.array(o.center_m, dtype=np.float64)
        rows, period[j] = _pieces(o.motion, p, o.name)
        if isinstance(o.motion, Circle):
            center, cosine[j], sine[j] = _circle(o.motion, p)
            spin[j] = 2.0 * np.pi / o.motion.period_s
            rows = [_rest(center)]
        pieces += rows
        first[j + 1] = len(pieces)
        phase[j] = getattr(o.motion, "phase_s", 0.0)
        if seed != 0 and np.isfinite(period[j]):
            phase[j] = np.random.default_rng([seed, j]).uniform(0.0, period[j])
    k = len(pieces)
    columns = [np.array([r[c] for r in pieces], dtype=np.float64) for c in range(4)]
    start, p0, v0, a = columns[0], *(c.reshape(k, 3) for c in columns[1:])
    return MotionTable(first, start, p0, v0, a, period, phase, spin, cosine, sine)


def _pieces(motion: Motion, p: Array, name: str) -> tuple[list[Piece], float]:
    """Pieces of one period, and the period [s] (inf: none)."""
    match motion:
        case CyclicPath():
            return _cycle(motion, p, name)
        case Line(length_m=None):
            return [Piece(0.0, p, np.array(motion.velocity_mps), np.zeros(3))], np.inf
        case Line():
            return _shuttle(motion, p)
        case Circle():
            return [_rest(p)], abs(motion.period_s)
        case _:
            return [_rest(p)], np.inf


def _rest(p: Array) -> Piece:
    return Piece(0.0, p, np.zeros(3), np.zeros(3))


def _cycle(motion: CyclicPath, p: Array, name: str) -> tuple[list[Piece], float]:
    """Round the corners, resting at the obstacle's own position p."""
    corners = np.vstack([p, np.reshape(motion.points_m, (-1, 3)), p])
    legs = np.diff(corners, axis=0)
    length = np.linalg.norm(legs, axis=1)
    if np.min(length) < 1e-9:
        raise ConfigError(
            f"obstacle {name}: no two points in a row may coincide, center_m before the first "
            f"and after the last included, got center_m {tuple(p)} and points_m {motion.points_m}"
        )
    velocity = motion.speed_mps * legs / length[:, None]
    turns = [np.zeros(3), *velocity, np.zeros(3)]
    around = np.minimum(np.append(length, np.inf), np.append(np.inf, length))
    cut = np.minimum(_corner(motion.speed_mps), 0.5 * around)
    return _legs(corners, turns, cut, motion.speed_mps, motion.dwell_s)


def _shuttle(motion: Line, p: Array) -> tuple[list[Piece], float]:
    """There and back, resting for an instant at both ends."""
    v, length = np.array(motion.velocity_mps), float(motion.length_m or 0.0)
    speed = float(np.linalg.norm(v))
    end = p + length * v / speed
    cut = np.full(2, min(_corner(speed), 0.5 * length))
    there, half = _legs(np.vstack([p, end]), [np.zeros(3), v, np.zeros(3)], cut, speed, 0.0)
    back, _ = _legs(np.vstack([end, p]), [np.zeros(3), -v, np.zeros(3)], cut, speed, 0.0)
    return there + [r._replace(start_s=r.start_s + half) for r in back], 2.0 * half


def _corner(speed: float) -> float:
    """Distance from a corner at which it begins to be cut [m]."""
    return max(CORNER_M, CORNER_S * speed)


def _legs(
    corners: Array, velocity: list[Array], cut: Array, speed: float, dwell_s: float
) -> tuple[list[Piece], float]:
    """Straight legs between corners, with pieces of constant acceleration around each corner.

    `velocity[c]` is that before corner c, `velocity[c + 1]` that after it; zero at the ends.
    """
    zero = np.zeros(3)
    t, pieces = dwell_s, [Piece(0.0, corners[0], zero, zero)] if dwell_s > 0.0 else []
    for c, corner in enumerate(corners):
        before, after = velocity[c], velocity[c + 1]
        turn = 2.0 * cut[c] / speed
        begin = corner - 0.5 * turn * before
        pieces.append(Piece(t, begin, before, (after - before) / turn))
        t += turn
        if c + 1 < len(corners):
            straight = float(np.linalg.norm(corners[c + 1] - corner)) - cut[c] - cut[c + 1]
            pieces.append(Piece(t, corner + 0.5 * turn * after, after, zero))
            t += straight / speed
    return pieces, t


def _circle(motion: Circle, p: Array) -> tuple[Array, Array, Array]:
    """Centre of the round that p runs, and its two radii."""
    n = np.array(motion.normal) / np.linalg.norm(motion.normal)
    arm = p - np.array(motion.center_m)
    across = arm - n * (n @ arm)
    return p - across, across, np.cross(n, across)


def _appearance_table(obstacles: tuple[Obstacle, ...], shape: TeamShape | None) -> AppearanceTable:
    m = len(obstacles)
    at_s, distance = np.full(m, -np.inf), np.full(m, -np.inf)
    for j, o in enumerate(obstacles):
        if o.appears is None:
            continue
        at_s[j] = np.inf if o.appears.at_s is None else o.appears.at_s
        if o.appears.distance_m is not None:
            distance[j] = o.appears.distance_m
    if shape is None:
        if np.any(distance > -np.inf):
            raise ConfigError("an obstacle that appears at a distance needs the team's shape")
        return AppearanceTable(at_s, distance, (0.0, 0.0, 0.0))
    return AppearanceTable(at_s, distance, (shape.radius_m, shape.above_m, shape.below_m))


@njit
def motion_state(table: MotionTable, t: float, p: Array, v: Array) -> None:
    """Centres and velocities of all obstacles at time t [s], into p and v, (m, 3)."""
    for j in range(table.phase.shape[0]):
        s = t + table.phase[j]
        if table.period[j] < np.inf:
            s -= np.floor(s / table.period[j]) * table.period[j]
        low, high = table.first[j], table.first[j + 1]
        while high - low > 1:
            middle = (low + high) // 2
            if table.start[middle] <= s:
                low = middle
            else:
                high = middle
        r = s - table.start[low]
        c, q = np.cos(table.spin[j] * s), np.sin(table.spin[j] * s)
        for k in range(3):
            v0, a = table.v0[low, k], table.a[low, k]
            e, f = table.cosine[j, k], table.sine[j, k]
            p[j, k] = table.p0[low, k] + r * (v0 + 0.5 * r * a) + c * e + q * f
            v[j, k] = v0 + r * a + table.spin[j] * (c * f - q * e)


@njit
def _present(table: AppearanceTable, t: float, p_WL: Array, shapes: ShapeArrays) -> Mask:
    """Which obstacles are there at time t [s] with the load at p_WL."""
    m = table.at_s.shape[0]
    there = np.empty(m, np.bool_)
    radius, above, below = table.team
    for j in range(m):
        there[j] = t >= table.at_s[j]
        if not there[j] and table.distance[j] > -np.inf:
            gap = team_clearance(
                radius,
                above,
                below,
                p_WL,
                shapes.kind[j],
                shapes.size[j],
                shapes.p_WO[j],
                shapes.R_WO[j],
            )
            there[j] = gap <= table.distance[j]
    return there
