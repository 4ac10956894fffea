# SPDX-License-Identifier: Apache-2.0
"""The clearance of the team to M(t): one function for planner, triggers and controller."""

import math
from typing import NamedTuple

import numpy as np

from skyhaul.geometry.team_clearance import team_clearance, team_clearance_gradient
from skyhaul.jit import njit
from skyhaul.mapping.api import LayerArrays, MapArrays, WorldMap
from skyhaul.types import Array, IntArray

# mypy: disable-error-code="no-any-return"

STANDING_MPS = 0.05
"""A mover slower than this stands [m/s]."""

Value = tuple[float, float, float, float]
"""A clearance [m] and its gradient by the load's position."""


class MapGradient(NamedTuple):
    """Clearances with gradients at k points, W axes."""

    static: Array  # (k,) to voxels, walls, ceiling and floor [m]
    static_grad: Array  # (k, 3) unit or zero: away from what is nearest
    track: Array  # (k, m) to the tube of each track at that time [m]; +inf beyond the horizon
    track_grad: Array  # (k, m, 3) unit: away from the track


def map_clearance(world_map: WorldMap, p_WP: Array, t_us: Array | IntArray) -> Array:
    """Smallest clearance of the team to anything, the load at P at time t, (k,) [m].

    min(static layer, room, each tube at t): negative inside; see `WorldMap`.

    Args:
        world_map: M(t).
        p_WP: Load positions, (k, 3) [m].
        t_us: When the load is there, (k,) [us].
    """
    p = np.ascontiguousarray(p_WP, dtype=np.float64)
    return clearances(world_map.arrays, p, world_map.after_s(t_us))


def map_clearance_gradient(world_map: WorldMap, p_WP: Array, t_us: Array | IntArray) -> MapGradient:
    """Clearance to the static layer and to each track, apart, with gradients; args as above."""
    p = np.ascontiguousarray(p_WP, dtype=np.float64)
    return MapGradient(*_gradients(world_map.arrays, p, world_map.after_s(t_us)))


@njit
def clearances(m: MapArrays, p_WP: Array, t: Array) -> Array:
    """Kernel of `map_clearance`; t in seconds after the map's stamp, (k,)."""
    out = np.empty(len(p_WP))
    scratch = np.empty(3)
    for q in range(len(p_WP)):
        x, y, z = p_WP[q, 0], p_WP[q, 1], p_WP[q, 2]
        fixed = static_clearance(m, x, y, z)
        out[q] = min(fixed, tube_clearance(m, x, y, z, t[q], fixed, scratch))
    return out


@njit
def tube_clearances(m: MapArrays, p_WP: Array, t: Array) -> Array:
    """Smallest clearance to any tube, of a cylinder `m.shape` around places P, (k,) [m].

    Args:
        m: The map; with another shape, that of a single body.
        p_WP: Places, (k, 3) [m].
        t: When the body is there, after the map's stamp, (k,) [s].
    """
    out, scratch = np.empty(len(p_WP)), np.empty(3)
    for q in range(len(p_WP)):
        x, y, z = p_WP[q, 0], p_WP[q, 1], p_WP[q, 2]
        out[q] = tube_clearance(m, x, y, z, t[q], math.inf, scratch)
    return out


@njit
def static_clearance(m: MapArrays, x: float, y: float, z: float) -> float:
    """Clearance to voxels and room at a point [m]."""
    return min(layer_clearance(m, x, y, z), room_clearance(m, x, y, z))


@njit
def layer_clearance(m: MapArrays, x: float, y: float, z: float) -> float:
    """Clearance to voxels, interpolated; outside every layer that of its rim [m].

    Near the rim of a window what lies outside of it may be nearer than what lies inside: it is
    at least as far as the rim, and at least as far as the coarse layer says.
    """
    if not m.windowed:
        return _trilinear(m.fine, x, y, z)
    if not _inside(m.fine, x, y, z):
        return _trilinear(m.coarse, x, y, z)
    fine, rim = _trilinear(m.fine, x, y, z), _rim_clearance(m, x, y, z)
    return fine if rim >= fine else min(fine, max(rim, _trilinear(m.coarse, x, y, z)))


@njit
def _rim_clearance(m: MapArrays, x: float, y: float, z: float) -> float:
    """Clearance of the team to the rim of the window [m]."""
    f, h = m.fine.clearance, m.fine.voxel
    rim = math.inf
    for axis in range(3):
        q = x if axis == 0 else (y if axis == 1 else z)
        up = m.shape[1] if axis == 2 else m.shape[0]
        down = m.shape[2] if axis == 2 else m.shape[0]
        low = m.fine.origin[axis] - 0.5 * h
        rim = min(rim, min(q - down - low, low + h * f.shape[axis] - q - up))
    return rim


