# SPDX-License-Identifier: Apache-2.0
"""Clearance of the team's upright cylinder to the occupied voxels, at every voxel centre.

The set of load positions P at which the cylinder meets a voxel is that voxel grown by the
cylinder; its distance separates: horizontally to the square of the voxel, less the radius, then
vertically to the interval. So three one-dimensional passes give it exactly, each a lower envelope
of parabolas.

Source:
    Felzenszwalb and Huttenlocher, Distance transforms of sampled functions (2012), for the
    envelope; the grown voxels are PAPER_NOTES 29.
"""

import math

import numpy as np

from skyhaul.jit import njit
from skyhaul.mapping.api import FieldArray
from skyhaul.model.envelope import TeamShape
from skyhaul.types import Array, IntArray, Mask

# mypy: disable-error-code="no-any-return"

FAR = 1e12
"""Squared distance that stands for "nothing in reach" [voxels^2]."""

DEPTH_M = 1.2
"""Depths inside the grown obstacles are told apart down to this [m]."""


def lowering_m(voxel_m: float) -> float:
    """Half a voxel diagonal [m]: by as much may interpolation between centres exceed the truth."""
    return 0.5 * math.sqrt(3.0) * voxel_m


def reach_cells(shape: TeamShape, truncation_m: float, voxel_m: float) -> IntArray:
    """By how many voxels a change of the occupancy spreads in the field, (3,) each way."""
    flat = shape.radius_m + truncation_m
    tall = max(shape.above_m, shape.below_m) + truncation_m
    return np.array([math.ceil(r / voxel_m) + 1 for r in (flat, flat, tall)])


def update_field(
    field: FieldArray,
    occupied: Mask,
    shape: TeamShape,
    voxel_m: float,
    truncation_m: float,
    cells: IntArray | None = None,
) -> None:
    """Compute the clearance field over a range of voxels; changes `field`.

    The value is the signed distance of the cylinder at the voxel's centre to the occupied voxels
    as solid cubes (outside: exact; inside: the distance to the nearest free centre, which is not
    less than the depth), minus `lowering_m`, at most `truncation_m`.

    Args:
        field: (nx, ny, nz) float32 [m], written to.
        occupied: (nx, ny, nz).
        shape: The team's cylinder.
        voxel_m: Edge of a voxel [m].
        truncation_m: Largest value stored [m].
        cells: Range to compute, (2, 3); None: all. It must hold everything within `reach_cells`
            of what changed.
    """
    n = np.array(occupied.shape, dtype=np.int64)
    box = np.array([np.zeros(3), n], dtype=np.int64) if cells is None else cells
    if np.any(box[0] >= box[1]):
        return
    low = lowering_m(voxel_m)
    size = np.array([shape.radius_m, shape.above_m, shape.below_m]) / voxel_m
    limit = (truncation_m + low) / voxel_m
    source = np.array([box[0], box[1]])
    grow = np.array([size[0] + limit, size[0] + limit, max(size[1], size[2]) + limit])
    source[0] = np.maximum(box[0] - np.ceil(grow).astype(np.int64) - 1, 0)
    source[1] = np.minimum(box[1] + np.ceil(grow).astype(np.int64) + 1, n)
    if not _any_in(occupied, source):
        field[tuple(slice(a, b) for a, b in box.T)] = truncation_m
        return
    squared = _row_pass(occupied, box, source, size[0] + limit)
    _layer_pass(squared, box, source)
    blocked = _column_pass(squared, field, box, source, size, limit, voxel_m, low, truncation_m)
    if np.all(blocked[0] < blocked[1]):
        _depth_pass(field, blocked, math.ceil(DEPTH_M / voxel_m), voxel_m, low)


@njit
def _any_in(occupied: Mask, cells: IntArray) -> bool:
    """Whether any voxel of a range is occupied."""
    for i in range(cells[0, 0], cells[1, 0]):
        for j in range(cells[0, 1], cells[1, 1]):
            for k in range(cells[0, 2], cells[1, 2]):
                if occupied[i, j, k]:
                    return True
    return False


