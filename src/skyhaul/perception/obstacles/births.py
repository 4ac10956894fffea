# SPDX-License-Identifier: Apache-2.0
"""New obstacles from bearings that no track explains: rays of several cameras that meet."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.obstacles.polar import (
    Polar,
    closest_points,
    gate,
    rows,
    triangulate,
)
from skyhaul.types import Array


class Newborn(NamedTuple):
    """An obstacle seen for the first time."""

    p_WO: Array  # (3,) [m]
    covariance: Array  # (3, 3) [m^2]
    radius_m: float
    cameras: frozenset[int]  # that saw it


@dataclass(frozen=True, kw_only=True)
class BirthRules(Params):
    """Which rays may be of one obstacle."""

    gap_sigmas: float = 3.0
    """Rays of one obstacle miss each other by no more standard deviations than this."""
    parallax_deg: float = 2.0
    """Rays closer to parallel than this do not place an obstacle [deg]."""
    size_ratio: float = 2.0
    """The radii that two cameras see differ by no more than this factor."""
    reach_m: float = 12.0
    """No obstacle is born farther from a camera than this [m]."""

    def __post_init__(self) -> None:
        for name in ("gap_sigmas", "parallax_deg", "reach_m"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not self.size_ratio > 1.0:
            raise ValueError(f"size_ratio must be > 1, got {self.size_ratio}")

    def born(self, z: Polar) -> list[Newborn]:
        """Obstacles that unexplained bearings of all cameras give, the best fit first.

        A range places an obstacle alone; else two rays that meet do. Bearings of further cameras
        that fit join it, and no bearing serves twice.
        """
        free = np.ones(len(z.camera), dtype=bool)
        made = []
        for group, p_guess in self._candidates(z):
            if np.all(free[group]):
                members = self._joined(z, free, group, p_guess)
                p_WO, covariance = triangulate(rows(z, np.array(members)), p_guess)
                free[members] = False
                radius = _radius(p_WO, rows(z, np.array(members)))
                cameras = frozenset(int(z.camera[i]) for i in members)
                made.append(Newborn(p_WO, covariance, radius, cameras))
        return made

    def _candidates(self, z: Polar) -> list[tuple[list[int], Array]]:
        """Rows that may be one obstacle and where it is, best first: ranges, then pairs of rays."""
        ranged = np.flatnonzero(z.range_m > 0.0)
        found = [([int(i)], z.p_WC[i] + z.range_m[i] * z.axes[i, 2]) for i in ranged]
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

    def _joined(self, z: Polar, free: Array, group: list[int], p_guess: Array) -> list[int]:
        """The group and, of every other camera, the free bearing that fits best."""
        members = list(group)
        p_WO, covariance = triangulate(rows(z, np.array(members)), p_guess)
        squared, _ = gate(p_WO[None], covariance[None], z)
        fits = free & (squared[0] < self.gap_sigmas**2 + 2.0)
        for camera in np.unique(z.camera):
            if camera not in z.camera[members]:
                mine = np.flatnonzero(fits & (z.camera == camera))
                if len(mine):
                    members.append(int(mine[np.argmin(squared[0, mine])]))
        return members


def _radius(p_WO: Array, z: Polar) -> float:
    """Mean over the cameras of the radius that each sees [m]."""
    distance = np.linalg.norm(p_WO - z.p_WC, axis=1)
    return float(np.mean(distance * np.sin(z.half_angle)))
