# SPDX-License-Identifier: Apache-2.0
"""Thin cables: the light they take is theirs wherever they run between the pixels."""

import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan, pixel_rays
from skyhaul.sensors.rig import mount_rotation

CAMERA = RadTan.from_fov((96, 64), 60.0)
EYE = np.array([0.0, -3.4, 2.0])
TOWARDS = mount_rotation(90.0, 0.0, 0.0)
CABLE = 14  # object id of cable 0


@pytest.fixture
def against_white(scene, hovering, see):
    """Returns a function: what is taken by cable 0 alone, upright at (x, y), from even light."""

    def taken(x, y, radius, lean=0.0, model=CAMERA):
        scene.pose(hovering(p_WL=(-3.5, 0.0, 1.0)))
        arrays = scene.arrays
        arrays.objects.present[6:] = False
        bare = see(scene, model, EYE, TOWARDS).grey.copy()
        arrays.objects.present[CABLE] = True
        parts, k = arrays.parts, len(arrays.parts.kind) - 4
        length = 1.6
        z = np.array([np.sin(lean), 0.0, np.cos(lean)])
        parts.size[k, :2] = radius, 0.5 * length
        parts.p_WP[k] = (x, y, 2.0)
        parts.R_WP[k] = np.column_stack([[z[2], 0.0, -z[0]], [0.0, 1.0, 0.0], z])
        on = arrays.balls.part == k
        arrays.balls.p_W[on] = parts.p_WP[k] + np.outer(arrays.balls.along[on] * 0.8, z)
        arrays.balls.radius[on] = radius + arrays.balls.share[on] * 0.8
        frame = see(scene, model, EYE, TOWARDS)
        share = (bare - frame.grey) / (bare - parts.gain[k])
        return share, frame

    return taken


@pytest.mark.parametrize("lean", [0.0, 0.3, 0.785])
@pytest.mark.parametrize("radius", [0.002, 0.02])
def test_a_cable_covers_its_area_wherever_it_runs(against_white, radius, lean):
    """Its share of the image is 2 r l (f / z)^2, at every place between two columns of pixels."""
    focal = CAMERA.focal_px[0]
    shares = []
    for step in range(9):
        x = 0.07 + step / 8 * 2.0 / focal  # over two thirds of a pixel
        share, _ = against_white(x, -0.4, radius, lean)
        shares.append(share.sum())
    expected = 2.0 * radius * 1.6 * (focal / 3.0) ** 2
    assert np.mean(shares) == pytest.approx(expected, rel=0.05)
    assert np.ptp(shares) < 0.06 * expected  # its two ends make up most of it


def test_a_cable_thinner_than_a_pixel_has_no_gaps(against_white):
    """0.05 pixels thick, leaning: every row that it crosses names it and its distance."""
    share, frame = against_white(0.1, -0.4, 0.0008, 0.5)
    named = frame.object_id == CABLE
    rows = np.flatnonzero((share > 1e-4).any(axis=1))
    assert 0.02 < share.max() < 0.2
    assert np.all(named[rows[1:-1]].any(axis=1))
    at = EYE + frame.range[..., None] * (pixel_rays(CAMERA) @ TOWARDS.T)
    np.testing.assert_allclose(at[named][:, 1], -0.4, atol=0.002)


def test_a_cable_behind_something_is_hidden(against_white):
    share, frame = against_white(0.1, 4.2, 0.01)  # beyond the wall
    assert np.all(share == 0.0)
    assert not np.any(frame.object_id == CABLE)


def test_cables_run_from_hooks_to_vehicles(scene, hovering, see):
    truth = hovering(p_WL=(0.0, 0.0, 1.5))
    scene.pose(truth)
    frame = see(scene, CAMERA, EYE, TOWARDS)
    parts = scene.arrays.parts
    for i in range(4):
        k = len(parts.kind) - 4 + i
        ends = [parts.p_WP[k] + s * parts.size[k, 1] * parts.R_WP[k, :, 2] for s in (-1.0, 1.0)]
        np.testing.assert_allclose(ends[0], truth.team.p_WL + scene.hooks_L[i], atol=1e-9)
        np.testing.assert_allclose(ends[1], truth.team.p_WB[i], atol=1e-9)
        assert np.sum(frame.object_id == CABLE + i) > 5
    object.__setattr__(truth, "attached", np.array([True, True, False, True]))
    scene.pose(truth)
    assert not np.any(see(scene, CAMERA, EYE, TOWARDS).object_id == CABLE + 2)