@njit
def _row_pass(occupied: Mask, box: IntArray, source: IntArray, reach: float) -> Array:
    """Squared gap along x to the nearest occupied voxel of the row, in voxels.

    Rows: x range of the box, y and z range of the source. A gap beyond `reach` is FAR.
    """
    ny, nz = source[1, 1] - source[0, 1], source[1, 2] - source[0, 2]
    j0, k0 = source[0, 1], source[0, 2]
    out = np.full((box[1, 0] - box[0, 0], ny, nz), np.float32(FAR), np.float32)
    last = np.full((ny, nz), -1_000_000, np.int32)
    for i in range(source[0, 0], box[1, 0]):
        for j in range(ny):
            for k in range(nz):
                if occupied[i, j0 + j, k0 + k]:
                    last[j, k] = i
        if i >= box[0, 0]:
            _store_gaps(out[i - box[0, 0]], last, i, reach)
    last[:] = 1_000_000
    for i in range(source[1, 0] - 1, box[0, 0] - 1, -1):
        for j in range(ny):
            for k in range(nz):
                if occupied[i, j0 + j, k0 + k]:
                    last[j, k] = i
        if i < box[1, 0]:
            _store_gaps(out[i - box[0, 0]], last, i, reach)
    return out


@njit
def _store_gaps(out: Array, last: IntArray, i: int, reach: float) -> None:
    """Squared gaps of voxels in plane i to the last occupied ones, where they are smaller."""
    for j in range(out.shape[0]):
        for k in range(out.shape[1]):
            gap = max(abs(i - last[j, k]) - 0.5, 0.0)
            if gap <= reach and gap * gap < out[j, k]:
                out[j, k] = np.float32(gap * gap)


@njit
def lower_envelope(f: Array, offset: float, out: Array, v: IntArray, z: Array) -> None:
    """out[q] = min(out[q], min_k f[k] + (q + offset - k)^2), all k with f[k] < FAR.

    Args:
        f: Heights of the parabolas at k = 0.., (n,).
        offset: Shift of the places asked for.
        out: At q = 0.., (m,), lowered in place.
        v: Scratch, (n,).
        z: Scratch, (n + 1,).
    """
    m = -1
    for k in range(len(f)):
        if f[k] >= FAR:
            continue
        s = -FAR
        while m >= 0:
            w = v[m]
            s = ((f[k] + k * k) - (f[w] + w * w)) / (2.0 * (k - w))
            if s > z[m]:
                break
            m -= 1
        if m < 0:
            s = -FAR
        m += 1
        v[m], z[m] = k, s
    if m < 0:
        return
    z[m + 1] = FAR
    a = 0
    for q in range(len(out)):
        x = q + offset
        while z[a + 1] < x:
            a += 1
        d = x - v[a]
        value = f[v[a]] + d * d
        if value < out[q]:
            out[q] = value


@njit
def _layer_pass(squared: Array, box: IntArray, source: IntArray) -> None:
    """Squared horizontal distance to the squares of the layer, in voxels; in place.

    Afterwards the first `box` rows along y hold the result.
    """
    ny, nz = squared.shape[1], squared.shape[2]
    my, shift = box[1, 1] - box[0, 1], box[0, 1] - source[0, 1]
    f, out = np.empty(ny), np.empty(my)
    v, z = np.empty(ny, np.int64), np.empty(ny + 1)
    for i in range(squared.shape[0]):
        for k in range(nz):
            some = False
            for j in range(ny):
                f[j] = squared[i, j, k]
                some = some or f[j] < FAR
            if not some:
                continue
            for j in range(my):
                out[j] = f[j + shift] if f[j + shift] < FAR else FAR
            lower_envelope(f, shift + 0.5, out, v, z)
            lower_envelope(f, shift - 0.5, out, v, z)
            for j in range(my):
                squared[i, j, k] = np.float32(out[j])


