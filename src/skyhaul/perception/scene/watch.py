# SPDX-License-Identifier: Apache-2.0
"""One vehicle's stereo pair watched: depth -> pieces -> what moves, what stands, what is free.

A piece moves when a good share of its points lies in open space, where rays have passed and
nothing stood, or when it lies where a confirmed track is predicted. What moves becomes bearings
with ranges and is kept out of the voxels; all else that is seen becomes evidence.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.model.state import TeamState
from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.perception.api import Track
from skyhaul.perception.obstacles.api import Bearings, VehicleView
from skyhaul.perception.obstacles.own_bodies import blind_cells, own_bodies
from skyhaul.perception.scene.evidence import (
    Evidence,
    EvidenceRules,
    in_open,
    take_hits,
    take_misses,
)
from skyhaul.perception.scene.pieces import Pieces, pieces_of
from skyhaul.perception.scene.stereo import StereoPair
from skyhaul.types import US_PER_S, Array, Mask, TimeUs

_RIM = np.ones((5, 5), np.uint8)
"""What is so near to where nothing can be seen may go on there."""
_CUT_RAD = 0.05
"""By how much the middle of what is cut off may be off, besides its size [rad]."""


@dataclass(frozen=True, kw_only=True)
class ViewRules(Params):
    """How a depth image is read."""

    evidence: EvidenceRules = field(default_factory=EvidenceRules)
    """What hits and misses say."""
    step_px: int = 2
    """Every so many pixels and rows are looked at [px]."""
    ray_step: int = 2
    """Of these pixels every so many and of their rows send a ray through the voxels."""
    range_m: float = 4.0
    """Obstacles count up to this depth [m] ..."""
    carve_m: float = 5.0
    """... and rays free voxels up to this one [m]."""
    wall_m: float = 0.12
    """What is so near to a wall of the room is the wall [m] ..."""
    wall_sigmas: float = 2.5
    """... and so many standard deviations of the depth besides."""
    body_margin_m: float = 0.05
    """The team's own bodies are left out with this margin [m]."""
    jump_m: float = 0.12
    """Step of depth between neighbours of one piece [m] ..."""
    jump_sigmas: float = 1.5
    """... and so many standard deviations of the depth besides."""
    least_points: int = 8
    """Pieces with fewer points are noise."""
    moving_share: float = 0.3
    """Share of a piece's points that lie where nothing stood, from which on it moves."""
    track_share: float = 0.5
    """Share of a piece's points inside a track, from which on it belongs to it."""
    track_margin_m: float = 0.15
    """Tracks are grown by this, and by their tube, for that [m]."""
    middle: float = 0.7
    """The middle of a piece lies behind its mean point by this share of its half size."""

    def __post_init__(self) -> None:
        if self.step_px < 1 or self.least_points < 1:
            raise ValueError("step_px and least_points must be >= 1")
        if not 0.0 < self.range_m <= self.carve_m:
            raise ValueError(f"range_m must lie in (0, carve_m], got {self.range_m}")


class Glance(NamedTuple):
    """A depth image on its grid, in the world."""

    p_WC: Array  # (3,) [m]
    R_WC: Array  # (3, 3)
    points_W: Array  # (rows, columns, 3) [m]
    z: Array  # (rows, columns) along the optical axis [m]
    sigma: Array  # (rows, columns) of it [m]
    seen: Mask  # (rows, columns) there is a point, and it is not of the team itself
    inside: Mask  # (rows, columns) it may be an obstacle: inside the room, in range
    rim: Mask  # (rows, columns) next to where nothing can be seen: the border, the team itself


