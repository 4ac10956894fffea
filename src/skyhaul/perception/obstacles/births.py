# SPDX-License-Identifier: Apache-2.0
"""New obstacles from bearings that no track explains: rays of several cameras that meet.

A ray that meets none gives an obstacle too, at the distance from which one of usual size looks as
large: uncertain by half, and correlated with its size, so that both become known together.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.obstacles.polar import (
    Polar,
    closest_points,
    extents,
    gate,
    rows,
    triangulate,
)
from skyhaul.types import Array, Mask


class Newborn(NamedTuple):
    """An obstacle seen for the first time."""

    p_WO: Array  # (3,) [m]
    log_radius: float
    covariance: Array  # (4, 4) of p_WO [m] and log_radius
    cameras: frozenset[int]  # that saw it
    rows: tuple[int, ...]  # of the bearings that it was born from


@dataclass(frozen=True, kw_only=True)
class BirthRules(Params):
    """Which rays may be of one obstacle."""

    gap_sigmas: float = 3.0
    """Rays of one obstacle miss each other by no more standard deviations than this."""
    parallax_deg: float = 2.0
    """Rays closer to parallel than this do not place an obstacle [deg]."""
    size_ratio: float = 2.0
    """The radii that two cameras see differ by no more than this factor."""
    sharp_rad: float = 0.06
    """Directions less certain than this give birth to nothing [rad]."""
    reach_m: float = 12.0
    """No obstacle is born farther from a camera than this [m]."""
    usual_radius_m: float = 0.2
    """Radius of an obstacle that one camera sees, the median [m]."""
    pairs: bool = True
    """Whether two rays that meet give birth, or ranges alone."""
    radius_spread: float = 0.4
    """Standard deviation of its ln; 0: one camera gives birth to nothing."""
    extent_sigma: float = 0.2
    """Standard deviation of ln extent of a cluster."""

    def __post_init__(self) -> None:
        for name in (
            "gap_sigmas",
            "parallax_deg",
            "sharp_rad",
            "reach_m",
            "usual_radius_m",
            "extent_sigma",
        ):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if self.radius_spread < 0.0:
            raise ValueError(f"radius_spread must be >= 0, got {self.radius_spread}")
        if not self.size_ratio > 1.0:
            raise ValueError(f"size_ratio must be > 1, got {self.size_ratio}")

    def born(self, z: Polar) -> list[Newborn]:
        """Obstacles that unexplained bearings of all cameras give, the best fit first.

        A range places an obstacle alone; else two rays that meet do. Bearings of further cameras
        that fit join it, and no bearing serves twice. What is left is placed by its size.
        """
        free = z.variance[:, 0] < self.sharp_rad**2
        made = []
        for group, p_guess in self._candidates(z):
            if np.all(free[group]):
                members = self._joined(z, free, group, p_guess)
                free[members] = False
                made.append(self._met(rows(z, np.array(members)), p_guess, tuple(members)))
        if self.radius_spread > 0.0:
            made += [self._sized(rows(z, np.array([i])), int(i)) for i in np.flatnonzero(free)]
        return made

    def _met(self, z: Polar, p_guess: Array, members: tuple[int, ...]) -> Newborn:
        """An obstacle where rays meet: ln r = mean over the cameras of ln(rho sin half angle)."""
        p_WO, of_p = triangulate(z, p_guess)
        rel = p_WO - z.p_WC
        square = np.sum(rel**2, axis=1)
        log_extent, variance = extents(z, self.extent_sigma)
        slope = np.mean(rel / square[:, None], axis=0)  # of ln rho by p
        covariance = np.zeros((4, 4))
        covariance[:3, :3] = of_p
        covariance[:3, 3] = covariance[3, :3] = of_p @ slope
        # what a shape looks like is much the same for all cameras: their mean is no better
        covariance[3, 3] = slope @ of_p @ slope + np.mean(variance)
        log_radius = float(np.mean(0.5 * np.log(square) + log_extent))
        cameras = frozenset(int(c) for c in z.camera)
        return Newborn(p_WO, log_radius, covariance, cameras, members)

    def _sized(self, z: Polar, row: int) -> Newborn:
        """An obstacle of usual size on one ray: rho = r / sin(half angle)."""
        log_extent, variance = extents(z, self.extent_sigma)
        mean, prior = float(np.log(self.usual_radius_m)), self.radius_spread**2
        rho = float(np.exp(mean - log_extent[0]))
        d = z.axes[0, 2]
        along = np.outer(d, d)
        covariance = np.zeros((4, 4))
        covariance[:3, :3] = rho**2 * (
            (prior + variance[0]) * along + z.variance[0, 0] * (np.eye(3) - along)
        )
        covariance[:3, 3] = covariance[3, :3] = rho * prior * d
        covariance[3, 3] = prior
        camera = frozenset({int(z.camera[0])})
        return Newborn(z.p_WC[0] + rho * d, mean, covariance, camera, (row,))

    def _candidates(self, z: Polar) -> list[tuple[list[int], Array]]:
        """Rows that may be one obstacle and where it is, best first: ranges, then pairs of rays."""
        ranged = np.flatnonzero(z.range_m > 0.0)
        found = [([int(i)], z.p_WC[i] + z.range_m[i] * z.axes[i, 2]) for i in ranged]
        if not self.pairs:
            return found
        s, middle, gap = closest_points(z)
        sigma = np.sqrt(z.variance[:, 0])
        error = s * sigma[:, None]
        score = gap / np.maximum(np.sqrt(error**2 + error.T**2), 1e-9)
        with np.errstate(invalid="ignore", divide="ignore"):
            size = s * np.sin(z.half_angle)[:, None]
            ratio = np.abs(np.log(size / size.T))
        parallel = np.abs(z.axes[:, 2] @ z.axes[:, 2].T) > np.cos(np.radians(self.parallax_deg))
        fits = (z.camera[:, None] < z.camera[None, :]) & ~parallel
        fits &= (s > 0.0) & (s.T > 0.0) & (np.maximum(s, s.T) < self.reach_m)
        fits &= (score < self.gap_sigmas) & (ratio < np.log(self.size_ratio))
        i, j = np.nonzero(fits)
        order = np.argsort(score[i, j] + ratio[i, j], kind="stable")
        pairs = [([int(a), int(b)], middle[a, b]) for a, b in zip(i[order], j[order], strict=True)]
        return found + pairs

    def _joined(self, z: Polar, free: Mask, group: list[int], p_guess: Array) -> list[int]:
        """The group and, of every other camera, the free bearing that fits best."""
        members = list(group)
        p_WO, covariance = triangulate(rows(z, np.array(members)), p_guess)
        still = np.zeros((1, 6, 6))
        still[0, :3, :3] = covariance
        squared, _ = gate(np.append(p_WO, np.zeros(3))[None], still, z)
        fits = free & (squared[0] < self.gap_sigmas**2 + 2.0)
        for camera in np.unique(z.camera):
            if camera not in z.camera[members]:
                mine = np.flatnonzero(fits & (z.camera == camera))
                if len(mine):
                    members.append(int(mine[np.argmin(squared[0, mine])]))
        return members
