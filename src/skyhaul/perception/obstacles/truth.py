# SPDX-License-Identifier: Apache-2.0
"""Obstacles from perfect readings: those that stand are remembered, those that move are tracked."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.api import ObstacleEstimate, StaticObject, Track
from skyhaul.sensors.api import ObjectReading, ObjectsReading
from skyhaul.types import US_PER_S, TimeUs


@dataclass(frozen=True, eq=False)
class ObstacleMemory:
    """What is known so far."""

    statics: dict[int, StaticObject] = field(default_factory=dict)
    tracks: dict[int, Track] = field(default_factory=dict)
    confirmed_after: dict[int, int] = field(default_factory=dict)  # readings still needed


@dataclass(frozen=True, kw_only=True)
class TruthObstacles(Params):
    """Exact poses and velocities; a track lives on for a while after it was last seen."""

    kind: Literal["truth"] = "truth"
    confirm_readings: int = 2
    """Readings that confirm a track (M of M: perfect readings never miss)."""
    forget_s: float = 1.0
    """A track not seen for this long is dropped [s]."""
    tube_base_m: float = 0.02
    """Radius of the predicted tube now [m]."""
    growth_mps: float = 0.1
    """Growth of the predicted tube: what an obstacle's manoeuvres may add [m/s]."""

    def __post_init__(self) -> None:
        if self.confirm_readings < 1:
            raise ValueError(f"confirm_readings must be >= 1, got {self.confirm_readings}")
        for name in ("forget_s", "tube_base_m", "growth_mps"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name)}")

    def init(self) -> ObstacleMemory:
        """See `ObstacleEstimator.init`."""
        return ObstacleMemory()

    def step(
        self, memory: ObstacleMemory, reading: ObjectsReading
    ) -> tuple[ObstacleMemory, ObstacleEstimate]:
        """See `ObstacleEstimator.step`."""
        now = reading.stamp_us
        statics = dict(memory.statics)
        tracks = {
            k: t
            for k, t in memory.tracks.items()
            if now - t.stamp_us <= round(self.forget_s * US_PER_S)
        }
        waiting = {k: m for k, m in memory.confirmed_after.items() if k in tracks}
        for o in reading.objects:
            if not o.moves:
                if not _stands_as(statics.get(o.object_id), o):
                    statics[o.object_id] = StaticObject(o.object_id, o.shape, o.p_WO, o.R_WO)
                continue
            statics.pop(o.object_id, None)
            waiting[o.object_id] = max(0, waiting.get(o.object_id, self.confirm_readings) - 1)
            tracks[o.object_id] = self._track(o, now)
        confirmed = tuple(t for k, t in tracks.items() if waiting[k] == 0)
        estimate = ObstacleEstimate(now, tuple(statics.values()), confirmed)
        return ObstacleMemory(statics, tracks, waiting), estimate

    def _track(self, o: ObjectReading, now: TimeUs) -> Track:
        return Track(
            track_id=o.object_id,
            stamp_us=now,
            shape=o.shape,
            p_WO=o.p_WO,
            R_WO=o.R_WO,
            v_WO=o.v_WO,
            covariance=np.zeros((6, 6)),
            growth_mps=self.growth_mps,
            tube_base_m=self.tube_base_m,
        )


def _stands_as(known: StaticObject | None, o: ObjectReading) -> bool:
    """Whether an object that stands is where it is known to stand."""
    if known is None:
        return False
    return known.p_WO.tobytes() == o.p_WO.tobytes() and known.R_WO.tobytes() == o.R_WO.tobytes()
