# SPDX-License-Identifier: Apache-2.0
"""The planning part of the configuration."""

from dataclasses import dataclass, field

from skyhaul.model.envelope import TeamShape
from skyhaul.params import Params
from skyhaul.planning.api import ReferencePlanner
from skyhaul.planning.cubic import CubicPlanner
from skyhaul.planning.heading import Heading
from skyhaul.planning.replan import SplinePlanner


@dataclass(frozen=True, kw_only=True)
class PlanningConfig(Params):
    """Paths and references."""

    margin_m: float = 0.15
    """Added on every side of the team's shape: swing, tracking error, tilt [m]."""
    planner: SplinePlanner | CubicPlanner = field(default_factory=SplinePlanner)
    """What plans."""
    heading: Heading = field(default_factory=Heading)
    """How the vehicles yaw."""

    def __post_init__(self) -> None:
        if self.margin_m < 0.0:
            raise ValueError(f"margin_m must be >= 0, got {self.margin_m}")

    def build(self, shape: TeamShape) -> ReferencePlanner:
        """The planner of one flight."""
        return self.planner.build(shape)
