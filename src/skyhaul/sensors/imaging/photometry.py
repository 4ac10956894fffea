# SPDX-License-Identifier: Apache-2.0
"""From light to grey levels: exposure, vignetting, saturation, shot and read noise, 8 bits.

A pixel of scene brightness b under light level L fills, at exposure e, the share s = L e v b of
its well (v: vignetting). Gain g beyond the longest exposure amplifies signal and noise alike. With
electrons N = s W / g in a well of W:

    level = 255 min(1, s + g sqrt(N + read^2) / W n),  n standard normal

Noise is drawn by hashing (key, pixel): it does not depend on the order in which images are made,
nor on the process.
"""

import math
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Literal, NamedTuple

import numpy as np

from skyhaul.geometry.camera import CameraModel
from skyhaul.jit import njit_ieee
from skyhaul.params import Params
from skyhaul.sensors.api import GreyImage
from skyhaul.sensors.imaging.atlas import Grey

# mypy: disable-error-code="no-any-return,assignment"

_BITS = 12
_GOLDEN, _MIX_A, _MIX_B = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


@dataclass(frozen=True, kw_only=True)
class FixedExposure(Params):
    """The same exposure for every image."""

    kind: Literal["fixed"] = "fixed"
    exposure: float = 1.0
    """Share of the well that a white surface fills in full light."""

    def __post_init__(self) -> None:
        if not self.exposure > 0.0:
            raise ValueError(f"exposure must be > 0, got {self.exposure}")


@dataclass(frozen=True, kw_only=True)
class AutoExposure(Params):
    """Steers the mean of the images; a sudden change of light saturates them for a while."""

    kind: Literal["auto"] = "auto"
    target: float = 0.42
    """Mean of the image, as a share of full scale."""
    time_constant_s: float = 0.3
    """Time in which a wrong exposure falls to 1/e of its logarithm [s]."""
    exposure: float = 1.0
    """Of the first image."""
    exposure_min: float = 0.05
    """Shortest exposure."""
    exposure_max: float = 4.0
    """Longest exposure; brighter only by gain, which makes noise."""
    gain_max: float = 8.0
    """Largest gain."""

    def __post_init__(self) -> None:
        if not 0.0 < self.target < 1.0:
            raise ValueError(f"target must lie in (0, 1), got {self.target}")
        if not self.time_constant_s > 0.0:
            raise ValueError(f"time_constant_s must be > 0, got {self.time_constant_s}")
        if not 0.0 < self.exposure_min <= self.exposure <= self.exposure_max:
            raise ValueError(
                "exposure_min, exposure and exposure_max must be > 0 and in this order, got "
                f"{self.exposure_min}, {self.exposure}, {self.exposure_max}"
            )
        if not self.gain_max >= 1.0:
            raise ValueError(f"gain_max must be >= 1, got {self.gain_max}")


@dataclass(frozen=True, kw_only=True)
class Photometry(Params):
    """How a camera turns light into grey levels.

    Source: Wells of 10 000 electrons and a read noise of 7: small global-shutter sensors of 2020
    (On Semiconductor AR0144, MT9V034 class). At mid grey the noise is 1.8 of 255.
    """

    exposure: FixedExposure | AutoExposure = field(default_factory=AutoExposure)
    """Exposure."""
    well_e: float = 10_000.0
    """Electrons that saturate a pixel."""
    read_noise_e: float = 7.0
    """Noise of reading a pixel, standard deviation [electrons]."""
    vignetting: float = 0.25
    """Share of the light that the corners lose."""

    def __post_init__(self) -> None:
        if not (self.well_e > 0.0 and self.read_noise_e >= 0.0):
            raise ValueError(
                f"well_e must be > 0 and read_noise_e >= 0, got {self.well_e}, {self.read_noise_e}"
            )
        if not 0.0 <= self.vignetting < 1.0:
            raise ValueError(f"vignetting must lie in [0, 1), got {self.vignetting}")

    def first_exposure(self) -> float:
        """Exposure of the first image."""
        return self.exposure.exposure

    def next_exposure(self, exposure: float, mean: float, period_s: float) -> float:
        """Exposure, gain included, of the image after one whose mean was `mean` of full scale."""
        rule = self.exposure
        if isinstance(rule, FixedExposure):
            return exposure
        share = 1.0 - math.exp(-period_s / rule.time_constant_s)
        wanted = exposure * math.pow(rule.target / max(mean, 1e-4), share)
        return min(max(wanted, rule.exposure_min), rule.exposure_max * rule.gain_max)

    def gain(self, exposure: float) -> float:
        """The part of an exposure that is gain."""
        rule = self.exposure
        return 1.0 if isinstance(rule, FixedExposure) else max(exposure / rule.exposure_max, 1.0)


class Sensor(NamedTuple):
    """A camera's sensor, for the kernel."""

    vignette: Grey  # (height, width)
    normal: Grey  # quantiles of the standard normal distribution
    well: float
    read: float


def make_sensor(photometry: Photometry, model: CameraModel) -> Sensor:
    """Tables of one camera."""
    w, h = model.size_px
    (cx, cy), (x, y) = model.center_px, np.meshgrid(np.arange(w), np.arange(h))
    square = (x - cx) ** 2 + (y - cy) ** 2
    vignette = 1.0 - photometry.vignetting * square / square.max()
    return Sensor(
        vignette.astype(np.float32), _normal_quantiles(), photometry.well_e, photometry.read_noise_e
    )


def _normal_quantiles() -> Grey:
    """Standard normal numbers that are equally likely, their variance exactly 1."""
    count = 1 << _BITS
    values = np.array([NormalDist().inv_cdf((i + 0.5) / count) for i in range(count)])
    scaled: Grey = (values / values.std()).astype(np.float32)
    return scaled


@njit_ieee
def expose(
    grey: Grey, sensor: Sensor, exposure: float, gain: float, key: int, out: GreyImage
) -> float:
    """Write the image of a rendered frame, and return the mean of its signal, 0..1.

    Args:
        grey: Linear intensity, (height, width).
        sensor: Of the camera.
        exposure: Light level times exposure, gain included.
        gain: The part of it that is gain.
        key: Names the image; same key, same noise.
        out: Written, (height, width).
    """
    height, width = grey.shape
    # variance of the signal: g^2 (N + read^2) / W^2 with N = s W / g
    shot = np.float32(gain / sensor.well)
    floor = np.float32((gain * sensor.read / sensor.well) ** 2)
    scale, one, zero = np.float32(exposure), np.float32(1.0), np.float32(0.0)
    full, half = np.float32(255.0), np.float32(0.5)
    vignette, normal = sensor.vignette, sensor.normal
    total, bits, mask = 0.0, np.uint64(0), np.uint64((1 << _BITS) - 1)
    state = np.uint64(key)
    for y in range(height):
        line = np.float32(0.0)
        for x in range(width):
            if x & 3 == 0:  # four numbers of 12 bits from each hash
                state += np.uint64(_GOLDEN)
                bits = state
                bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(_MIX_A)
                bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(_MIX_B)
                bits ^= bits >> np.uint64(31)
            signal = scale * vignette[y, x] * grey[y, x]
            line += min(signal, one)
            noise = normal[bits & mask]
            bits >>= np.uint64(_BITS)
            value = signal + noise * np.sqrt(shot * signal + floor)
            out[y, x] = np.uint8(min(max(value, zero), one) * full + half)
        total += line
    return total / (height * width)
