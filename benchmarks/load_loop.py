# SPDX-License-Identifier: Apache-2.0
"""A load under ideal cables, flown by a payload controller: references, worlds, closed loop."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from skyhaul.control.api import ControlRequest, ForcePlan, SolveStatus
from skyhaul.control.force_plan import (
    load_error,
    plan_arrays,
    sample_forces,
    sample_gain,
    sample_motion,
)
from skyhaul.geometry.shapes import Sphere
from skyhaul.jit import njit
from skyhaul.mapping.api import OccupancyGrid, WorldMap
from skyhaul.mapping.mapper import static_map
from skyhaul.model.dynamics import load_acceleration_kernel
from skyhaul.model.envelope import team_shape
from skyhaul.model.formation import hover_forces
from skyhaul.model.team import Team
from skyhaul.perception.api import Track
from skyhaul.planning.api import RefSample
from skyhaul.types import Array


@dataclass(frozen=True)
class Eight:
    """A lying eight with a swinging heading; a `Reference`."""

    size_m: tuple[float, float, float] = (2.0, 1.0, 0.4)
    center_m: tuple[float, float, float] = (0.0, 0.0, 2.0)
    period_s: float = 12.0
    yaw_rad: float = 0.3
    start_us: int = 0
    end_us: int = 10**9

    def sample(self, t_us: Array) -> RefSample:
        """See `Reference`."""
        t, w = 1e-6 * np.atleast_1d(t_us).astype(float), 2.0 * np.pi / self.period_s
        p, R = np.zeros((len(t), 7, 3)), np.zeros((len(t), 7, 3, 3))
        for k in range(7):
            p[:, k, 0] = self.size_m[0] * w**k * np.sin(w * t + 0.5 * np.pi * k)
            p[:, k, 1] = self.size_m[1] * (2 * w) ** k * np.sin(2 * w * t + 0.5 * np.pi * k)
            p[:, k, 2] = self.size_m[2] * w**k * np.sin(w * t + 0.5 * np.pi * k)
        p[:, 0] += self.center_m
        c, s = _jets_of_turn(self.yaw_rad, w, t)
        R[:, :, 0, 0], R[:, :, 0, 1] = c, -s
        R[:, :, 1, 0], R[:, :, 1, 1] = s, c
        R[:, 0, 2, 2] = 1.0
        return RefSample(p, R)


def _jets_of_turn(amplitude: float, w: float, t: Array) -> tuple[Array, Array]:
    """Derivatives 0..6 of cos and sin of amplitude sin(w t), (k, 7) each."""
    a = np.stack([amplitude * w**k * np.sin(w * t + 0.5 * np.pi * k) for k in range(7)], axis=1)
    c, s = np.zeros_like(a), np.zeros_like(a)
    c[:, 0], s[:, 0] = np.cos(a[:, 0]), np.sin(a[:, 0])
    binomial = [[1.0]]
    for k in range(1, 7):
        row = binomial[-1]
        binomial.append([1.0, *(x + y for x, y in pairwise(row)), 1.0])
        for j in range(k):  # derivative k of cos is derivative k - 1 of -sin(a) da
            b = binomial[k - 1][j]
            c[:, k] -= b * s[:, j] * a[:, k - j]
            s[:, k] += b * c[:, j] * a[:, k - j]
    return c, s


@dataclass(frozen=True)
class Rush:
    """From rest to rest along a straight line, minimum-snap-like; a `Reference`."""

    p_WS: tuple[float, float, float] = (0.0, 0.0, 2.0)
    p_WG: tuple[float, float, float] = (9.0, 0.0, 2.0)
    duration_s: float = 12.0
    start_us: int = 0

    @property
    def end_us(self) -> int:
        """See `Reference`."""
        return self.start_us + round(1e6 * self.duration_s)

    def sample(self, t_us: Array) -> RefSample:
        """See `Reference`."""
        t = np.clip(1e-6 * (np.atleast_1d(t_us) - self.start_us) / self.duration_s, 0.0, 1.0)
        poly = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])
        p, R = np.zeros((len(t), 7, 3)), np.zeros((len(t), 7, 3, 3))
        R[:, 0] = np.eye(3)
        span = np.array(self.p_WG) - np.array(self.p_WS)
        for k in range(7):
            value = (poly.deriv(k) if k else poly)(t) / self.duration_s**k
            p[:, k] = value[:, None] * span
        p[:, 0] += self.p_WS
        return RefSample(p, R)


@dataclass(frozen=True)
class Rest:
    """Rest at a place; a `Reference`."""

    p_WD: tuple[float, float, float] = (0.0, 0.0, 2.0)
    start_us: int = 0
    end_us: int = 0

    def sample(self, t_us: Array) -> RefSample:
        """See `Reference`."""
        t = np.atleast_1d(t_us)
        p, R = np.zeros((len(t), 7, 3)), np.zeros((len(t), 7, 3, 3))
        p[:, 0], R[:, 0] = self.p_WD, np.eye(3)
        return RefSample(p, R)


def empty_world(team: Team, size_m: float = 30.0, voxel_m: float = 0.5) -> WorldMap:
    """A free cube around the origin, floor and walls far off."""
    cells = round(size_m / voxel_m)
    corner = np.full(3, -0.5 * size_m)
    occupied = np.zeros((cells, cells, cells), dtype=np.bool_)
    return static_map(OccupancyGrid(occupied, corner, voxel_m), team_shape(team, 0.1))


def mover(
    i: int, p_WO: Array, v_WO: Array, radius_m: float = 0.25, growth_mps: float = 0.0
) -> Track:
    """A ball that moves on at constant velocity from time 0."""
    return Track(
        track_id=i,
        stamp_us=0,
        shape=Sphere(radius_m=radius_m),
        p_WO=np.array(p_WO, dtype=float),
        R_WO=np.eye(3),
        v_WO=np.array(v_WO, dtype=float),
        covariance=np.zeros((6, 6)),
        growth_mps=growth_mps,
        tube_base_m=0.02,
    )


def six_movers() -> tuple[Track, ...]:
    """Six balls that cross or stand beside the line of `Rush`, all in reach of it."""
    rows = [
        ((2.2, 0.15, 3.6), (0.0, 0.0, 0.0)),
        ((4.3, 3.4, 2.3), (0.0, -0.55, 0.0)),
        ((5.6, -3.6, 2.0), (0.0, 0.45, 0.0)),
        ((12.5, 1.2, 2.8), (-0.6, 0.0, 0.0)),
        ((7.6, -1.4, 2.4), (0.0, 0.0, 0.0)),
        ((1.0, 3.0, 2.0), (0.4, -0.3, 0.0)),
    ]
    return tuple(mover(i, p, v) for i, (p, v) in enumerate(rows))


def moved(world: WorldMap, tracks: tuple[Track, ...], t_us: int) -> WorldMap:
    """The map with these tracks, seen at a time."""
    seen = tuple(
        replace(t, stamp_us=t_us, p_WO=t.p_WO + 1e-6 * (t_us - t.stamp_us) * t.v_WO) for t in tracks
    )
    return replace(world, stamp_us=t_us, tracks=seen)


@dataclass(frozen=True)
class Orbits:
    """Six balls on level circles through the volume of an `Eight`, all within 4 m of it."""

    radius_m: float = 0.25

    def tracks(self, t_s: float) -> tuple[Track, ...]:
        """What is known of them at a time: place and velocity."""
        rows = []
        for i in range(6):
            reach, w = 1.6 + 0.25 * i, (0.25 - 0.02 * i) * (-1) ** i
            a = 1.1 * i + w * t_s
            center = np.array([0.5 * np.cos(2.4 * i), 0.5 * np.sin(2.4 * i), 1.0 + 0.55 * i])
            p = center + reach * np.array([np.cos(a), np.sin(a), 0.0])
            v = reach * w * np.array([-np.sin(a), np.cos(a), 0.0])
            rows.append(mover(i, p, v, self.radius_m, growth_mps=0.05))
        return tuple(rows)


@dataclass(frozen=True, eq=False)
class Log:
    """One closed loop, one row per solve."""

    load: Array  # (k, 13)
    reference: Array  # (k, 3)
    wall_ms: Array  # (k,)
    iterations: Array  # (k,)
    slack_m: Array  # (k,)
    residual: Array  # (k,)
    clearance_m: Array  # (k,)
    statuses: list[SolveStatus]

    @property
    def rmse_m(self) -> float:
        """Root mean square position error [m]."""
        return float(np.sqrt(np.mean(np.sum((self.load[:, :3] - self.reference) ** 2, axis=1))))


@dataclass(frozen=True)
class LoadLoop:
    """The load, its cables giving the plan's force with feedback, behind a first-order lag."""

    team: Team
    solve_s: float = 0.05
    lag_s: float = 0.0
    sqp_iterations: int = 1
    push: tuple[float, float] = (0.0, 0.0)  # RMS of a random force [N] and moment [N m]

    def fly(
        self,
        controller,  # noqa: ANN001
        reference,  # noqa: ANN001
        world: WorldMap,
        tracks: tuple[Track, ...] | Orbits = (),
        seconds: float = 6.0,
        x0: Array | None = None,
        seed: int = 0,
    ) -> Log:
        """Fly a reference from a state (13,), default its start, solving every `solve_s`.

        Movers are tracks as seen at time 0, or `Orbits`.
        """
        team, arrays = self.team, self.team.arrays()
        start = reference.sample(np.zeros(1))
        x = np.zeros(13)
        x[:3], x[3], x[7:10] = start.p_WD[0, 0], 1.0, start.p_WD[0, 1]
        x = x if x0 is None else x0.copy()
        force, wanted = hover_forces(team), hover_forces(team)
        dforce = np.zeros((team.count, 3))
        memory, rows, statuses = controller.init(), [], []
        steps, rng = round(self.solve_s / TICK_S), np.random.default_rng(seed)
        wind = np.zeros(6)
        for k in range(round(seconds / self.solve_s)):
            t_us = round(1e6 * k * self.solve_s)
            if isinstance(tracks, Orbits):
                now = tuple(replace(t, stamp_us=t_us) for t in tracks.tracks(1e-6 * t_us))
                view = replace(world, stamp_us=t_us, tracks=now)
            else:
                view = moved(world, tracks, t_us)
            request = ControlRequest(
                stamp_us=t_us,
                load=x.copy(),
                force_W=wanted.copy(),
                dforce_W=dforce.copy(),
                active=np.ones(team.count, dtype=np.bool_),
                reference=reference,
                world_map=view,
                sqp_iterations=self.sqp_iterations,
            )
            memory, solution = controller.solve(memory, request)
            clear = view.clearance(x[None, :3], np.array([t_us]))[0]
            target = reference.sample(np.array([t_us])).p_WD[0, 0]
            rows.append(
                np.concatenate(
                    [
                        x,
                        target,
                        [solution.wall_ms, solution.iterations, solution.slack_m],
                        [solution.kkt_residual, clear],
                    ]
                )
            )
            statuses.append(solution.status)
            decay = np.exp(-self.solve_s / 0.4)
            scale = np.repeat(self.push, 3)
            wind = decay * wind + np.sqrt(1 - decay**2) * scale * rng.standard_normal(6)
            lag = 1.0 - np.exp(-TICK_S / self.lag_s) if self.lag_s > 0.0 else 1.0
            run_plan(
                arrays,
                plan_arrays(solution.plan),
                (steps, lag),
                wind,
                (x, force, wanted, dforce),
            )
            if not np.isfinite(x).all():
                break
        a = np.array(rows)
        return Log(a[:, :13], a[:, 13:16], *a[:, 16:].T, statuses)


