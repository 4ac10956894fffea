# SPDX-License-Identifier: Apache-2.0
"""What the sensors know and do not tell: for evaluation and training, never for perception."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyhaul.types import Array, frozen

NOISE_LABEL, SKY_LABEL = -1, -2
"""Labels of events that no object caused."""


@dataclass(frozen=True, eq=False)
class EventLabels:
    """Which object caused each event."""

    object_id: NDArray[np.int16]  # (k,) row of the event's object in the scene; or see above

    def __post_init__(self) -> None:
        frozen(self.object_id)


@dataclass(frozen=True, eq=False)
class SensorTruth:
    """What a vehicle's sensors know besides their reading."""

    labels: EventLabels | None  # of the events of the same reading
    imu_bias: Array  # (6,) of gyro and accelerometer now [rad/s, m/s^2]

    def __post_init__(self) -> None:
        frozen(self.imu_bias)


@dataclass(frozen=True)
class LabelName:
    """What a label means."""

    id: int
    name: str
    kind: str  # room, static, mover, payload, vehicle, cable, noise or sky
