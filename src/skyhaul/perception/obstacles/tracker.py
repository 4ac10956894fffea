# SPDX-License-Identifier: Apache-2.0
"""Tracks of moving obstacles from the bearings of the whole team.

Every step: move the tracks on; camera by camera, assign its bearings to the tracks at the least
total cost (Hungarian, gated), confirmed tracks first; begin tracks where unexplained rays meet;
confirm what was seen in M of the last N steps; take up the old name of one that was lost.
"""

from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from skyhaul.params import Params
from skyhaul.perception.api import Track
from skyhaul.perception.obstacles.api import Bearings
from skyhaul.perception.obstacles.births import BirthRules
from skyhaul.perception.obstacles.motion import Belief, KalmanFilter, Moments
from skyhaul.perception.obstacles.particles import ParticleFilter
from skyhaul.perception.obstacles.polar import Polar, gate, polar, rows, stacked
from skyhaul.perception.obstacles.tubes import tracks_of
from skyhaul.types import US_PER_S, Array, IntArray, Mask, TimeUs

_FAR = 1e6


class Book(NamedTuple):
    """What is kept of every track besides its motion; the first axis is the track."""

    name: IntArray  # (n,) identity
    confirmed: Mask  # (n,)
    hits: Mask  # (n, N) whether it was seen, newest last
    steps: IntArray  # (n,) how long it has lived
    seen_us: IntArray  # (n,) when it was seen last
    cameras: IntArray  # (n,) which cameras ever saw it, as bits
    log_radius: Array  # (n,)
    radius_variance: Array  # (n,) of log_radius


@dataclass(frozen=True, eq=False)
class TrackerMemory:
    """All tracks: tentative, confirmed and lost."""

    stamp_us: TimeUs | None
    step_index: int
    next_name: int
    book: Book
    belief: Belief
    given: tuple[tuple[int, int, int], ...] = ()
    """In the last step: camera, row of its bearings, name of the track that took it."""


