# SPDX-License-Identifier: Apache-2.0
"""What does not look like the room behind it, in the images of one camera.

The room is known, and so is how the camera moved: the image before, moved to where each wall, the
floor and the roof now appear, must be the image of now. Whatever stands or flies in front of
them, seen from two places or at two times, differs. No distance comes of it, but a direction.

    u' = project(T_C'C X(u)), X(u) where the ray of pixel u meets the room
    off(u) = mean |I(u) - I'(u')| - noise, in units of the image's own gradient: in pixels
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from skyhaul.geometry.camera import pixel_rays, project_points
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.model.state import TeamState
from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.perception.obstacles.api import Bearings
from skyhaul.perception.obstacles.own_bodies import blind_cells, own_bodies
from skyhaul.perception.scene.evidence import Evidence, ray_is_blocked
from skyhaul.perception.scene.pieces import Pieces, pieces_of
from skyhaul.sensors.api import CameraCalibration, GreyImage
from skyhaul.types import US_PER_S, Array, Mask, TimeUs

Float32 = NDArray[np.float32]

_HALF = 2
"""Images are looked at with half their pixels."""
_LONGEST_US = 250_000
"""Images farther apart than this are not compared [us]."""


@dataclass(frozen=True, kw_only=True)
class BackdropRules(Params):
    """How much an image may differ from the room."""

    noise: float = 1.5
    """Mean difference that is noise [grey levels]."""
    off_px: float = 1.2
    """A place that is off by more differs [px of the raw image]."""
    blur: float = 0.8
    """Standard deviation of the smoothing that comes first: fine texture is noise [half pixels]."""
    window: int = 5
    """Edge of the window over which differences are averaged, odd [half pixels]."""
    least_size: int = 16
    """Smaller pieces are noise [half pixels]."""
    most_share: float = 0.3
    """An image that differs in a larger share was compared at a wrong pose, and says nothing."""
    reach_m: float = 6.0
    """What standing voxels up to here explain is no news [m]."""
    body_margin_m: float = 0.02
    """The team's own bodies are left out with this margin [m]."""

    def __post_init__(self) -> None:
        if self.window < 3 or self.window % 2 == 0:
            raise ValueError(f"window must be odd and >= 3, got {self.window}")
        if not 0.0 < self.most_share <= 1.0:
            raise ValueError(f"most_share must lie in (0, 1], got {self.most_share}")


class Shot(NamedTuple):
    """An image and where its camera was."""

    stamp_us: TimeUs
    image: Float32  # (rows, columns), half size
    p_WC: Array  # (3,) [m]
    R_WC: Array  # (3, 3)
    own: Mask  # (rows, columns) the team itself is there


