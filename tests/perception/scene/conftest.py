# SPDX-License-Identifier: Apache-2.0
"""A room with balls in it, and the depth that a stereo pair would see of it."""

from dataclasses import dataclass

import numpy as np

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.model.team import Team
from skyhaul.perception.obstacles.api import TeamViews, VehicleView
from skyhaul.perception.scene.from_cameras import CameraObstacles
from skyhaul.perception.scene.stereo import DepthImage, StereoPair, StereoParams
from skyhaul.sensors.config import SensorsConfig

from ..obstacles.conftest import state_of  # noqa: TID252

TEAM, CALIBRATION = Team(), SensorsConfig().calibration()
ROOM = np.array([[-6.0, -6.0, 0.0], [6.0, 6.0, 6.0]])
VOXEL = 0.1
CELLS = np.array([120, 120, 60])
FRAME_US = 100_000
LOOK = np.zeros((6, 6))


@dataclass(frozen=True)
class Ball:
    """A ball that flies straight on."""

    p: tuple[float, float, float]
    v: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius_m: float = 0.2

    def place(self, t_s):
        return np.array(self.p) + t_s * np.array(self.v)


def z_image(pair, R_WC, p_WC, balls, t_s, rng=None):
    """Depth of the nearest of walls and balls along every pixel's ray, with noise if asked for."""
    height, width = pair.valid.shape
    v, u = np.mgrid[0:height, 0:width]
    f = pair.params.focal_px
    rays = np.stack(
        [(u - 0.5 * (width - 1)) / f, (v - 0.5 * (height - 1)) / f, np.ones_like(u, float)], -1
    )
    d = rays @ R_WC.T
    with np.errstate(divide="ignore"):
        z = np.where(d > 0.0, (ROOM[1] - p_WC) / d, (ROOM[0] - p_WC) / d).min(axis=-1)
    for ball in balls:
        rel = ball.place(t_s) - p_WC
        a, b = np.einsum("ijc,ijc->ij", d, d), d @ rel
        disc = b**2 - a * (rel @ rel - ball.radius_m**2)
        with np.errstate(invalid="ignore"):
            hit = (b - np.sqrt(disc)) / a
        z = np.where((disc > 0.0) & (hit > 0.0) & (hit < z), hit, z)
    if rng is not None:
        z = z + 0.5 * pair.params.sigma_px / (f * pair.baseline_m) * z**2 * rng.normal(size=z.shape)
    z[~pair.valid] = np.nan
    return z.astype(np.float32)


class DepthPair(StereoPair):
    """A pair whose left image already is its depth."""

    def depth(self, left, right):
        per_z2 = self.params.sigma_px / (self.params.focal_px * self.baseline_m)
        return DepthImage(left, self.params.focal_px, per_z2)


def depth_pair():
    built = StereoParams().build(CALIBRATION.rig)
    return DepthPair(built.params, built.index, built.left, built.right)


def scene(params=None):
    """The estimator of a team whose pairs give exact depth."""
    from dataclasses import replace

    params = params or CameraObstacles()
    built = params.build(TEAM, CALIBRATION, ROOM, ROOM[0] + 0.5 * VOXEL, VOXEL, CELLS)
    pair = depth_pair()
    return replace(built, watches=tuple(replace(w, pair=pair) for w in built.watches))


def views(estimator, balls, k, *, rng=None, vehicles=range(4)):
    """What the team has at frame k: it hovers, its vehicles look outward."""
    t_us, team = k * FRAME_US, state_of(TEAM)
    out = []
    for i in vehicles:
        pair = estimator.watches[i].pair
        R_WB = quat_to_R(team.q_WB[i])
        R_WC, p_WC = R_WB @ pair.left.R_BC, team.p_WB[i] + R_WB @ pair.left.p_BC
        z = z_image(pair, R_WC, p_WC, balls, 1e-6 * t_us, rng)
        out.append(VehicleView(i, t_us, z, z, LOOK))
    return TeamViews(t_us, team, np.ones(TEAM.count, bool), tuple(out))


def follow(estimator, balls, frames, first=0, memory=None, **how):
    """Estimates over some frames, and the memory at the end."""
    memory, out = memory or estimator.init(), []
    for k in range(first, first + frames):
        memory, estimate = estimator.step(memory, views(estimator, balls, k, **how))
        out.append(estimate)
    return memory, out
