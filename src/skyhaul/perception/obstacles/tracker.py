# SPDX-License-Identifier: Apache-2.0
"""Tracks of moving obstacles from the bearings of the whole team.

Every step: move the tracks on; camera by camera, assign its bearings to the tracks at the least
total cost (Hungarian, gated), confirmed tracks first; begin tracks where unexplained rays meet;
confirm what was seen in M of the last N steps, in more if one camera alone saw it; take up the
old name of one that was lost.

What one camera alone sees is a track too, at the distance from which an obstacle of usual size
looks as large, and stays as unsure as sizes are until another camera's ray meets it.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from skyhaul.params import Params
from skyhaul.perception.api import Track
from skyhaul.perception.obstacles.api import Bearings
from skyhaul.perception.obstacles.births import BirthRules, Newborn
from skyhaul.perception.obstacles.book import (
    Book,
    bits_of,
    chi2_limit,
    moments_of,
    random_of_step,
    take,
)
from skyhaul.perception.obstacles.motion import Belief, KalmanFilter
from skyhaul.perception.obstacles.particles import ParticleFilter
from skyhaul.perception.obstacles.polar import Polar, as_one_of_many, gate, polar, rows, stacked
from skyhaul.perception.obstacles.tubes import tracks_of
from skyhaul.types import US_PER_S, Array, IntArray, Mask, TimeUs

_FAR = 1e6
_SURE = 0.07
"""A distance is sure when its standard deviation is a smaller share of it."""
_TURNED_MPS = 0.2
"""What is added to the error of a velocity that is scaled to another distance [m/s]."""
_ENDED = -(2**60)
"""Seen so long ago that a track is forgotten."""


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
    confirm_alone: int = 6
    """M for a track that one camera only has seen, without a range."""
    coast_s: float = 0.5
    """A confirmed track that is not seen is handed out this long [s]."""
    remember_s: float = 3.0
    """A lost track's name is kept this long [s]."""
    rejoin_probability: float = 0.99
    """Gate within which a new track is taken for a lost one."""
    rejoin_m: float = 1.0
    """Where the lost one is must be known so well, one standard deviation [m]."""
    tube_horizon_s: float = 2.0
    """Time over which predicted tubes hold [s]."""
    seed: int = 0
    """Seed of the filter's random numbers."""

    def __post_init__(self) -> None:
        for name in ("confirm_hits", "confirm_alone"):
            if not 1 <= getattr(self, name) <= self.confirm_steps:
                raise ValueError(
                    f"{name} must lie in 1..confirm_steps, got {getattr(self, name)} of "
                    f"{self.confirm_steps}"
                )
        for name in ("gate_probability", "rejoin_probability"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name} must lie in (0, 1), got {getattr(self, name)}")
        for name in ("coast_s", "remember_s", "rejoin_m", "tube_horizon_s"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")

    def init(self) -> TrackerMemory:
        """See `ObstacleTracker.init`."""
        none = np.zeros(0, np.int64)
        book = Book(none, none.astype(bool), np.zeros((0, self.confirm_steps), bool), none, none,
                    none)  # fmt: skip
        rng = np.random.default_rng(self.seed)
        belief = self.filter.start(np.zeros((0, 4)), np.zeros((0, 4, 4)), rng)
        return TrackerMemory(None, 0, 0, book, belief)

    def step(
        self, memory: TrackerMemory, stamp_us: TimeUs, seen: tuple[Bearings, ...]
    ) -> tuple[TrackerMemory, tuple[Track, ...]]:
        """See `ObstacleTracker.step`."""
        rng = random_of_step(self.seed, memory.step_index)
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
        belief = take(memory.belief, keep)
        return tracks_of(self.filter, belief, memory.stamp_us, book.name[keep], self.tube_horizon_s)


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
        self.taken: list[tuple[int, Polar]] = []
        """Tracks, by index, and the measurement that each took."""

    def assign(self, z: Polar) -> Polar:
        """Give one camera's bearings to tracks; what is left."""
        free = np.arange(len(z.camera))
        alive = self.stamp_us - self.book.seen_us <= self.rules.coast_s * US_PER_S
        moments = self.rules.filter.moments(self.belief)
        x = np.concatenate([moments.p_WO, moments.v_WO], axis=1)
        squared, log_det = gate(x, moments.covariance, z)
        ranged = z.range_m > 0.0
        limit = chi2_limit(self.rules.gate_probability, 2 + ranged.astype(int))
        cost = np.where(squared < limit, squared + log_det, _FAR)
        # what one camera alone has seen may be anywhere on its ray: others join it in `begin`
        cost[self._strange(z)] = _FAR
        for group in (self.book.confirmed & alive, ~self.book.confirmed):
            tracks = np.flatnonzero(group)
            if len(tracks) and len(free):
                i, j = linear_sum_assignment(cost[np.ix_(tracks, free)])
                good = cost[tracks[i], free[j]] < _FAR
                self._update(tracks[i[good]], rows(z, free[j[good]]))
                for track, row in zip(tracks[i[good]], free[j[good]], strict=True):
                    self.taken.append((int(track), rows(z, np.array([row]))))
                    name = int(self.book.name[track])
                    self.given.append((int(z.camera[row]), int(row), name))
                free = np.delete(free, j[good])
            free = free[~self._parts(rows(z, free))]
        return rows(z, free)

    def _strange(self, z: Polar) -> Mask:
        """Tracks that one camera alone has seen, against bearings of others, (n, k)."""
        other = np.left_shift(1, z.camera % 62)[None] & self.book.cameras[:, None] == 0
        strange: Mask = self._alone()[:, None] & other
        return strange

    def _alone(self) -> Mask:
        """Tracks that one camera only has ever seen, and without a range."""
        bits = self.book.cameras
        alone: Mask = (bits & (bits - 1)) == 0
        return alone

    def _parts(self, z: Polar) -> Mask:
        """Which bearings lie within what a track that was seen fills: parts of it, (k,)."""
        m = moments_of(self.rules.filter, self.belief, self.hit)
        rel = m.p_WO[:, None] - m.v_WO[:, None] * z.age_s[None, :, None] - z.p_WC[None]
        rho = np.linalg.norm(rel, axis=-1)
        off = np.arccos(np.clip(np.einsum("nkc,kc->nk", rel, z.axes[:, 2]) / rho, -1.0, 1.0))
        half = np.arcsin(np.minimum(np.exp(m.log_radius)[:, None] / rho, 1.0))
        near = (off < 1.2 * half + z.half_angle) & ~self._strange(z)[self.hit]
        within: Mask = np.any(near, axis=0)
        return within

    def _update(self, tracks: IntArray, z: Polar) -> None:
        if not len(tracks):
            return
        filtered = self.rules.filter
        better = filtered.update(take(self.belief, tracks), as_one_of_many(z), self.rng)
        for whole, new in zip(self.belief, better, strict=True):
            whole[tracks] = new
        self.hit[tracks] = True
        self.book.seen_us[tracks] = self.stamp_us
        self.book.cameras[tracks] |= np.left_shift(1, z.camera % 62)
        self.book.cameras[tracks] |= np.where(z.range_m > 0.0, 1 << 62, 0)
        self._hold_size(tracks, z)

    def _hold_size(self, tracks: IntArray, z: Polar) -> None:
        """Of what one camera alone has seen the size stays the usual one."""
        births = self.rules.births
        held = np.flatnonzero(self._alone()[tracks])
        if len(held):
            size = float(np.log(births.usual_radius_m)), births.radius_spread
            belief = take(self.belief, tracks[held])
            again = self.rules.filter.hold_size(belief, rows(z, held), size, self.rng)
            for whole, new in zip(self.belief, again, strict=True):
                whole[tracks[held]] = new

    def age(self) -> None:
        """Note which tracks were seen."""
        self.book.hits[:, :-1] = self.book.hits[:, 1:]
        self.book.hits[:, -1] = self.hit
        self.book.steps[:] += 1

    def begin(self, unexplained: list[Polar], next_name: int) -> int:
        """Tentative tracks from what is left; the next free name.

        What a track of unsure distance took may meet another camera's ray elsewhere: then it
        begins anew where the rays meet.
        """
        loose = self._loose()
        lone = [(track, z) for track, z in self.taken if loose[track]]
        parts = unexplained + [z for _, z in lone]
        if not parts:
            return next_name
        owners = np.array([-1] * sum(len(z.camera) for z in unexplained) + [k for k, _ in lone])
        fresh = []
        for born in self.rules.births.born(stacked(parts)):
            owner = owners[list(born.rows)]
            owned = np.unique(owner[owner >= 0])
            if not len(owned):
                fresh.append(born)
            elif len(born.rows) > 1 and all(self._may_be(k, born) for k in owned):
                self._begin_anew(owned, born)
        if not fresh:
            return next_name
        self._add(fresh, next_name)
        return next_name + len(fresh)

    def _loose(self) -> Mask:
        """Tracks that one camera saw in this step, and whose distance from it is not sure."""
        count = np.bincount([t for t, _ in self.taken], minlength=len(self.hit))
        loose = np.zeros(len(self.hit), np.bool_)
        m = self.rules.filter.moments(self.belief)
        for track, z in self.taken:
            if count[track] == 1 and not z.range_m[0] > 0.0:
                rel = m.p_WO[track] - z.p_WC[0]
                square = rel @ rel
                along = rel @ m.covariance[track, :3, :3] @ rel / square**2
                loose[track] = along > _SURE**2
        return loose

    def _may_be(self, track: int, born: Newborn) -> bool:
        """Whether a track may be what was born: not farther off than three times its gate."""
        m = moments_of(self.rules.filter, self.belief, np.array([track]))
        off = born.p_WO - m.p_WO[0]
        both = 9.0 * m.covariance[0, :3, :3] + born.covariance[:3, :3]
        return bool(off @ np.linalg.solve(both, off) < chi2_limit(0.999, np.array(3)))

    def _begin_anew(self, owned: IntArray, born: Newborn) -> None:
        """The most senior of the tracks goes on as a newborn, the others end.

        What it did across its camera's ray is known, but for the distance: its velocity against
        the camera's grows as the distance does.
        """
        oldest = int(owned[np.argmax(self._seniority()[owned])])
        z = next(z for track, z in self.taken if track == oldest)
        m = moments_of(self.rules.filter, self.belief, np.array([oldest]))
        far, was = (float(np.linalg.norm(p - z.p_WC[0])) for p in (born.p_WO, m.p_WO[0]))
        s = far / max(was, 1e-3)
        velocity = z.v_WC + s * (m.v_WO - z.v_WC)
        of_v = s * s * m.covariance[:, 3:, 3:] + _TURNED_MPS**2 * np.eye(3)
        for whole, new in zip(self.belief, self._start([born], (velocity, of_v)), strict=True):
            whole[oldest] = new[0]
        self.book.cameras[oldest] = bits_of(born)
        self.book.seen_us[np.setdiff1d(owned, oldest)] = _ENDED

    def _start(self, born: list[Newborn], velocity: tuple[Array, Array] | None = None) -> Belief:
        pr = np.array([np.append(b.p_WO, b.log_radius) for b in born])
        covariance = np.array([b.covariance for b in born])
        return self.rules.filter.start(pr, covariance, self.rng, velocity)

    def _add(self, born: list[Newborn], next_name: int) -> None:
        """Take up tentative tracks."""
        k, n = len(born), self.rules.confirm_steps
        hits = np.zeros((k, n), dtype=bool)
        hits[:, -1] = True
        new = Book(
            next_name + np.arange(k), np.zeros(k, bool), hits, np.ones(k, np.int64),
            np.full(k, self.stamp_us), np.array([bits_of(b) for b in born]),
        )  # fmt: skip
        self.book = Book._make(np.concatenate(pair) for pair in zip(self.book, new, strict=True))
        both = zip(self.belief, self._start(born), strict=True)
        self.belief = tuple(np.concatenate(pair) for pair in both)

    def merge(self) -> None:
        """Of two tracks inside one another the younger goes."""
        n = len(self.book.name)
        if n < 2:
            return
        moments = self.rules.filter.moments(self.belief)
        p_WO, radius = moments.p_WO, np.exp(moments.log_radius)
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
        needed = np.where(self._alone(), rules.confirm_alone, rules.confirm_hits)
        ripe = ~book.confirmed & (book.hits.sum(axis=1) >= needed)
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
        size = np.abs(m.log_radius[new][:, None] - m.log_radius[old][None])
        fits = squared < chi2_limit(self.rules.rejoin_probability, np.array(3))
        fits &= size < np.log(self.rules.births.size_ratio)
        fits &= np.linalg.eigvalsh(cov[old])[None, :, -1] < self.rules.rejoin_m**2
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
            self.belief = take(self.belief, which)
