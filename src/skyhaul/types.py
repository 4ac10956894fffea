# SPDX-License-Identifier: Apache-2.0
"""Array types and the conventions that every stage shares.

World W is z up (x east, y north), bodies are x forward, y left, z up, SI units throughout.
Quaternions are Hamilton, unit, ordered (w, x, y, z). Time is int64 microseconds since the start
of the run; a stamp is the time of measurement. Vehicles, cables and hooks share one index i.

Errors are actual - desired, in the right (body) tangent space:
e = (p - p_d, Log(q_d^-1 (x) q), v - v_d, w - R^T R_d w_d), and so are covariances and gains.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
IntArray = NDArray[np.int64]

Vec3 = Annotated[tuple[float, float, float], "x, y, z"]
"""Three numbers in a configuration file."""

TimeUs = int
"""Time since the start of the run [us]."""

US_PER_S = 1_000_000
GRAVITY_MPS2 = 9.81

LOAD_P, LOAD_Q, LOAD_V, LOAD_W = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)
"""Layout of a load state (13,): p_WL [m], q_WL, v_WL [m/s], w_WL_L [rad/s]."""
LOAD_NX = 13
ERR_P, ERR_R, ERR_V, ERR_W = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Layout of a load error (12,), see the module's docstring."""
LOAD_NE = 12


def frozen(*arrays: NDArray[np.generic]) -> None:
    """Make arrays read-only; message classes call it in `__post_init__`."""
    for a in arrays:
        a.setflags(write=False)
