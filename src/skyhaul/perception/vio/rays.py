# SPDX-License-Identifier: Apache-2.0
"""Many pixels to rays and back, for lenses whose numbers are at hand."""

from typing import Any

import numpy as np

from skyhaul.geometry.camera import project, unproject
from skyhaul.jit import njit
from skyhaul.types import Array, Mask


def rays_of(lens: Any, uv: Array) -> Array:  # noqa: ANN401  a named tuple for kernels
    """Unit rays of places in the image: (k, 2) [px] -> (k, 3), camera axes."""
    return _rays(lens, np.ascontiguousarray(uv, dtype=np.float64))


def project_rays(lens: Any, rays: Array) -> tuple[Array, Mask]:  # noqa: ANN401
    """Where rays meet the image, (k, 3) -> (k, 2) [px], and whether they do, (k,)."""
    return _images(lens, np.ascontiguousarray(rays, dtype=np.float64))


@njit
def _rays(lens: Any, uv: Array) -> Array:  # noqa: ANN401
    rays = np.empty((uv.shape[0], 3))
    for i in range(uv.shape[0]):
        rays[i, 0], rays[i, 1], rays[i, 2] = unproject(lens, uv[i, 0], uv[i, 1])
    return rays


@njit
def _images(lens: Any, rays: Array) -> tuple[Array, Mask]:  # noqa: ANN401
    k = rays.shape[0]
    uv, ok = np.empty((k, 2)), np.empty(k, np.bool_)
    for i in range(k):
        uv[i, 0], uv[i, 1], ok[i] = project(lens, rays[i, 0], rays[i, 1], rays[i, 2])
    return uv, ok
