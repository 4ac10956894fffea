# SPDX-License-Identifier: Apache-2.0
"""Grey levels against the noise model's own numbers, and how exposure behaves."""

import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan
from skyhaul.sensors.imaging.photometry import (
    AutoExposure,
    FixedExposure,
    Photometry,
    expose,
    make_sensor,
)

MODEL = RadTan.from_fov((320, 200), 80.0)
EVEN = Photometry(exposure=FixedExposure(), vignetting=0.0)


def image(grey, photometry=EVEN, exposure=1.0, gain=1.0, key=1):
    even = np.full(MODEL.size_px[::-1], grey, dtype=np.float32)
    out = np.empty(even.shape, dtype=np.uint8)
    mean = expose(even, make_sensor(photometry, MODEL), exposure, gain, key, out)
    return out, mean


@pytest.mark.parametrize(("grey", "gain"), [(0.05, 1.0), (0.3, 1.0), (0.7, 1.0), (0.3, 6.0)])
def test_noise_has_the_mean_and_the_variance_of_shot_and_read_noise(grey, gain):
    out, mean = image(grey, gain=gain)
    electrons = grey * EVEN.well_e / gain
    sigma = 255.0 * gain * np.sqrt(electrons + EVEN.read_noise_e**2) / EVEN.well_e
    expected = np.sqrt(sigma**2 + 1.0 / 12.0)  # rounding adds its own
    assert mean == pytest.approx(grey, rel=1e-5)
    assert out.mean() == pytest.approx(255.0 * grey, abs=5.0 * sigma / np.sqrt(out.size) + 0.01)
    assert out.std() == pytest.approx(expected, rel=0.02)


def test_noise_is_normal_and_pixels_do_not_know_each_other():
    rng = np.random.default_rng(0)
    noise = image(0.5, gain=8.0)[0] + rng.uniform(-0.5, 0.5, MODEL.size_px[::-1])  # undo rounding
    z = (noise - noise.mean()) / noise.std()
    assert np.mean(np.abs(z) < 1.0) == pytest.approx(0.683, abs=0.01)
    assert np.mean(np.abs(z) > 2.0) == pytest.approx(0.0455, abs=0.006)
    other = image(0.5, gain=8.0, key=2)[0].astype(float)
    limit = 4.0 / np.sqrt(z.size)
    for shift in [(0, 1), (0, 2), (0, 3), (0, 4), (1, 0), (2, 0)]:
        assert abs(np.mean(z * np.roll(z, shift, (0, 1)))) < limit
    assert abs(np.corrcoef(noise.ravel(), other.ravel())[0, 1]) < limit


def test_the_key_alone_decides_the_noise():
    a, b, c = image(0.4, key=7)[0], image(0.4, key=7)[0], image(0.4, key=8)[0]
    assert a.tobytes() == b.tobytes()
    assert np.mean(a != c) > 0.5


def test_what_is_too_bright_saturates():
    assert np.all(image(3.0)[0] == 255)
    assert image(3.0)[1] == pytest.approx(1.0)


def test_corners_lose_the_share_that_vignetting_says():
    photometry = Photometry(exposure=FixedExposure(), vignetting=0.4, read_noise_e=0.0, well_e=1e9)
    out = image(0.8, photometry)[0].astype(float)
    assert out[0, 0] / out[100, 160] == pytest.approx(0.6, abs=0.01)
    assert out[0, 0] == out[-1, -1] == out[0, -1]


def exposures(levels, rule, brightness=0.5, period_s=0.1):
    """Means of the images and exposures while the light level changes."""
    photometry, exposure, means = Photometry(exposure=rule), rule.exposure, []
    for level in levels:
        signal = min(level * exposure * brightness, 1.0)
        means.append(signal)
        exposure = photometry.next_exposure(exposure, signal, period_s)
    return np.array(means), exposure, photometry


def test_a_sudden_light_saturates_and_the_exposure_recovers_with_its_time_constant():
    rule = AutoExposure(time_constant_s=0.3)
    means, _, _ = exposures([1.0] * 30 + [6.0] * 40, rule)
    assert means[29] == pytest.approx(0.42, abs=0.01)
    assert means[30] == 1.0  # saturated
    error = np.abs(np.log(means[31:] / 0.42))
    unsaturated = means[31:] < 1.0
    rates = error[1:] / error[:-1]
    np.testing.assert_allclose(rates[unsaturated[:-1]][:8], np.exp(-0.1 / 0.3), rtol=1e-6)
    assert means[-1] == pytest.approx(0.42, abs=0.01)


def test_darkness_is_met_by_exposure_first_and_gain_last():
    rule = AutoExposure(exposure_max=4.0, gain_max=8.0)
    _, dim, photometry = exposures([0.3] * 80, rule)
    assert photometry.gain(dim) == 1.0
    means, dark, _ = exposures([0.05] * 80, rule)
    assert photometry.gain(dark) == pytest.approx(dark / 4.0)
    assert means[-1] == pytest.approx(0.42, abs=0.01)
    _, night, _ = exposures([1e-4] * 80, rule)
    assert night == 32.0


def test_a_fixed_exposure_stays():
    assert EVEN.next_exposure(1.0, 0.01, 0.1) == 1.0
    assert EVEN.gain(30.0) == 1.0


def test_impossible_sensors_are_refused():
    with pytest.raises(ValueError, match="well_e must be > 0"):
        Photometry(well_e=0.0)
    with pytest.raises(ValueError, match="vignetting must lie in"):
        Photometry(vignetting=1.0)
    with pytest.raises(ValueError, match="target must lie in"):
        AutoExposure(target=1.2)
    with pytest.raises(ValueError, match=r"in this order, got 0\.05, 9\.0, 4\.0"):
        AutoExposure(exposure=9.0)