@dataclass(frozen=True, eq=False)
class SceneWatch:
    """The chain of one vehicle."""

    vehicle: int
    team: Team
    pair: StereoPair
    rules: ViewRules
    room: Array  # (2, 3) smallest and largest corner [m]

    def step(
        self, evidence: Evidence, frame: int, team: TeamState, attached: Mask,
        view: VehicleView, tracks: Sequence[Track],
    ) -> tuple[Bearings, Pieces]:  # fmt: skip
        """Read two images; changes the evidence in place.

        Args:
            evidence: Of the whole team.
            frame: Number of these images, larger than all before.
            team: Where everything is when the images are taken.
            attached: Cables that join a vehicle and the load, (n,).
            view: The images.
            tracks: Confirmed ones.

        Returns:
            What moves, and all pieces.
        """
        r = self.rules
        glance = self._glance(team, attached, view)
        use = glance.inside
        free = np.zeros_like(use)
        free[use] = in_open(evidence, glance.points_W[use])
        per_z2 = r.jump_sigmas * self._per_z2
        pieces = pieces_of(glance.points_W, glance.z, use, free, r.jump_m, per_z2)
        tracked = self._tracked(glance, tracks, view.stamp_us)
        moving = self._moving(pieces, tracked)
        still = (pieces.size >= r.least_points) & ~moving
        stands = np.append(still, False)[pieces.label] & ~tracked  # label -1: no piece
        take_hits(r.evidence, evidence, frame, glance.points_W[stands])
        take_misses(r.evidence, evidence, frame, glance.p_WC, self._ends(glance))
        return self._bearings(glance, pieces, moving, team, view), pieces

    @property
    def _per_z2(self) -> float:
        p = self.pair.params
        return p.sigma_px / (p.focal_px * self.pair.baseline_m)

    def _glance(self, team: TeamState, attached: Mask, view: VehicleView) -> Glance:
        r, camera = self.rules, self.pair.left
        R_WB = quat_to_R(team.q_WB[self.vehicle])
        R_WC, p_WC = R_WB @ camera.R_BC, team.p_WB[self.vehicle] + R_WB @ camera.p_BC
        depth = self.pair.depth(view.left, view.right)
        points_C, known = depth.points_C(r.step_px)
        z = points_C[..., 2]
        sigma = depth.sigma_per_z2 * z**2
        points_W = p_WC + points_C @ R_WC.T
        own = self._own(R_WC, p_WC, team, attached, view)
        seen = known & ~own
        from_wall = np.minimum(points_W - self.room[0], self.room[1] - points_W).min(axis=-1)
        with np.errstate(invalid="ignore"):
            inside = seen & (z <= r.range_m) & (from_wall > r.wall_m + r.wall_sigmas * sigma)
        first = r.step_px // 2
        blind = own | ~self.pair.valid[first :: r.step_px, first :: r.step_px]
        rim = cv2.dilate(blind.astype(np.uint8), _RIM, borderValue=1) > 0
        return Glance(p_WC, R_WC, points_W, z, sigma, seen, inside, rim)

    def _own(
        self, R_WC: Array, p_WC: Array, team: TeamState, attached: Mask, view: VehicleView
    ) -> Mask:
        """Where in the image the team itself is: rays that pass a body, cell by cell."""
        p, step = self.pair.params, self.rules.step_px
        height, width = self.pair.valid.shape
        v, u = np.mgrid[step : height : 2 * step, step : width : 2 * step]
        x, y = (u - 0.5 * (width - 1)) / p.focal_px, (v - 0.5 * (height - 1)) / p.focal_px
        rays_C = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
        rays_C /= np.linalg.norm(rays_C, axis=1, keepdims=True)
        bodies = own_bodies(self.team, team, attached, self.vehicle)
        cov = view.pose_covariance
        margin_m = self.rules.body_margin_m + 2.0 * float(np.sqrt(np.trace(cov[:3, :3]) / 3.0))
        slack = 2.0 * float(np.sqrt(np.trace(cov[3:, 3:]) / 3.0))
        slack += (0.5 * p.block_px + step) / p.focal_px
        own = blind_cells(rays_C @ R_WC.T, p_WC, bodies, margin_m, slack).reshape(v.shape)
        rows, columns = len(range(step // 2, height, step)), len(range(step // 2, width, step))
        return np.repeat(np.repeat(own, 2, axis=0), 2, axis=1)[:rows, :columns]

    def _tracked(self, glance: Glance, tracks: Sequence[Track], t_us: TimeUs) -> Mask:
        """Which points lie where a track is predicted now."""
        out = np.zeros_like(glance.inside)
        points = glance.points_W[glance.inside]
        inside = np.zeros(len(points), np.bool_)
        for track in tracks:
            dt_s = (t_us - track.stamp_us) / US_PER_S
            radius = self._reach(track) + min(track.tube_m(dt_s), 0.5)
            off = points - (track.p_WO + track.v_WO * dt_s)
            inside |= np.einsum("kc,kc->k", off, off) < radius**2
        out[glance.inside] = inside
        return out

    def _reach(self, track: Track) -> float:
        kind = track.shape
        assert kind.kind == "sphere", "trackers hand out balls"
        return kind.radius_m + self.rules.track_margin_m

    def _moving(self, pieces: Pieces, tracked: Mask) -> Mask:
        """Which pieces move, (m,)."""
        r = self.rules
        named = pieces.label[tracked & (pieces.label >= 0)]
        in_track = np.bincount(named, minlength=len(pieces.size))
        share = np.maximum(pieces.free / r.moving_share, in_track / r.track_share)
        moving: Mask = (pieces.size >= r.least_points) & (share >= pieces.size)
        return moving

    def _ends(self, glance: Glance) -> Array:
        """Where rays end: short of their points, and not beyond `carve_m`, (k, 3) [m]."""
        r, e = self.rules, self.rules.evidence
        every = np.zeros_like(glance.seen)
        every[:: r.ray_step, :: r.ray_step] = True
        every &= glance.seen
        points, z = glance.points_W[every], glance.z[every]
        short = np.maximum(e.short_sigmas * glance.sigma[every], e.short_m)
        share = (np.minimum(z - short, r.carve_m) / z)[:, None]
        kept = share[:, 0] > 0.0
        ends: Array = (glance.p_WC + share * (points - glance.p_WC))[kept]
        return ends

    def _bearings(
        self, glance: Glance, pieces: Pieces, moving: Mask, team: TeamState, view: VehicleView
    ) -> Bearings:
        """Directions and distances of the middles of what moves, with their errors."""
        r, p = self.rules, self.pair.params
        i = np.flatnonzero(moving)
        rel = pieces.mean[i] - glance.p_WC
        depth = rel @ glance.R_WC[:, 2]
        extent_px = (pieces.last[i] - pieces.first[i] + 1) * float(r.step_px)
        half_m = 0.5 * extent_px.max(axis=1) * depth / p.focal_px
        surface = np.linalg.norm(rel, axis=1)
        range_m = surface + r.middle * half_m
        cut = np.isin(i, pieces.label[glance.rim])
        per_px = 1.0 / p.focal_px
        in_image = np.hypot(r.step_px * per_px, 0.1 * half_m / range_m)
        cov = view.pose_covariance
        sigma_p = float(np.sqrt(np.trace(cov[:3, :3]) / 3.0))
        sigma_angle = float(np.sqrt(np.trace(cov[3:, 3:]) / 3.0))
        sigma = np.sqrt(in_image**2 + sigma_angle**2 + (sigma_p / range_m) ** 2)
        half_angle = np.arcsin(np.minimum(half_m / range_m, 0.9))
        sigma = np.where(cut, sigma + half_angle + _CUT_RAD, sigma)
        of_depth = self._per_z2 * depth**2
        ones = np.ones(len(i))
        return Bearings(
            view.stamp_us, self.vehicle, np.tile(glance.p_WC, (len(i), 1)),
            team.v_WB[self.vehicle].copy(), rel / surface[:, None], sigma, half_angle, range_m,
            np.sqrt(of_depth**2 + (0.25 * half_m) ** 2 + sigma_p**2), 0.0 * ones, ones,
        )  # fmt: skip