@dataclass(frozen=True, kw_only=True)
class BearingTracker(Params):
    """Life of tracks, and the filter that moves them."""

    filter: KalmanFilter | ParticleFilter = field(default_factory=KalmanFilter)
    """How motion is believed in."""
    births: BirthRules = field(default_factory=BirthRules)
    """Where tracks begin."""
    gate_probability: float = 0.999
    """Share of an obstacle's own bearings that its gate lets in."""
    confirm_hits: int = 4
    """M: steps with a bearing, out of the last N, that confirm a track."""
    confirm_steps: int = 6
    """N."""
    confirm_cameras: int = 2
    """Cameras that must have seen a track before it is confirmed, unless it has a range."""
    coast_s: float = 0.5
    """A confirmed track that is not seen is handed out this long [s]."""
    remember_s: float = 3.0
    """A lost track's name is kept this long [s]."""
    rejoin_probability: float = 0.99
    """Gate within which a new track is taken for a lost one."""
    tube_horizon_s: float = 2.0
    """Time over which predicted tubes hold [s]."""
    seed: int = 0
    """Seed of the filter's random numbers."""

    def __post_init__(self) -> None:
        if not 1 <= self.confirm_hits <= self.confirm_steps:
            raise ValueError(
                f"confirm_hits must lie in 1..confirm_steps, got {self.confirm_hits} of "
                f"{self.confirm_steps}"
            )
        for name in ("gate_probability", "rejoin_probability"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name} must lie in (0, 1), got {getattr(self, name)}")
        for name in ("coast_s", "remember_s", "tube_horizon_s"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")

    def init(self) -> TrackerMemory:
        """See `ObstacleTracker.init`."""
        none = np.zeros(0, np.int64)
        book = Book(none, none.astype(bool), np.zeros((0, self.confirm_steps), bool), none, none,
                    none, np.zeros(0), np.zeros(0))  # fmt: skip
        rng = np.random.default_rng(self.seed)
        belief = self.filter.start(np.zeros((0, 3)), np.zeros((0, 3, 3)), rng)
        return TrackerMemory(None, 0, 0, book, belief)

    def step(
        self, memory: TrackerMemory, stamp_us: TimeUs, seen: tuple[Bearings, ...]
    ) -> tuple[TrackerMemory, tuple[Track, ...]]:
        """See `ObstacleTracker.step`."""
        rng = _random(self.seed, memory.step_index)
        dt_s = 0.0 if memory.stamp_us is None else (stamp_us - memory.stamp_us) / US_PER_S
        work = _Step(self, stamp_us, memory.book, self._predicted(memory.belief, dt_s, rng), rng)
        if seen:
            unexplained = [work.assign(polar(one)) for one in seen if len(one.dir_W)]
            work.age()
            left = [z for z in unexplained if len(z.camera)]
            next_name = work.begin(left, memory.next_name)
            work.merge()
            work.confirm()
        else:
            next_name = memory.next_name
        work.bury()
        after = TrackerMemory(
            stamp_us, memory.step_index + 1, next_name, work.book, work.belief, tuple(work.given)
        )
        return after, self._handed_out(after)

    def _predicted(self, belief: Belief, dt_s: float, rng: np.random.Generator) -> Belief:
        return self.filter.predict(belief, dt_s, rng)

    def _handed_out(self, memory: TrackerMemory) -> tuple[Track, ...]:
        """Confirmed tracks that were seen lately."""
        assert memory.stamp_us is not None
        book = memory.book
        unseen_us = memory.stamp_us - book.seen_us
        keep = np.flatnonzero(book.confirmed & (unseen_us <= self.coast_s * US_PER_S))
        belief = _take(memory.belief, keep)
        return tracks_of(
            self.filter, belief, memory.stamp_us, book.name[keep], book.log_radius[keep],
            book.radius_variance[keep], self.tube_horizon_s,
        )  # fmt: skip


class _Step:
    """One step in the making: the tracks, changed in place."""

    def __init__(
        self, rules: BearingTracker, stamp_us: TimeUs, book: Book, belief: Belief,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        self.rules, self.stamp_us, self.rng = rules, stamp_us, rng
        self.book = Book._make(a.copy() for a in book)
        self.belief = tuple(a.copy() for a in belief)
        self.hit = np.zeros(len(book.name), dtype=bool)
        self.given: list[tuple[int, int, int]] = []

    def assign(self, z: Polar) -> Polar:
        """Give one camera's bearings to tracks; what is left."""
        free = np.arange(len(z.camera))
        alive = self.stamp_us - self.book.seen_us <= self.rules.coast_s * US_PER_S
        moments = self.rules.filter.moments(self.belief)
        squared, log_det = gate(moments.p_WO, moments.covariance[:, :3, :3], z)
        ranged = z.range_m > 0.0
        limit = chi2_limit(self.rules.gate_probability, 2 + ranged.astype(int))
        cost = np.where(squared < limit, squared + log_det, _FAR)
        for group in (self.book.confirmed & alive, ~self.book.confirmed):
            tracks = np.flatnonzero(group)
            if len(tracks) and len(free):
                i, j = linear_sum_assignment(cost[np.ix_(tracks, free)])
                good = cost[tracks[i], free[j]] < _FAR
                self._update(tracks[i[good]], rows(z, free[j[good]]))
                for track, row in zip(tracks[i[good]], free[j[good]], strict=True):
                    name = int(self.book.name[track])
                    self.given.append((int(z.camera[row]), int(row), name))
                free = np.delete(free, j[good])
        return rows(z, free)

    def _update(self, tracks: IntArray, z: Polar) -> None:
        if not len(tracks):
            return
        filtered = self.rules.filter
        better = filtered.update(_take(self.belief, tracks), z, self.rng)
        for whole, new in zip(self.belief, better, strict=True):
            whole[tracks] = new
        self.hit[tracks] = True
        self.book.seen_us[tracks] = self.stamp_us
        self.book.cameras[tracks] |= np.left_shift(1, z.camera % 62)
        self.book.cameras[tracks] |= np.where(z.range_m > 0.0, 1 << 62, 0)
        self._measure_radius(tracks, z, filtered.moments(better))

    def _measure_radius(self, tracks: IntArray, z: Polar, moments: Moments) -> None:
        """Kalman update of ln radius with what one camera saw."""
        p_WO, covariance = moments.p_WO, moments.covariance
        rel = p_WO - z.p_WC
        distance = np.linalg.norm(rel, axis=1)
        u = rel / distance[:, None]
        along = np.einsum("ki,kij,kj->k", u, covariance[:, :3, :3], u)
        half = np.maximum(z.half_angle, 1e-4)
        variance = z.variance[:, 0] / half**2 + along / distance**2 + 0.01
        gain = self.book.radius_variance[tracks] / (self.book.radius_variance[tracks] + variance)
        off = np.log(distance * np.sin(half)) - self.book.log_radius[tracks]
        self.book.log_radius[tracks] += gain * off
        self.book.radius_variance[tracks] *= 1.0 - gain
        self.book.radius_variance[tracks] += 1e-5

    def age(self) -> None:
        """Note which tracks were seen."""
        self.book.hits[:, :-1] = self.book.hits[:, 1:]
        self.book.hits[:, -1] = self.hit
        self.book.steps[:] += 1

    def begin(self, unexplained: list[Polar], next_name: int) -> int:
        """Tentative tracks where unexplained rays meet; the next free name."""
        if not unexplained:
            return next_name
        born = self.rules.births.born(stacked(unexplained))
        if not born:
            return next_name
        k, n = len(born), self.rules.confirm_steps
        p_WO = np.array([b.p_WO for b in born])
        fresh = self.rules.filter.start(p_WO, np.array([b.covariance for b in born]), self.rng)
        hits = np.zeros((k, n), dtype=bool)
        hits[:, -1] = True
        bits = [sum(1 << (c % 62) for c in b.cameras) | (0 if len(b.cameras) > 1 else 1 << 62)
                for b in born]  # fmt: skip
        new = Book(
            next_name + np.arange(k), np.zeros(k, bool), hits, np.ones(k, np.int64),
            np.full(k, self.stamp_us), np.array(bits), np.log([b.radius_m for b in born]),
            np.full(k, 0.05),
        )  # fmt: skip
        self.book = Book._make(np.concatenate(pair) for pair in zip(self.book, new, strict=True))
        both = zip(self.belief, fresh, strict=True)
        self.belief = tuple(np.concatenate(pair) for pair in both)
        return next_name + k

    def merge(self) -> None:
        """Of two tracks inside one another the younger goes."""
        n = len(self.book.name)
        if n < 2:
            return
        p_WO = self.rules.filter.moments(self.belief).p_WO
        radius = np.exp(self.book.log_radius)
        apart = np.linalg.norm(p_WO[:, None] - p_WO[None], axis=-1)
        inside = apart < 0.7 * np.minimum(radius[:, None], radius[None])
        older = self._seniority()[:, None] > self._seniority()[None]
        inside &= ~self._lost()[:, None]
        self._keep(~np.any(inside & older, axis=0))

    def _lost(self) -> Mask:
        """Confirmed tracks that are no longer handed out."""
        unseen_us = self.stamp_us - self.book.seen_us
        lost: Mask = self.book.confirmed & (unseen_us > self.rules.coast_s * US_PER_S)
        return lost

    def _seniority(self) -> IntArray:
        """Larger for confirmed tracks, then for older ones."""
        rank: IntArray = self.book.confirmed * 10**12 - self.book.name
        return rank

    def confirm(self) -> None:
        """M of N; then a lost track's name is taken up again."""
        rules, book = self.rules, self.book
        if book.confirmed.all():
            return
        cameras = np.array([int(bits).bit_count() for bits in book.cameras], dtype=np.int64)
        enough = (cameras >= rules.confirm_cameras) | (book.cameras >> 62 > 0)
        ripe = ~book.confirmed & enough & (book.hits.sum(axis=1) >= rules.confirm_hits)
        lost = self._lost()
        gone = np.zeros(len(book.name), dtype=bool)
        if ripe.any() and lost.any():
            for new, old in self._rejoined(np.flatnonzero(ripe), np.flatnonzero(lost)):
                book.name[new] = book.name[old]
                gone[old] = True
        book.confirmed[ripe] = True
        self._keep(~gone)

    def _rejoined(self, new: IntArray, old: IntArray) -> list[tuple[int, int]]:
        """Pairs of new and lost tracks that are one obstacle."""
        m = self.rules.filter.moments(self.belief)
        off = m.p_WO[new][:, None] - m.p_WO[old][None]
        cov = m.covariance[:, :3, :3]
        both = cov[new][:, None] + cov[old][None]
        squared = np.einsum("abi,abij,abj->ab", off, np.linalg.inv(both), off)
        size = np.abs(self.book.log_radius[new][:, None] - self.book.log_radius[old][None])
        fits = squared < chi2_limit(self.rules.rejoin_probability, np.array(3))
        fits &= size < np.log(self.rules.births.size_ratio)
        i, j = linear_sum_assignment(np.where(fits, squared, _FAR))
        return [(int(new[a]), int(old[b])) for a, b in zip(i, j, strict=True) if fits[a, b]]

    def bury(self) -> None:
        """Drop tentative tracks that do not prove themselves, and lost ones after a while."""
        rules, book = self.rules, self.book
        misses = np.minimum(book.steps, rules.confirm_steps) - book.hits.sum(axis=1)
        hopeless = ~book.confirmed & (misses > rules.confirm_steps - rules.confirm_hits)
        unseen_us = self.stamp_us - book.seen_us
        hopeless |= ~book.confirmed & (unseen_us > rules.coast_s * US_PER_S)
        self._keep(~hopeless & (unseen_us <= rules.remember_s * US_PER_S))

    def _keep(self, which: Mask) -> None:
        if not np.all(which):
            self.book = Book._make(a[which] for a in self.book)
            self.belief = _take(self.belief, which)


def _random(seed: int, step_index: int) -> np.random.Generator:
    """Random numbers of one step: of their own stretch of the seed's stream."""
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, step_index, 0, 0]))


def chi2_limit(probability: float, freedoms: IntArray) -> Array:
    """Squared Mahalanobis distance that holds this share of a Gaussian."""
    return np.array(_quantiles(probability))[freedoms]


@cache
def _quantiles(probability: float) -> tuple[float, ...]:
    """Of the chi-square with 0 to 3 degrees of freedom."""
    return 0.0, *(float(chi2.ppf(probability, k)) for k in (1, 2, 3))


def _take(belief: Belief, which: IntArray | Mask) -> Belief:
    """The beliefs of some tracks."""
    return tuple(a[which] for a in belief)
