# SPDX-License-Identifier: Apache-2.0
"""The team's state from perfect readings."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from skyhaul.params import Params
from skyhaul.perception.api import TeamEstimate
from skyhaul.sensors.api import TeamReading
from skyhaul.types import LOAD_NE

_NO_COVARIANCE = np.zeros((LOAD_NE, LOAD_NE))


@dataclass(frozen=True, kw_only=True)
class TruthTeam(Params):
    """Hands the perfect reading on; covariance zero."""

    kind: Literal["truth"] = "truth"

    def init(self) -> tuple[()]:
        """Nothing to remember."""
        return ()

    def step(self, memory: tuple[()], reading: TeamReading) -> tuple[tuple[()], TeamEstimate]:
        """See `TeamEstimator.step`."""
        return (), TeamEstimate(
            stamp_us=reading.stamp_us,
            team=reading.team,
            cables=reading.cables,
            attached=reading.attached,
            thrust=reading.thrust,
            load_covariance=_NO_COVARIANCE,
        )
