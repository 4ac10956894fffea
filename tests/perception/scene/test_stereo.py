# SPDX-License-Identifier: Apache-2.0
"""Depth of painted walls, and what is no stereo pair."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from skyhaul.errors import ConfigError
from skyhaul.geometry.camera import pixel_rays
from skyhaul.perception.scene.stereo import StereoParams, pair_of
from skyhaul.sensors.api import RigCalibration

from .conftest import CALIBRATION

RIG = CALIBRATION.rig
PAINT = np.random.default_rng(3).normal(size=(1200, 1200))
PAINT = gaussian_filter(PAINT, 1.2, mode="wrap")
PAINT = 120.0 + 60.0 * PAINT / PAINT.std()
PER_M = 100.0


def picture(camera, normal, distance):
    """Image of a painted plane n . p = distance in the left camera's axes, by ray casting."""
    width, height = camera.model.size_px
    rays = pixel_rays(camera.model).reshape(height, width, 3)
    off_C = RIG.cameras[0].R_BC.T @ (camera.p_BC - RIG.cameras[0].p_BC)
    t = (distance - off_C @ normal) / (rays @ normal)
    points = off_C + t[..., None] * rays
    i, j = (np.rint(PER_M * points[..., k]).astype(int) % 1200 for k in (0, 1))
    return np.clip(PAINT[i, j], 0, 255).astype(np.uint8)


@pytest.mark.parametrize("distance", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.3, 0.2, 0.933)])
def test_depth_of_a_painted_wall_is_right_within_its_sigma(normal, distance):
    pair = StereoParams().build(RIG)
    n = np.array(normal) / np.linalg.norm(normal)
    depth = pair.depth(*(picture(RIG.cameras[k], n, distance) for k in pair.index))
    points, known = depth.points_C(2)
    off = points[known] @ n - distance
    sigma = depth.sigma_per_z2 * points[known][:, 2] ** 2
    assert known.sum() > 0.5 * pair.valid[1::2, 1::2].sum()
    assert abs(np.median(off / sigma)) < 0.7
    assert np.median(np.abs(off) / sigma) < 1.0
    assert np.mean(np.abs(off) < 4.0 * sigma) > 0.97


def test_nothing_is_known_where_one_image_ends():
    pair = StereoParams().build(RIG)
    wall = [picture(RIG.cameras[k], np.array([0.0, 0.0, 1.0]), 2.0) for k in pair.index]
    assert np.all(np.isnan(pair.depth(*wall).z[~pair.valid]))
    assert not pair.valid[:, : pair.params.disparities].any()


def test_a_grey_wall_has_no_depth():
    pair = StereoParams().build(RIG)
    grey = np.full((240, 320), 127, np.uint8)
    assert np.isnan(pair.depth(grey, grey).z).all()


def test_the_front_pair_is_found_left_before_right():
    assert pair_of(RIG) == (0, 1)
    swapped = RigCalibration((RIG.cameras[1], RIG.cameras[2], RIG.cameras[0]), None)
    assert pair_of(swapped) == (2, 0)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda c: replace(c, R_BC=c.R_BC @ np.diag([-1.0, -1.0, 1.0])),
        lambda c: replace(c, p_BC=c.p_BC + np.array([0.0, 0.0, 0.02])),
        lambda c: replace(c, rate_hz=20.0),
    ],
)
def test_cameras_that_differ_are_no_pair(spoil):
    rig = RigCalibration((RIG.cameras[0], spoil(RIG.cameras[1])), None)
    assert pair_of(rig) is None
    with pytest.raises(ConfigError, match="needs a stereo pair"):
        StereoParams().build(rig)


@pytest.mark.parametrize(
    "wrong", [{"disparities": 40}, {"block_px": 8}, {"focal_px": 0.0}, {"sigma_px": -1.0}]
)
def test_parameters_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        StereoParams(**wrong)
