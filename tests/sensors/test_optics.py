# SPDX-License-Identifier: Apache-2.0
"""A lens of a scenario file: the same camera by its field of view and by its calibration."""

import math

import pytest

from skyhaul.geometry.camera import Equidistant, RadTan, unproject_pixels
from skyhaul.sensors.optics import LensParams

WIDE = LensParams(size_px=(320, 240), fov_deg=84.0, distortion=(-0.283, 0.074, 2e-4, 0.0))
FISH = LensParams(kind="equidistant", size_px=(160, 120), fov_deg=150.0)


@pytest.mark.parametrize(("lens", "cls"), [(WIDE, RadTan), (FISH, Equidistant)])
def test_the_middle_row_sees_the_field_of_view(lens, cls):
    model = lens.model()
    assert isinstance(model, cls)
    w, h = model.size_px
    left, right = unproject_pixels(model, [[-0.5, 0.5 * (h - 1)], [w - 0.5, 0.5 * (h - 1)]])
    assert math.degrees(math.acos(left @ right)) == pytest.approx(lens.fov_deg, abs=0.05)


@pytest.mark.parametrize("lens", [WIDE, FISH])
def test_a_calibration_in_place_of_the_field_of_view_gives_the_same_camera(lens):
    model = lens.model()
    calibrated = LensParams(
        kind=lens.kind, size_px=lens.size_px, distortion=lens.distortion,
        focal_px=model.focal_px, center_px=model.center_px,
    )  # fmt: skip
    assert calibrated.model() == model


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"focal_px": (200.0, 200.0)},
        {"center_px": (159.5, 119.5)},
        {"fov_deg": 84.0, "focal_px": (200.0, 200.0), "center_px": (159.5, 119.5)},
        {"fov_deg": 84.0, "center_px": (159.5, 119.5)},
    ],
)
def test_half_a_lens_and_two_lenses_are_refused(given):
    with pytest.raises(ValueError, match="give either fov_deg, or focal_px and center_px"):
        LensParams(**given)


@pytest.mark.parametrize(("kind", "fov_deg"), [("radtan", 180.0), ("equidistant", 0.0)])
def test_a_field_of_view_that_no_such_lens_has_is_refused(kind, fov_deg):
    with pytest.raises(ValueError, match="fov_deg must lie in"):
        LensParams(kind=kind, fov_deg=fov_deg)


def test_a_distortion_that_folds_the_image_over_bounds_the_field_of_view():
    """theta (1 - 0.5 theta^2) grows up to theta = sqrt(2/3): 93.6 deg from edge to edge."""
    with pytest.raises(ValueError, match=r"fov_deg must be below 93\.6 with this distortion"):
        LensParams(kind="equidistant", fov_deg=94.0, distortion=(-0.5, 0.0, 0.0, 0.0))
    LensParams(kind="equidistant", fov_deg=93.0, distortion=(-0.5, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"fov_deg must be below 60\.0 with this distortion"):
        LensParams(fov_deg=61.0, distortion=(-1.0, 0.0, 0.0, 0.0))  # r^2 < 1/3


@pytest.mark.parametrize("size_px", [(1, 1), (320, 8), (5000, 240)])
def test_images_that_are_too_small_or_too_large_are_refused(size_px):
    with pytest.raises(ValueError, match="size_px must lie between 16 and 4096"):
        LensParams(size_px=size_px, fov_deg=80.0)
