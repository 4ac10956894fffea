# SPDX-License-Identifier: Apache-2.0
"""Clusters followed through one camera's image: names, boxes, time to contact.

Of each track a Kalman filter holds (u, v, ln s), s the size of the box, and the
rates. What comes straight on grows as g = d ln s / dt = 1 / (time to contact), and at constant
speed dg/dt = g^2, which the prediction includes.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from skyhaul.params import Params
from skyhaul.perception.obstacles.clusters import Clusters
from skyhaul.types import US_PER_S, Array, IntArray, Mask, TimeUs

_FAR = 1e6
_GATE = 16.3  # chi-square, 3 degrees of freedom, 99.9 %


class ImageTracks(NamedTuple):
    """All tracks of an image; the first axis is the track."""

    name: IntArray  # (n,)
    confirmed: Mask  # (n,)
    hits: IntArray  # (n,) steps in a row that it was seen, at most `confirm_hits`
    born_us: IntArray  # (n,)
    seen_us: IntArray  # (n,)
    row: IntArray  # (n,) row of the clusters that it was seen as in this step, -1 none
    x: Array  # (n, 6) u, v [px], ln s, and their rates [1/s]
    covariance: Array  # (n, 6, 6)
    half_size: Array  # (n, 2) smoothed [px]

    @property
    def middle(self) -> Array:
        """Of the boxes, (n, 2) [px]."""
        return self.x[:, :2]

    def time_to_contact_s(self) -> Array:
        """(n,) [s]; infinite where growth is less than two standard deviations."""
        growth, sigma = self.x[:, 5], np.sqrt(self.covariance[:, 5, 5])
        sure = growth > 2.0 * sigma
        time: Array = np.where(sure, 1.0 / np.where(sure, growth, 1.0), np.inf)
        return time


@dataclass(frozen=True, eq=False)
class ImageTrackMemory:
    """Tracks at the last step."""

    stamp_us: TimeUs
    next_name: int
    tracks: ImageTracks


@dataclass(frozen=True, kw_only=True)
class ImageTracker(Params):
    """Noise of clusters, and the life of tracks."""

    place_sigma: float = 0.15
    """Standard deviation of a cluster's middle, as a share of its size."""
    size_sigma: float = 0.15
    """Standard deviation of ln size."""
    manoeuvre: float = 20.0
    """Density of the white acceleration of the middle, in sizes [1/s^3]."""
    growth_noise: float = 5.0
    """The same of ln size [1/s^3]."""
    confirm_hits: int = 3
    """Steps in a row with a cluster that confirm a track."""
    coast_us: int = 100_000
    """A track that is not seen is kept this long [us]."""
    smoothing: float = 0.3
    """Share of a new box in the smoothed one."""

    def __post_init__(self) -> None:
        for name in ("place_sigma", "size_sigma", "manoeuvre", "growth_noise", "coast_us"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if self.confirm_hits < 1:
            raise ValueError(f"confirm_hits must be >= 1, got {self.confirm_hits}")
        if not 0.0 < self.smoothing <= 1.0:
            raise ValueError(f"smoothing must lie in (0, 1], got {self.smoothing}")

    def init(self) -> ImageTrackMemory:
        """Memory without a track."""
        none = np.zeros(0, np.int64)
        tracks = ImageTracks(none, none.astype(bool), none, none, none, none, np.zeros((0, 6)),
                             np.zeros((0, 6, 6)), np.zeros((0, 2)))  # fmt: skip
        return ImageTrackMemory(0, 0, tracks)

    def step(
        self, memory: ImageTrackMemory, clusters: Clusters
    ) -> tuple[ImageTrackMemory, ImageTracks]:
        """Take in the clusters of one time; all tracks, tentative ones too."""
        dt_s = (clusters.stamp_us - memory.stamp_us) / US_PER_S
        tracks = self._predicted(memory.tracks, dt_s)
        i, j, free = self._pairs(tracks, clusters)
        tracks = self._updated(tracks, clusters, i, j)
        inside = _inside(tracks, clusters)
        fresh = self._begun(clusters, free & ~inside, memory.next_name)
        tracks = ImageTracks._make(np.concatenate(p) for p in zip(tracks, fresh, strict=True))
        unseen_us = clusters.stamp_us - tracks.seen_us
        keep = (tracks.confirmed & (unseen_us <= self.coast_us)) | (unseen_us == 0)
        tracks = ImageTracks._make(a[keep] for a in tracks)
        next_name = memory.next_name + len(fresh.name)
        return ImageTrackMemory(clusters.stamp_us, next_name, tracks), tracks

    def _predicted(self, tracks: ImageTracks, dt_s: float) -> ImageTracks:
        """Constant velocity in the image; what comes at constant speed grows ever faster."""
        left = 1.0 - np.clip(tracks.x[:, 5] * dt_s, -0.5, 0.5)  # share of the distance
        x = tracks.x.copy()
        x[:, :2] += dt_s * x[:, 3:5]
        x[:, 2] -= np.log(left)
        x[:, 5] /= left
        F = np.tile(np.eye(6), (len(x), 1, 1))
        F[:, :2, 3:5] = dt_s * np.eye(2)
        F[:, 2, 5] = dt_s / left
        F[:, 5, 5] = 1.0 / left**2
        size2 = np.prod(2.0 * tracks.half_size, axis=1)
        density = np.stack([self.manoeuvre * size2] * 2 + [self.growth_noise + 0.0 * size2], axis=1)
        Q = np.zeros((len(size2), 6, 6))
        at = np.arange(3)
        Q[:, at, at] = density * dt_s**3 / 3.0
        Q[:, at, at + 3] = Q[:, at + 3, at] = density * dt_s**2 / 2.0
        Q[:, at + 3, at + 3] = density * dt_s
        cov = F @ tracks.covariance @ np.swapaxes(F, -1, -2) + Q
        return tracks._replace(x=x, covariance=cov)

    def _measured(self, clusters: Clusters) -> tuple[Array, Array]:
        """(k, 3) u, v, ln s and their variances (k, 3)."""
        size = np.sqrt(np.prod(2.0 * clusters.half_size, axis=1))
        z = np.column_stack([clusters.middle, np.log(size)])
        place = np.square(self.place_sigma * size) + 1.0
        variance = np.column_stack([place, place, np.full(len(size), self.size_sigma**2)])
        return z, variance

    def _pairs(self, tracks: ImageTracks, clusters: Clusters) -> tuple[IntArray, IntArray, Mask]:
        """Tracks and clusters that belong together, and which clusters are left."""
        z, variance = self._measured(clusters)
        y = z[None] - tracks.x[:, None, :3]
        S = tracks.covariance[:, None, :3, :3] + np.einsum("ki,ij->kij", variance, np.eye(3))[None]
        squared = np.einsum("nki,nkij,nkj->nk", y, np.linalg.inv(S), y)
        cost = np.where(squared < _GATE, squared - 50.0 * tracks.confirmed[:, None], _FAR)
        i, j = linear_sum_assignment(cost)
        good = cost[i, j] < _FAR
        free = np.ones(len(z), dtype=bool)
        free[j[good]] = False
        return i[good], j[good], free

    def _updated(
        self, tracks: ImageTracks, clusters: Clusters, i: IntArray, j: IntArray
    ) -> ImageTracks:
        z, variance = self._measured(clusters)
        x, cov, half = tracks.x.copy(), tracks.covariance.copy(), tracks.half_size.copy()
        S = cov[i, :3, :3] + np.einsum("ki,ij->kij", variance[j], np.eye(3))
        gain = cov[i][:, :, :3] @ np.linalg.inv(S)
        x[i] += np.einsum("nij,nj->ni", gain, z[j] - x[i, :3])
        keep = np.tile(np.eye(6), (len(i), 1, 1))
        keep[:, :, :3] -= gain
        noise = (gain * variance[j][:, None]) @ np.swapaxes(gain, -1, -2)
        cov[i] = keep @ cov[i] @ np.swapaxes(keep, -1, -2) + noise
        half[i] += self.smoothing * (clusters.half_size[j] - half[i])
        seen, row = tracks.seen_us.copy(), np.full(len(x), -1)
        seen[i], row[i] = clusters.stamp_us, j
        hits = np.where(row >= 0, np.minimum(tracks.hits + 1, self.confirm_hits), 0)
        return tracks._replace(
            x=x, covariance=cov, half_size=half, seen_us=seen, row=row, hits=hits,
            confirmed=tracks.confirmed | (hits >= self.confirm_hits),
        )  # fmt: skip

    def _begun(self, clusters: Clusters, free: Mask, next_name: int) -> ImageTracks:
        z, variance = self._measured(clusters)
        at = np.flatnonzero(free)
        k = len(at)
        x = np.zeros((k, 6))
        x[:, :3] = z[at]
        cov = np.zeros((k, 6, 6))
        size2 = np.prod(2.0 * clusters.half_size[at], axis=1)
        diagonal = np.column_stack([variance[at], 100.0 * size2, 100.0 * size2, np.full(k, 25.0)])
        cov[:, np.arange(6), np.arange(6)] = diagonal
        stamp = np.full(k, clusters.stamp_us, dtype=np.int64)
        ones = np.ones(k, dtype=np.int64)
        return ImageTracks(next_name + np.arange(k), ones >= self.confirm_hits, ones, stamp,
                           stamp.copy(), at, x, cov, clusters.half_size[at])  # fmt: skip


def _inside(tracks: ImageTracks, clusters: Clusters) -> Mask:
    """Which clusters have their middle in the box of a confirmed track, (k,)."""
    off = np.abs(clusters.middle[None] - tracks.middle[:, None])
    within = np.all(off <= tracks.half_size[:, None], axis=-1) & tracks.confirmed[:, None]
    found: Mask = np.any(within, axis=0)
    return found
