# SPDX-License-Identifier: Apache-2.0
"""How bright surfaces are: light by closed form, and coarse images against fine ones averaged."""

import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan, pixel_rays
from skyhaul.sensors.imaging.arrays import NOBODY
from skyhaul.sensors.imaging.atlas import build_atlas
from skyhaul.sensors.imaging.frame import blank_frame
from skyhaul.sensors.imaging.lens import make_lens
from skyhaul.sensors.imaging.raycast import render
from skyhaul.sensors.imaging.shading import AMBIENT, SKYLIGHT, SUN
from skyhaul.sensors.rig import mount_rotation

EYE = np.array([-1.0, 0.2, 2.2])
FORWARD = mount_rotation(0.0, -3.0, 0.0)
COARSE = RadTan.from_fov((56, 40), 80.0)
FINER = 6


def picture(arrays, model, p=EYE, R=FORWARD):
    lens = make_lens(model)
    frame = blank_frame(arrays, lens)
    render(arrays, lens, p, np.ascontiguousarray(R), NOBODY, frame)
    return frame


@pytest.fixture
def bare(scene, hovering):
    """The scene with the team behind the camera."""
    scene.pose(hovering(p_WL=(-3.5, 0.0, 1.0)))
    return scene.arrays


def test_white_things_are_lit_by_sun_and_sky(bare):
    count = len(bare.atlas.order)
    white = bare._replace(atlas=build_atlas([np.ones((8, 8), np.float32)] * count))
    frame, ball = picture(white, COARSE), bare.parts.object == 7
    (k,) = np.flatnonzero(ball)
    on = frame.object_id == 7
    inner = on & np.roll(on, 1, 0) & np.roll(on, -1, 0) & np.roll(on, 1, 1) & np.roll(on, -1, 1)
    at = EYE + frame.range[inner][:, None] * (pixel_rays(COARSE) @ FORWARD.T)[inner]
    n = (at - bare.parts.p_WP[k]) / bare.parts.size[k, 0]
    lit = AMBIENT + SKYLIGHT * (0.5 + 0.5 * n[:, 2]) + SUN * np.maximum(n @ bare.sun, 0.0)
    assert inner.sum() > 10
    assert np.ptp(lit) > 0.15
    np.testing.assert_allclose(frame.grey[inner], lit, rtol=1e-5)


def test_a_coarse_image_is_the_mean_of_a_fine_one(bare):
    """Mip maps inside of surfaces and four rays at their rims stand for many rays each."""
    w, h = COARSE.size_px
    fine = RadTan.from_fov((FINER * w, FINER * h), 80.0)
    grey = picture(bare, fine).grey.reshape(h, FINER, w, FINER)
    mean, middle = grey.mean(axis=(1, 3)), grey[:, FINER // 2, :, FINER // 2]
    frame = picture(bare, COARSE)
    here = frame.hit
    rim = np.zeros((h, w), dtype=bool)
    rim[1:] |= here[1:] != here[:-1]
    rim[:-1] |= here[1:] != here[:-1]
    rim[:, 1:] |= here[:, 1:] != here[:, :-1]
    rim[:, :-1] |= here[:, 1:] != here[:, :-1]

    def rms(image, where):
        return float(np.sqrt(np.mean((image - mean)[where] ** 2)))

    assert rim.sum() > 60
    assert rms(frame.grey, ~rim) < 0.6 * rms(middle, ~rim)
    assert rms(frame.grey, rim) < 0.6 * rms(middle, rim)
    assert abs(float(np.mean(frame.grey - mean))) < 0.004


def test_the_tag_is_not_mirrored_and_lies_on_the_plate(bare, scene):
    """The plate from above, load axes x to the right and y up, against the texture."""
    load = bare.objects.p_WO[9]
    R = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    model = RadTan(size_px=(36, 36), focal_px=(180.0, 180.0), center_px=(17.5, 17.5))
    bare.objects.present[10:] = False
    frame = picture(bare, model, load + np.array([0.0, 0.0, 1.04]), R)
    k = int(np.flatnonzero(bare.parts.object == 9)[0])
    begin, size = bare.atlas.start[bare.parts.face[k, 5] + 1] - 257 * 257, 256
    texture = bare.atlas.texel[begin : begin + 257 * 257].reshape(257, 257)[:size, :size]
    columns = ((np.arange(36) + 0.5) / 36 * size).astype(int)
    expected = texture[np.ix_(columns, columns)]
    assert np.all(frame.object_id == 9)
    seen = frame.grey > np.median(frame.grey[[0, -1]]) / 2.0
    score, *turned = (np.mean(seen == (e > 0.45)) for e in (
        expected, expected[:, ::-1], expected[::-1], expected.T, np.rot90(expected)
    ))  # fmt: skip
    assert score > 0.96
    assert max(turned) < score - 0.03