@njit
def _column_pass(
    squared: Array,
    field: FieldArray,
    box: IntArray,
    source: IntArray,
    size: Array,
    limit: float,
    voxel: float,
    low: float,
    truncation: float,
) -> IntArray:
    """Distance of the cylinder from the layers' distances; returns the range of blocked voxels."""
    nz, mz, shift = squared.shape[2], box[1, 2] - box[0, 2], box[0, 2] - source[0, 2]
    f, out = np.empty(nz), np.empty(mz)
    v, z = np.empty(nz, np.int64), np.empty(nz + 1)
    up, down = 0.5 + size[1], 0.5 + size[2]
    blocked = np.array([[1 << 30, 1 << 30, 1 << 30], [-1, -1, -1]])
    for i in range(box[1, 0] - box[0, 0]):
        for j in range(box[1, 1] - box[0, 1]):
            row = field[box[0, 0] + i, box[0, 1] + j]
            if not _shrink(squared[i, j], size[0], limit, f):
                for k in range(mz):
                    row[box[0, 2] + k] = np.float32(truncation)
                continue
            for k in range(mz):
                first = max(0, math.ceil(k + shift - down - 1e-9))
                last = min(nz - 1, math.floor(k + shift + up + 1e-9))
                out[k] = FAR
                for q in range(first, last + 1):
                    out[k] = min(out[k], f[q])
            lower_envelope(f, shift + up, out, v, z)
            lower_envelope(f, shift - down, out, v, z)
            for k in range(mz):
                if out[k] <= 0.0:
                    _include(blocked, box[0, 0] + i, box[0, 1] + j, box[0, 2] + k)
                d = voxel * math.sqrt(out[k]) - low
                row[box[0, 2] + k] = np.float32(min(d, truncation))
    return blocked


@njit
def _shrink(squared: Array, radius: float, limit: float, f: Array) -> bool:
    """Squared gaps after taking the radius off; False when none is in reach."""
    some = False
    for k in range(len(f)):
        f[k] = FAR
        if squared[k] < FAR:
            gap = max(math.sqrt(squared[k]) - radius, 0.0)
            if gap <= limit:
                f[k], some = gap * gap, True
    return some


@njit
def _include(cells: IntArray, i: int, j: int, k: int) -> None:
    """Widen a range of voxels, (2, 3), to hold one more."""
    cells[0, 0], cells[1, 0] = min(cells[0, 0], i), max(cells[1, 0], i + 1)
    cells[0, 1], cells[1, 1] = min(cells[0, 1], j), max(cells[1, 1], j + 1)
    cells[0, 2], cells[1, 2] = min(cells[0, 2], k), max(cells[1, 2], k + 1)


@njit
def _depth_pass(field: FieldArray, blocked: IntArray, cap: int, voxel: float, low: float) -> None:
    """Depth of blocked voxels: the distance to the nearest free centre, `cap` voxels at most.

    Blocked are the voxels that the pass before stored as -low and, around the range that is
    computed anew, those that lie deeper.
    """
    n0, n1, n2 = field.shape
    i0, j0, k0 = (
        max(blocked[0, 0] - cap, 0),
        max(blocked[0, 1] - cap, 0),
        max(blocked[0, 2] - cap, 0),
    )
    i1, j1 = min(blocked[1, 0] + cap, n0), min(blocked[1, 1] + cap, n1)
    k1 = min(blocked[1, 2] + cap, n2)
    g, edge = np.zeros((i1 - i0, j1 - j0, k1 - k0)), -low + 1e-6 * voxel
    for i in range(i0, i1):
        for j in range(j0, j1):
            for k in range(k0, k1):
                if field[i, j, k] <= edge:
                    g[i - i0, j - j0, k - k0] = FAR
    _sweep(g)
    for i in range(blocked[0, 0], blocked[1, 0]):
        for j in range(blocked[0, 1], blocked[1, 1]):
            for k in range(blocked[0, 2], blocked[1, 2]):
                depth = math.sqrt(min(g[i - i0, j - j0, k - k0], cap * cap))
                if depth > 0.0:
                    field[i, j, k] = np.float32(-voxel * depth - low)


@njit
def _sweep(g: Array) -> None:
    """Squared Euclidean distance to the zeros of g, in place, in voxels."""
    n0, n1, n2 = g.shape
    n = max(n0, n1, n2)
    f, out = np.empty(n), np.empty(n)
    v, z = np.empty(n, np.int64), np.empty(n + 1)
    for i in range(n0):
        for j in range(n1):
            f[:n2], out[:n2] = g[i, j], g[i, j]
            lower_envelope(f[:n2], 0.0, out[:n2], v, z)
            g[i, j] = out[:n2]
    for i in range(n0):
        for k in range(n2):
            f[:n1], out[:n1] = g[i, :, k], g[i, :, k]
            lower_envelope(f[:n1], 0.0, out[:n1], v, z)
            g[i, :, k] = out[:n1]
    for j in range(n1):
        for k in range(n2):
            f[:n0], out[:n0] = g[:, j, k], g[:, j, k]
            lower_envelope(f[:n0], 0.0, out[:n0], v, z)
            g[:, j, k] = out[:n0]
