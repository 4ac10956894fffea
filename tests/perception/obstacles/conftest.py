# SPDX-License-Identifier: Apache-2.0
"""Movers with known ways, and what four cameras of a team see of them."""

from dataclasses import dataclass

import numpy as np

from skyhaul.model.state import TeamState
from skyhaul.perception.obstacles.api import Bearings

PERIOD_US = 10_000
SIGMA_RAD = 0.006
CAMERAS = np.array([[0.7, 0.7, 2.0], [-0.7, 0.7, 2.0], [-0.7, -0.7, 2.0], [0.7, -0.7, 2.0]])


@dataclass(frozen=True)
class Swing:
    """A mover that swings about a point, or passes it straight on."""

    middle: tuple[float, float, float]
    way: tuple[float, float, float]
    """Amplitude of the swing [m]; with period 0, velocity [m/s]."""
    period_s: float = 0.0
    phase_s: float = 0.0
    radius_m: float = 0.2

    def place(self, t_s):
        """Where it is, (3,) [m]."""
        t = t_s + self.phase_s
        share = np.sin(2.0 * np.pi * t / self.period_s) if self.period_s else t
        return np.array(self.middle) + share * np.array(self.way)

    def velocity(self, t_s):
        """How fast, (3,) [m/s]."""
        return (self.place(t_s + 1e-4) - self.place(t_s - 1e-4)) / 2e-4


def seen_by(camera, movers, k, rng, *, hidden=(), miss=0.05, clutter=0.0, ranged=False):
    """One camera's bearings at step k, in random order, and the mover behind each row (-1 none)."""
    t_s, c = 1e-6 * PERIOD_US * k, CAMERAS[camera]
    rows, who = [], []
    for i, mover in enumerate(movers):
        if i in hidden or rng.random() < miss:
            continue
        rel = mover.place(t_s) - c
        distance = np.linalg.norm(rel)
        d = rel / distance + SIGMA_RAD * rng.normal(size=3)
        half = np.arcsin(mover.radius_m / distance) * np.exp(0.05 * rng.normal())
        rows.append((d / np.linalg.norm(d), half, distance + 0.05 * rng.normal()))
        who.append(i)
    for _ in range(rng.poisson(clutter)):
        d = rng.normal(size=3)
        rows.append((d / np.linalg.norm(d), rng.uniform(0.01, 0.1), np.nan))
        who.append(-1)
    order = rng.permutation(len(rows))
    d = np.array([rows[i][0] for i in order]).reshape(-1, 3)
    ranges = np.array([rows[i][2] if ranged else np.nan for i in order])
    sigma_m = np.where(np.isfinite(ranges), 0.05, np.nan)
    seen = Bearings(
        PERIOD_US * k, camera, c, np.zeros(3), d, np.full(len(d), SIGMA_RAD),
        np.array([rows[i][1] for i in order]), ranges, sigma_m, np.zeros(len(d)),
        np.ones(len(d)),
    )  # fmt: skip
    return seen, [who[i] for i in order]


def follow(tracker, movers, steps, seed, *, hidden=lambda k: (), cameras=range(4), **how):
    """The tracks after each step."""
    rng = np.random.default_rng(seed)
    memory, out = tracker.init(), []
    for k in range(steps):
        seen = tuple(seen_by(c, movers, k, rng, hidden=hidden(k), **how)[0] for c in cameras)
        memory, tracks = tracker.step(memory, PERIOD_US * k, seen)
        out.append(tracks)
    return out


def nearest(track, movers, t_s):
    """Which mover a track is nearest to, and how far its centre is off [m]."""
    off = [np.linalg.norm(m.place(t_s) - track.p_WO) for m in movers]
    return int(np.argmin(off)), min(off)


def state_of(team, yaw_rate=0.0, t_s=0.0):
    """The team at rest 2 m up, its vehicles on their stations, looking outward; or all turning."""
    n, p_WL = team.count, np.array([0.0, 0.0, 1.2])
    reach = team.hooks_L() + team.cable_lengths_m()[:, None] * team.formation_dirs_L()
    yaw = team.azimuths_rad + yaw_rate * t_s
    q = np.column_stack([np.cos(yaw / 2), np.zeros(n), np.zeros(n), np.sin(yaw / 2)])
    zero, turn = np.zeros((n, 3)), np.tile([0.0, 0.0, yaw_rate], (n, 1))
    unit = np.array([1.0, 0.0, 0.0, 0.0])
    return TeamState(p_WL, unit, zero[0], zero[0].copy(), p_WL + reach, q, zero.copy(), turn)