@njit
def room_clearance(m: MapArrays, x: float, y: float, z: float) -> float:
    """Clearance to walls, ceiling and floor [m]; the floor is exempt in the lift-off column."""
    flat = min(min(x - m.room_min[0], m.room_max[0] - x), min(y - m.room_min[1], m.room_max[1] - y))
    out = min(flat - m.shape[0], m.room_max[2] - z - m.shape[1])
    if not floor_is_exempt(m, x, y):
        out = min(out, z - m.room_min[2] - m.shape[2])
    return out


@njit
def floor_is_exempt(m: MapArrays, x: float, y: float) -> bool:
    """Whether the floor does not count here."""
    dx, dy = x - m.exempt[0], y - m.exempt[1]
    return dx * dx + dy * dy < m.exempt[2] * m.exempt[2]


@njit
def tube_clearance(
    m: MapArrays, x: float, y: float, z: float, t: float, enough: float, scratch: Array
) -> float:
    """Smallest clearance to any tube at time t, or some value >= `enough` [m].

    Args:
        m: The map.
        x: Of the load [m].
        y: Of the load [m].
        z: Of the load [m].
        t: Seconds after the stamp.
        enough: Tracks farther off than this need not be looked at closely [m].
        scratch: (3,).
    """
    tr = m.tracks
    best = math.inf
    ahead, t = t > m.horizon, min(t, m.horizon)
    for a in range(len(tr.kind)):
        if ahead and _moves(m, a):
            continue
        tube = tr.tube_base[a] + tr.growth[a] * abs(t)
        scratch[0], scratch[1] = x - tr.v_WO[a, 0] * t, y - tr.v_WO[a, 1] * t
        scratch[2] = z - tr.v_WO[a, 2] * t
        if _surely_off(m, a, scratch) - tube >= min(best, enough):
            continue
        d = team_clearance(
            m.shape[0], m.shape[1], m.shape[2], scratch,
            tr.kind[a], tr.size[a], tr.p_WO[a], tr.R_WO[a],
        )  # fmt: skip
        best = min(best, d - tube)
    return best


@njit
def _moves(m: MapArrays, a: int) -> bool:
    """Whether a track moves; one that stands is trusted to stand beyond the horizon too."""
    v = m.tracks.v_WO[a]
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2] > STANDING_MPS * STANDING_MPS


@njit
def _surely_off(m: MapArrays, a: int, p: Array) -> float:
    """A lower bound of the distance to the shape of track a, from bounding spheres."""
    tr = m.tracks
    half = 0.5 * (m.shape[1] + m.shape[2])
    dx, dy = p[0] - tr.p_WO[a, 0], p[1] - tr.p_WO[a, 1]
    dz = p[2] + 0.5 * (m.shape[1] - m.shape[2]) - tr.p_WO[a, 2]
    s = tr.size[a]
    round_radius = s[0] + s[1]
    box_radius = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
    radius = max(round_radius, box_radius)
    own = math.sqrt(m.shape[0] * m.shape[0] + half * half)
    return math.sqrt(dx * dx + dy * dy + dz * dz) - radius - own


@njit
def _inside(layer: LayerArrays, x: float, y: float, z: float) -> bool:
    """Whether a point lies between voxel centres of the layer."""
    n0, n1, n2 = layer.clearance.shape
    u, v = (x - layer.origin[0]) / layer.voxel, (y - layer.origin[1]) / layer.voxel
    w = (z - layer.origin[2]) / layer.voxel
    return 0.0 <= u <= n0 - 1.0 and 0.0 <= v <= n1 - 1.0 and 0.0 <= w <= n2 - 1.0


@njit
def _place(u: float, n: int) -> tuple[int, float]:
    """Voxel and fraction of a coordinate in voxels, kept inside the layer."""
    u = min(max(u, 0.0), n - 1.0)
    i = min(int(u), max(n - 2, 0))
    return i, u - i


@njit
def _trilinear(layer: LayerArrays, x: float, y: float, z: float) -> float:
    """Value of a layer between its centres [m]."""
    return _trilinear_gradient(layer, x, y, z)[0]


