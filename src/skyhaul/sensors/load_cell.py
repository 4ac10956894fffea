# SPDX-License-Identifier: Apache-2.0
"""A load cell in the hook: the tension of one cable."""

from dataclasses import dataclass

import numpy as np

from skyhaul.params import Params
from skyhaul.plant.api import PLANT_STEP_US, Truth
from skyhaul.sensors.api import LoadCellReading
from skyhaul.sensors.streams import Source, stream
from skyhaul.types import US_PER_S, Array, TimeUs

_BLOCK = 256
_UNIT = 0
"""Part of the stream with the errors of the unit; parts 1 + b hold the noise of block b."""


@dataclass(frozen=True, eq=False)
class LoadCellMemory:
    """Errors of the unit, and the noise to come."""

    seed: int
    body: int
    scale: float
    zero_n: float
    noise: Array  # (_BLOCK,) variates of the block in use
    samples: int  # so far


@dataclass(frozen=True, kw_only=True)
class LoadCell(Params):
    """Measures the tension in a hook at an instant.

    Source:
        Figures of a miniature S-beam cell of 20 N: 0.1 % of full scale in all (ours).
    """

    rate_hz: int = 100
    """Samples a second; divides the 500 steps of the plant [Hz]."""
    noise_n: float = 0.02
    """Standard deviation of a sample's noise [N]."""
    zero_n: float = 0.02
    """Standard deviation of the reading without tension [N]."""
    scale_error: float = 0.005
    """Standard deviation of the error of the scale [-]."""
    range_n: float = 20.0
    """Largest tension that is measured [N]."""

    def __post_init__(self) -> None:
        steps = US_PER_S // PLANT_STEP_US
        if not (self.rate_hz > 0 and steps % self.rate_hz == 0):
            raise ValueError(f"rate_hz must divide {steps}, got {self.rate_hz}")
        for name in ("noise_n", "zero_n", "scale_error"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")
        if not self.range_n > 0.0:
            raise ValueError(f"range_n must be > 0, got {self.range_n}")

    @property
    def period_us(self) -> TimeUs:
        """Time between samples [us]."""
        return US_PER_S // self.rate_hz

    def init(self, seed: int, body: int) -> LoadCellMemory:
        """Turn on."""
        z = stream(seed, body, Source.LOAD_CELL, _UNIT).standard_normal(2)
        scale, zero = 1.0 + self.scale_error * float(z[0]), self.zero_n * float(z[1])
        return LoadCellMemory(seed, body, scale, zero, _noise(seed, body, 0), 0)

    def step(
        self, memory: LoadCellMemory, truth: Truth
    ) -> tuple[LoadCellMemory, LoadCellReading | None]:
        """Read the tension of the body's cable where a sample is due."""
        if truth.stamp_us % self.period_us:
            return memory, None
        row, noise = memory.samples % _BLOCK, memory.noise
        if row == 0 and memory.samples:
            noise = _noise(memory.seed, memory.body, memory.samples // _BLOCK)
        exact = float(truth.cables.tension[memory.body - 1])
        value = memory.scale * exact + memory.zero_n + self.noise_n * float(noise[row])
        value = min(max(value, -self.range_n), self.range_n)
        after = LoadCellMemory(
            memory.seed, memory.body, memory.scale, memory.zero_n, noise, memory.samples + 1
        )
        return after, LoadCellReading(np.array([truth.stamp_us]), np.array([value]))


def _noise(seed: int, body: int, block: int) -> Array:
    return stream(seed, body, Source.LOAD_CELL, 1 + block).standard_normal(_BLOCK)
