# SPDX-License-Identifier: Apache-2.0
"""Rooms of every size can be painted: what does not fit is left out."""

import numpy as np
import pytest

from skyhaul.sensors.imaging.hall import ceiling, floor, openings, wall


@pytest.mark.parametrize("size", [(0.4, 0.3, 0.5), (1.3, 6.0, 3.0), (4.0, 1.1, 1.15)])
def test_small_rooms_are_painted(size: tuple[float, float, float]) -> None:
    x, y, z = size
    rng = np.random.default_rng(3)
    textures = [wall(rng, x, z, max(x, z)), wall(rng, y, z, max(y, z))]
    textures += [paint(rng, x, y, max(x, y)) for paint in (floor, ceiling, openings)]
    for texture in textures:
        assert np.all((texture >= 0.0) & (texture <= 1.0))
    assert all(texture.std() > 0.02 for texture in textures[:4])  # something to see
