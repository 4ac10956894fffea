# SPDX-License-Identifier: Apache-2.0
"""The pixels of an event camera: their parameters, and events from one rendering to the next."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyhaul.errors import GeometryError
from skyhaul.params import Params
from skyhaul.sensors.api import EventReading
from skyhaul.sensors.events.kernel import (
    Change,
    Fired,
    Floats,
    Pixels,
    PixelState,
    PixelTraits,
    View,
    advance,
)
from skyhaul.sensors.events.noise import waiting_times
from skyhaul.sensors.events.pixel import PixelLaw
from skyhaul.sensors.truth_api import EventLabels
from skyhaul.types import US_PER_S, Array, IntArray, TimeUs

_LEAST_THRESHOLD = 0.01


class PixelMemory(NamedTuple):
    """Pixels after a rendering. `EventPixels.step` changes it: go on with what it returns."""

    t_us: TimeUs
    width: int
    view: View
    log_light: Floats  # (k,)
    pixels: Pixels


@dataclass(frozen=True, kw_only=True)
class EventPixels(Params):
    """How the pixels turn light into events; defaults are those of a DAVIS-like sensor indoors.

    Source: Lichtsteiner, Posch, Delbruck, A 128x128 120 dB 15 us latency asynchronous temporal
    contrast vision sensor, JSSC 2008 (pixel, mismatch, noise); Brandli et al., A 240x180 130 dB
    3 us latency global shutter spatiotemporal vision sensor, JSSC 2014 (thresholds, mismatch);
    Nozaki, Delbruck, Temperature and parasitic photocurrent effects in dynamic vision sensors,
    TED 2017 (leak); Hu, Liu, Delbruck, v2e: from video frames to realistic DVS events, CVPRW 2021
    (bandwidth and shot noise by intensity, what is typical).
    """

    threshold_on: float = 0.22
    """Rise of log intensity for an ON event, mean of the pixels."""
    threshold_off: float = 0.18
    """Fall of log intensity for an OFF event, mean of the pixels."""
    threshold_spread: float = 0.03
    """Standard deviation of both thresholds over the pixels, in log intensity."""
    refractory_us: float = 300.0
    """Time after an event for which the pixel is held in reset [us]."""
    leak_hz: float = 0.1
    """Rate at which a pixel fires ON in constant light because its reference leaks [Hz]."""
    shot_hz: float = 0.2
    """Rate of noise events of a pixel in the dark [Hz]."""
    shot_bright_share: float = 0.25
    """Share of that rate which is left at intensity 1; between them it falls on a line."""
    hot_share: float = 0.001
    """Share of pixels that fire by themselves."""
    hot_hz: float = 10.0
    """Rate of those [Hz]."""
    cutoff_hz: float = 300.0
    """Cutoff of the photoreceptor's low-pass at intensity 1 [Hz]; it is proportional to the
    intensity. Infinite: no low-pass."""
    cutoff_floor: float = 0.1
    """Intensity below which the cutoff falls no more."""
    dark_level: float = 0.01
    """Intensity that the dark current amounts to: pixels see log(intensity + dark_level)."""

    def __post_init__(self) -> None:
        self._check_positive()
        for name, value in (
            ("threshold_spread", self.threshold_spread),
            ("refractory_us", self.refractory_us),
        ):
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name} must be >= 0 and finite, got {value}")
        for name, value in (
            ("leak_hz", self.leak_hz),
            ("shot_hz", self.shot_hz),
            ("hot_hz", self.hot_hz),
        ):
            if not 0.0 <= value <= 1e4:
                raise ValueError(f"{name} must be in 0 .. 10000, got {value}")
        for name, value in (
            ("shot_bright_share", self.shot_bright_share),
            ("hot_share", self.hot_share),
        ):
            if not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} must be in 0 .. 1, got {value}")

    def _check_positive(self) -> None:
        for name, value in (
            ("threshold_on", self.threshold_on),
            ("threshold_off", self.threshold_off),
        ):
            if not value >= _LEAST_THRESHOLD:
                raise ValueError(f"{name} must be >= {_LEAST_THRESHOLD}, got {value}")
        if not self.cutoff_hz > 0.0:
            raise ValueError(f"cutoff_hz must be > 0, got {self.cutoff_hz}")
        if not self.cutoff_floor > 0.0:
            raise ValueError(f"cutoff_floor must be > 0, got {self.cutoff_floor}")
        if not self.dark_level >= 1e-4:
            raise ValueError(f"dark_level must be >= 0.0001, got {self.dark_level}")

    def init(self, view: View, width: int, t_us: TimeUs, rng: np.random.Generator) -> PixelMemory:
        """Pixels that have looked at a view for long.

        Their references lie anywhere between the thresholds, as those of a camera that runs do.

        Args:
            view: The first rendering.
            width: Pixels a row.
            t_us: Its time [us].
            rng: Draws what differs from pixel to pixel, and the key of the noise.

        Limits: A pixel whose light is no finite number sees darkness, here, and then what it saw
            before.
        """
        size = view.light.shape[0]
        if width < 1 or size % width:
            raise GeometryError(f"{size} pixels do not fill rows of {width}: give whole rows.")
        traits, law = self._traits(rng, size), self._law(rng)
        view = _finite(view, np.zeros(size, np.float32))
        u = self._log_light(view)
        state = PixelState(
            low_pass=u.copy(),
            reference=u + rng.uniform(-1.0, 1.0, size) * np.minimum(traits.on, traits.off),
            free_us=np.full(size, t_us - 1.0),
            noise_us=t_us + waiting_times(law.key, law.shot + traits.hot),
            draws=np.ones(size, np.int64),
            cause=view.surface.copy(),
            owed=np.zeros(size, np.float32),
        )
        return PixelMemory(t_us, width, view, u, Pixels(state, traits, law))

    def step(
        self, memory: PixelMemory, view: View, t_us: TimeUs
    ) -> tuple[PixelMemory, EventReading, EventLabels]:
        """Events since the rendering before, in order of time; equal stamps row by row.

        Args:
            memory: The pixels at the rendering before; taken over and changed in place.
            view: What they see now; its arrays are kept, so do not write to them again.
            t_us: Now [us], after the rendering before.

        Limits: A pixel whose light is no finite number sees what it saw before: the low-pass would
            never forget it.
        """
        if view.light.shape != memory.pixels.state.reference.shape or t_us <= memory.t_us:
            raise GeometryError(
                f"A view of {view.light.shape[0]} pixels at {t_us} us cannot follow one of "
                f"{memory.pixels.state.reference.shape[0]} at {memory.t_us} us: "
                "give views of one size, in order of time."
            )
        view = _finite(view, memory.view.light)
        u = self._log_light(view)
        change = self._change(memory.log_light, u, view.light, t_us - memory.t_us)
        fired = advance(memory.pixels, memory.view, view, change, memory.t_us, t_us)
        reading, labels = _in_order(fired, memory.width)
        return memory._replace(t_us=t_us, view=view, log_light=u), reading, labels

    def _log_light(self, view: View) -> Floats:
        u: Floats = np.log(view.light + np.float32(self.dark_level))
        return u

    def _change(self, u0: Floats, u1: Floats, light: Floats, dt_us: int) -> Change:
        """How the low-pass follows the light for dt; its cutoff is that of the light at the end."""
        per_light = np.float32(2.0 * math.pi * self.cutoff_hz * dt_us / US_PER_S)
        rate = per_light * np.maximum(light, np.float32(self.cutoff_floor))
        return Change(u0, u1, rate, np.exp(-rate))

    def _traits(self, rng: np.random.Generator, size: int) -> PixelTraits:
        """Draw what differs from pixel to pixel."""
        on = self._thresholds(rng, self.threshold_on, size)
        off = self._thresholds(rng, self.threshold_off, size)
        hot = np.where(rng.random(size) < self.hot_share, self.hot_hz / US_PER_S, 0.0)
        return PixelTraits(on, off, self.leak_hz / US_PER_S * on, hot)

    def _thresholds(self, rng: np.random.Generator, mean: float, size: int) -> Array:
        drawn = rng.normal(mean, self.threshold_spread, size)
        return np.maximum(drawn, _LEAST_THRESHOLD)

    def _law(self, rng: np.random.Generator) -> PixelLaw:
        return PixelLaw(
            key=rng.integers(2**64, dtype=np.uint64),
            refractory_us=self.refractory_us,
            shot=self.shot_hz / US_PER_S,
            shot_bright=self.shot_bright_share,
        )


def _finite(view: View, otherwise: Floats) -> View:
    """The view with other light for pixels whose light is no finite number."""
    good = np.isfinite(view.light)
    return view if good.all() else view._replace(light=np.where(good, view.light, otherwise))


def _in_order(fired: Fired, width: int) -> tuple[EventReading, EventLabels]:
    """Sort by time; what is simultaneous stays in the order of the pixels."""
    order = np.argsort(_since_first(fired.t_us), kind="stable")
    pixel = fired.pixel[order]
    reading = EventReading(
        t_us=fired.t_us[order],
        x=(pixel % width).astype(np.int16),
        y=(pixel // width).astype(np.int16),
        p=fired.polarity[order],
    )
    return reading, EventLabels(fired.label[order])


def _since_first(t_us: IntArray) -> NDArray[np.integer]:
    """Times in 16 bit where they fit: those are sorted by radix, which is far faster."""
    if t_us.size == 0:
        return t_us
    since: IntArray = t_us - t_us.min()
    return since.astype(np.uint16) if since.max() < 2**16 else since
