# SPDX-License-Identifier: Apache-2.0
"""The events of a flickering lamp."""

from dataclasses import dataclass

import numpy as np

from skyhaul.sensors.api import EventReading
from skyhaul.sensors.faults import EventBurst
from skyhaul.sensors.streams import Source, stream
from skyhaul.sensors.truth_api import NOISE_LABEL, EventLabels
from skyhaul.types import US_PER_S, TimeUs


@dataclass(frozen=True, eq=False)
class Flicker:
    """One burst in the image of one event camera."""

    fault: EventBurst
    index: int  # of the fault in the scenario
    size_px: tuple[int, int]

    def between(self, seed: int, body: int, after_us: TimeUs, until_us: TimeUs) -> EventReading:
        """Events in (after, until], however a longer time is cut into such pieces.

        Each half period has dice of its own: a Poisson number of events, evenly spread over the
        half period and the region.
        """
        fault = self.fault
        begin_s, half_s = fault.start_s, 0.5 / fault.flicker_hz
        end_us = round((begin_s + fault.duration_s) * US_PER_S)
        low_us = max(after_us, round(begin_s * US_PER_S) - 1)
        high_us = min(until_us, end_us - 1)
        if high_us <= low_us:
            return join([])
        first = max(0, int((low_us / US_PER_S - begin_s) / half_s) - 1)
        last = int((high_us / US_PER_S - begin_s) / half_s) + 1
        whole = join([self._half(seed, body, k) for k in range(first, last + 1)])
        keep = (whole.t_us > low_us) & (whole.t_us <= high_us)
        return EventReading(whole.t_us[keep], whole.x[keep], whole.y[keep], whole.p[keep])

    def _half(self, seed: int, body: int, k: int) -> EventReading:
        fault = self.fault
        half_s = 0.5 / fault.flicker_hz
        rng = stream(seed, body, Source.FAULTS, self.index, k)
        count = int(rng.poisson(fault.rate_hz * half_s))
        x0, y0, columns, rows = fault.region_px or (0, 0, *self.size_px)
        t_s = fault.start_s + half_s * (k + np.sort(rng.random(count)))
        return EventReading(
            np.floor(t_s * US_PER_S).astype(np.int64),
            rng.integers(x0, x0 + columns, count).astype(np.int16),
            rng.integers(y0, y0 + rows, count).astype(np.int16),
            np.full(count, 1 if k % 2 == 0 else -1, dtype=np.int8),
        )


def join(parts: list[EventReading]) -> EventReading:
    """Readings that follow each other as one."""
    return EventReading(
        np.concatenate([np.empty(0, np.int64), *(e.t_us for e in parts)]),
        np.concatenate([np.empty(0, np.int16), *(e.x for e in parts)]),
        np.concatenate([np.empty(0, np.int16), *(e.y for e in parts)]),
        np.concatenate([np.empty(0, np.int8), *(e.p for e in parts)]),
    )


def mixed(
    events: EventReading, labels: EventLabels, extra: EventReading
) -> tuple[EventReading, EventLabels]:
    """Events and labels with those of a lamp among them, in order of time; its label is noise."""
    both = join([events, extra])
    order = np.argsort(both.t_us, kind="stable")
    noise = np.full(len(extra.t_us), NOISE_LABEL, dtype=np.int16)
    ids = np.concatenate([labels.object_id, noise])
    return (
        EventReading(both.t_us[order], both.x[order], both.y[order], both.p[order]),
        EventLabels(ids[order]),
    )
