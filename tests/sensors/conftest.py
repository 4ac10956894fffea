# SPDX-License-Identifier: Apache-2.0
"""True states made by hand."""

import numpy as np
import pytest

from skyhaul.geometry.shapes import pose_shapes
from skyhaul.model.state import CableState, TeamState
from skyhaul.plant.api import Truth


def truth_of(p_WB, shapes, p_WO, v_WO=None, present=None, t_us=0, rotor_thrust=None):
    """A truth with vehicles at p_WB, (n, 3), and obstacles at p_WO, (m, 3)."""
    p_WB = np.array(p_WB, dtype=np.float64).reshape(-1, 3)
    n, m = len(p_WB), len(shapes)
    level = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    team = TeamState(
        np.zeros(3), level[0].copy(), np.zeros(3), np.zeros(3),
        p_WB, level, np.zeros((n, 3)), np.zeros((n, 3)),
    )  # fmt: skip
    down = np.tile([0.0, 0.0, -1.0], (n, 1))
    return Truth(
        stamp_us=t_us,
        team=team,
        cables=CableState(down, np.zeros((n, 3)), np.ones(n), np.ones(n)),
        attached=np.ones(n, dtype=bool),
        alive=np.ones(n, dtype=bool),
        rotor_thrust=np.ones((n, 4)) if rotor_thrust is None else rotor_thrust,
        accel_W=np.zeros((1 + n, 3)),
        obstacles=pose_shapes(list(shapes), np.array(p_WO, dtype=np.float64)),
        v_WO=np.zeros((m, 3)) if v_WO is None else np.array(v_WO, dtype=np.float64),
        present=np.ones(m, dtype=bool) if present is None else np.array(present),
        wind_W=np.zeros(3),
        clearance_m=1.0,
        contacts=(),
    )


@pytest.fixture
def make_truth():
    return truth_of