class BackdropWatch:
    """One camera of one vehicle; `step` has its memory outside."""

    def __init__(
        self, rules: BackdropRules, vehicle: int, name: int, team: Team, camera: CameraCalibration,
        room: Array,
    ) -> None:  # fmt: skip
        self.rules, self.vehicle, self.name, self.team = rules, vehicle, name, team
        self.camera, self.room = camera, room
        width, height = camera.model.size_px
        rays = pixel_rays(camera.model).reshape(height, width, 3)
        first = _HALF // 2
        between = 0.25 * (
            rays[:-1:_HALF, :-1:_HALF] + rays[first::_HALF, :-1:_HALF]
            + rays[:-1:_HALF, first::_HALF] + rays[first::_HALF, first::_HALF]
        )  # fmt: skip
        self.rays_C = between / np.linalg.norm(between, axis=2, keepdims=True)
        self.focal_px = float(camera.model.arrays().fx)

    def step(
        self, last: Shot | None, stamp_us: TimeUs, image: GreyImage, team: TeamState,
        attached: Mask, covariance: Array, evidence: Evidence,
    ) -> tuple[Shot, Bearings]:  # fmt: skip
        """Compare an image with the one before.

        Args:
            last: The image before; None at first.
            stamp_us: Time of the image [us].
            image: The image.
            team: Where everything is when it is taken.
            attached: Cables that join a vehicle and the load, (n,).
            covariance: Of the vehicle's pose, (6, 6).
            evidence: What stands, which is no news.
        """
        now = self._shot(stamp_us, image, team, attached, covariance)
        v_WC = team.v_WB[self.vehicle].copy()
        if last is None or stamp_us - last.stamp_us > _LONGEST_US:
            return now, _none(stamp_us, self.name, now.p_WC, v_WC)
        off, comparable = self._off(last, now)
        differs = comparable & (off > self.rules.off_px)
        if int(differs.sum()) > self.rules.most_share * max(int(comparable.sum()), 1):
            return now, _none(stamp_us, self.name, now.p_WC, v_WC)
        flat = np.ones(differs.shape)
        pieces = pieces_of(self.rays_C, flat, differs, differs, 1.0, 0.0)
        age_s = 0.5 * (stamp_us - last.stamp_us) / US_PER_S
        return now, self._bearings(now, pieces, ~comparable, v_WC, covariance, age_s, evidence)

    def _shot(
        self, stamp_us: TimeUs, image: GreyImage, team: TeamState, attached: Mask, covariance: Array
    ) -> Shot:
        R_WB = quat_to_R(team.q_WB[self.vehicle])
        R_WC, p_WC = R_WB @ self.camera.R_BC, team.p_WB[self.vehicle] + R_WB @ self.camera.p_BC
        height, width = image.shape
        half = cv2.resize(
            image.astype(np.float32), (width // _HALF, height // _HALF),
            interpolation=cv2.INTER_AREA,
        )  # fmt: skip
        own = self._own(R_WC, p_WC, team, attached, covariance)
        smooth = cv2.GaussianBlur(half, (0, 0), self.rules.blur)
        return Shot(stamp_us, np.asarray(smooth, np.float32), p_WC, R_WC, own)

    def _own(
        self, R_WC: Array, p_WC: Array, team: TeamState, attached: Mask, covariance: Array
    ) -> Mask:
        """Where the team itself is, with what the window smears."""
        rays = self.rays_C[1::2, 1::2]
        bodies = own_bodies(self.team, team, attached, self.vehicle)
        sigma_p, sigma_angle = _sigmas(covariance)
        slack = _HALF * (0.5 * self.rules.window + 0.5) / self.focal_px + 2.0 * sigma_angle
        margin_m = self.rules.body_margin_m + sigma_p
        blind: Mask = blind_cells(rays.reshape(-1, 3) @ R_WC.T, p_WC, bodies, margin_m, slack)
        cells = blind.reshape(rays.shape[:2])
        rows, columns = self.rays_C.shape[:2]
        return np.repeat(np.repeat(cells, 2, axis=0), 2, axis=1)[:rows, :columns]

    def _off(self, last: Shot, now: Shot) -> tuple[Float32, Mask]:
        """By how many pixels each place is off at most, and where the two can be compared."""
        rows, columns = now.image.shape
        d = self.rays_C @ now.R_WC.T
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(d > 0.0, self.room[1] - now.p_WC, self.room[0] - now.p_WC) / d
        points_W = now.p_WC + d * np.nanmin(far, axis=2)[..., None]
        points_C = (points_W - last.p_WC) @ last.R_WC
        uv, seen = project_points(self.camera.model, points_C.reshape(-1, 3))
        half = ((uv + 0.5) / _HALF - 0.5).astype(np.float32).reshape(rows, columns, 2)
        u, v = np.ascontiguousarray(half[..., 0]), np.ascontiguousarray(half[..., 1])
        before = cv2.remap(last.image, u, v, cv2.INTER_LINEAR)
        hidden = cv2.remap(last.own.astype(np.float32), u, v, cv2.INTER_LINEAR) > 0.0
        window = (self.rules.window, self.rules.window)
        difference = cv2.boxFilter(np.abs(now.image - before), -1, window)
        slope = np.hypot(
            cv2.Sobel(now.image, cv2.CV_32F, 1, 0, scale=1.0 / (8 * _HALF)),
            cv2.Sobel(now.image, cv2.CV_32F, 0, 1, scale=1.0 / (8 * _HALF)),
        )
        gradient = cv2.boxFilter(slope, -1, window) + 1.0
        off = np.maximum(difference - self.rules.noise, 0.0) / gradient
        edge = self.rules.window
        inside = (u > edge) & (u < columns - 1 - edge) & (v > edge) & (v < rows - 1 - edge)
        rim = np.zeros_like(inside)
        rim[edge:-edge, edge:-edge] = True
        return off, inside & rim & seen.reshape(rows, columns) & ~hidden & ~now.own

    def _bearings(
        self, now: Shot, pieces: Pieces, blind: Mask, v_WC: Array, covariance: Array,
        age_s: float, evidence: Evidence,
    ) -> Bearings:  # fmt: skip
        r = self.rules
        big = np.flatnonzero(pieces.size >= r.least_size)
        rays = pieces.mean[big] @ now.R_WC.T
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        news = np.array(
            [not ray_is_blocked(evidence, now.p_WC, d, r.reach_m) for d in rays], dtype=np.bool_
        )
        i, rays = big[news], rays[news]
        extent = (pieces.last[i] - pieces.first[i] + 1).astype(np.float64) - r.window
        half_px = 0.5 * _HALF * np.maximum(extent.max(axis=1, initial=1.0), 1.0)
        half_angle = np.arctan(half_px / self.focal_px)
        near_blind = cv2.dilate(blind.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        cut = np.isin(i, pieces.label[near_blind])
        sigma_p, sigma_angle = _sigmas(covariance)
        sigma = np.hypot(_HALF * 1.0 / self.focal_px, 0.2 * half_angle)
        sigma = np.sqrt(sigma**2 + sigma_angle**2 + (sigma_p / 3.0) ** 2)
        sigma = np.where(cut, sigma + half_angle + 0.05, sigma)
        ones = np.ones(len(i))
        return Bearings(
            now.stamp_us, self.name, np.tile(now.p_WC - age_s * v_WC, (len(i), 1)), v_WC, rays,
            sigma, half_angle, np.nan * ones, np.nan * ones, age_s * ones, ones,
        )  # fmt: skip


def _none(stamp_us: TimeUs, name: int, p_WC: Array, v_WC: Array) -> Bearings:
    """Nothing was seen."""
    z = np.zeros(0)
    return Bearings(
        stamp_us, name, np.tile(p_WC, (0, 1)), v_WC, np.zeros((0, 3)), z, z.copy(), z.copy(),
        z.copy(), z.copy(), z.copy(),
    )  # fmt: skip


def _sigmas(covariance: Array) -> tuple[float, float]:
    """Standard deviations of position [m] and of attitude [rad], the mean over the axes."""
    return (
        float(np.sqrt(np.trace(covariance[:3, :3]) / 3.0)),
        float(np.sqrt(np.trace(covariance[3:, 3:]) / 3.0)),
    )