@njit
def _trilinear_gradient(layer: LayerArrays, x: float, y: float, z: float) -> Value:
    """Value and gradient of a layer between its centres.

    Outside of them: that of the nearest place between, less the distance to it.
    """
    f, h = layer.clearance, layer.voxel
    i, a = _place((x - layer.origin[0]) / h, f.shape[0])
    j, b = _place((y - layer.origin[1]) / h, f.shape[1])
    k, c = _place((z - layer.origin[2]) / h, f.shape[2])
    i1, j1, k1 = min(i + 1, f.shape[0] - 1), min(j + 1, f.shape[1] - 1), min(k + 1, f.shape[2] - 1)
    f000, f001, f010, f011 = f[i, j, k], f[i, j, k1], f[i, j1, k], f[i, j1, k1]
    f100, f101, f110, f111 = f[i1, j, k], f[i1, j, k1], f[i1, j1, k], f[i1, j1, k1]
    f00, f01 = f000 + c * (f001 - f000), f010 + c * (f011 - f010)
    f10, f11 = f100 + c * (f101 - f100), f110 + c * (f111 - f110)
    f0, f1 = f00 + b * (f01 - f00), f10 + b * (f11 - f10)
    gy = (1.0 - a) * (f01 - f00) + a * (f11 - f10)
    gz0 = (1.0 - b) * (f001 - f000) + b * (f011 - f010)
    gz1 = (1.0 - b) * (f101 - f100) + b * (f111 - f110)
    ox, oy = x - layer.origin[0] - h * (i + a), y - layer.origin[1] - h * (j + b)
    oz = z - layer.origin[2] - h * (k + c)
    off = math.sqrt(ox * ox + oy * oy + oz * oz)
    value = f0 + a * (f1 - f0) - (off if off > 1e-9 else 0.0)
    return value, (f1 - f0) / h, gy / h, ((1.0 - a) * gz0 + a * gz1) / h


@njit
def _static_gradient(m: MapArrays, x: float, y: float, z: float) -> Value:
    """`static_clearance` and its gradient, unit length or zero."""
    d, gx, gy, gz = _trilinear_gradient(m.fine, x, y, z)
    if m.windowed and (not _inside(m.fine, x, y, z) or _rim_clearance(m, x, y, z) < d):
        _, gx, gy, gz = _trilinear_gradient(m.coarse, x, y, z)
        d = layer_clearance(m, x, y, z)
    norm = math.sqrt(gx * gx + gy * gy + gz * gz)
    if norm > 1e-6:
        gx, gy, gz = gx / norm, gy / norm, gz / norm
    for axis in range(3):
        q = x if axis == 0 else (y if axis == 1 else z)
        below = m.shape[2] if axis == 2 else m.shape[0]
        above = m.shape[1] if axis == 2 else m.shape[0]
        low, high = q - m.room_min[axis] - below, m.room_max[axis] - q - above
        if low < d and not (axis == 2 and floor_is_exempt(m, x, y)):
            d, gx, gy, gz = low, 1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2)
        if high < d:
            d, gx, gy, gz = high, -1.0 * (axis == 0), -1.0 * (axis == 1), -1.0 * (axis == 2)
    return d, gx, gy, gz


@njit
def _gradients(m: MapArrays, p_WP: Array, t: Array) -> tuple[Array, Array, Array, Array]:
    """Kernel of `map_clearance_gradient`."""
    k, n = len(p_WP), len(m.tracks.kind)
    static, static_grad = np.empty(k), np.empty((k, 3))
    track, track_grad = np.full((k, n), np.inf), np.zeros((k, n, 3))
    scratch = np.empty(3)
    for q in range(k):
        static[q], gx, gy, gz = _static_gradient(m, p_WP[q, 0], p_WP[q, 1], p_WP[q, 2])
        static_grad[q, 0], static_grad[q, 1], static_grad[q, 2] = gx, gy, gz
        now = min(t[q], m.horizon)
        for a in range(n):
            tr = m.tracks
            if t[q] > m.horizon and _moves(m, a):
                continue
            for c in range(3):
                scratch[c] = p_WP[q, c] - tr.v_WO[a, c] * now
            d, gx, gy, gz = team_clearance_gradient(
                m.shape[0], m.shape[1], m.shape[2], scratch,
                tr.kind[a], tr.size[a], tr.p_WO[a], tr.R_WO[a],
            )  # fmt: skip
            track[q, a] = d - tr.tube_base[a] - tr.growth[a] * abs(now)
            track_grad[q, a, 0], track_grad[q, a, 1], track_grad[q, a, 2] = gx, gy, gz
    return static, static_grad, track, track_grad