TICK_S = 2e-3


@njit
def run_plan(arrays, plan, ticks, wind, state):  # noqa: ANN001, ANN201
    """Fly a plan for some ticks from its stamp, in place: load state, forces and their rates."""
    steps, lag = ticks
    x, force, command, dforce = state
    n = force.shape[0]
    planned, forces, gain = np.empty(19), np.empty((3, n, 3)), np.empty((n, 3, 12))
    e, accel = np.empty(12), np.empty(6)
    for k in range(steps):
        t = (k + 0.5) * 2e-3
        sample_motion(plan, t, planned)
        sample_forces(plan, t, forces)
        sample_gain(plan, t, gain)
        load_error(x, planned, e)
        for i in range(n):
            for a in range(3):
                wanted = forces[0, i, a]
                for j in range(12):
                    wanted += gain[i, a, j] * e[j]
                command[i, a] = wanted
                force[i, a] += lag * (wanted - force[i, a])
                dforce[i, a] = forces[1, i, a]
        load_acceleration_kernel(arrays, x, force, accel)
        for a in range(3):
            accel[a] += wind[a] / arrays.m_L
            if arrays.rigid:
                accel[3 + a] += wind[3 + a] / arrays.J_L[a]
            x[7 + a] += 2e-3 * accel[a]
            x[10 + a] += 2e-3 * accel[3 + a]
            x[a] += 2e-3 * x[7 + a]
        q, w = x[3:7].copy(), x[10:13]
        x[3] += 1e-3 * (-q[1] * w[0] - q[2] * w[1] - q[3] * w[2])
        x[4] += 1e-3 * (q[0] * w[0] + q[2] * w[2] - q[3] * w[1])
        x[5] += 1e-3 * (q[0] * w[1] + q[3] * w[0] - q[1] * w[2])
        x[6] += 1e-3 * (q[0] * w[2] + q[1] * w[1] - q[2] * w[0])
        x[3:7] /= np.sqrt(np.sum(x[3:7] ** 2))


def plan_at(plan: ForcePlan, t: float) -> tuple[Array, Array]:
    """Planned load motion (19,) and forces with two derivatives (3, n, 3), t after the stamp."""
    planned, forces = np.empty(19), np.empty((3, plan.force_W.shape[1], 3))
    arrays = plan_arrays(plan)
    sample_motion(arrays, t, planned)
    sample_forces(arrays, t, forces)
    return planned, forces
