# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.training.kernels import (
    mean_of_neighbours,
    mean_of_neighbours_back,
    running_argmax,
)


@pytest.fixture
def graph():
    """Ten nodes with up to four older neighbours each; some edges do not count."""
    rng = np.random.default_rng(4)
    degree = np.minimum(np.arange(10), rng.integers(0, 5, 10))
    first = np.concatenate([[0], np.cumsum(degree)])
    source = np.concatenate([rng.integers(-1, i, d) for i, d in enumerate(degree) if d])
    offset = rng.integers(0, 3, first[-1])
    h, scale = rng.normal(size=(10, 5)), rng.normal(size=(3, 5))
    return (
        h.astype(np.float32), scale.astype(np.float32), first,
        source.astype(np.int32), offset.astype(np.int32),
    )  # fmt: skip


def mean(h, scale, first, source, offset):
    out = np.empty_like(h)
    mean_of_neighbours(h, scale, first, source, offset, out)
    return out


def test_mean_over_neighbours_is_that_of_a_loop(graph):
    h, scale, first, source, offset = graph
    found = mean(*graph)
    for i in range(10):
        rows = range(first[i], first[i + 1])
        parts = [scale[offset[e]] * h[source[e]] for e in rows if source[e] >= 0]
        wanted = np.sum(parts, axis=0) / len(rows) if parts else np.zeros(5)
        np.testing.assert_allclose(found[i], wanted, rtol=1e-5, atol=1e-6)


def test_gradients_are_finite_differences(graph):
    """The mean is linear in h and in scale: differences are exact but for rounding."""
    h, scale, *edges = graph
    g = np.random.default_rng(5).normal(size=h.shape).astype(np.float32)
    g_h, g_scale = np.zeros_like(h), np.zeros_like(scale)
    mean_of_neighbours_back(g, h, scale, *edges, g_h, g_scale)
    base = mean(h, scale, *edges)
    for array, gradient in ((h, g_h), (scale, g_scale)):
        for k in np.ndindex(array.shape):
            changed = array.copy()
            changed[k] += 0.5
            pair = (changed, scale) if array is h else (h, changed)
            difference = 2.0 * np.sum(g * (mean(*pair, *edges) - base), dtype=np.float64)
            assert difference == pytest.approx(gradient[k], rel=1e-3, abs=1e-4)


def test_running_argmax_names_the_largest_of_this_period_and_the_last():
    h = np.array([[1.0], [3.0], [2.0], [0.5], [0.1], [0.2]], np.float32)
    runs = np.array([True, True, True, True, True, False])
    period = np.array([0, 0, 1, 2, 5, 5])
    out = np.empty((6, 1), np.int64)
    running_argmax(h, runs, np.zeros(6, np.int64), period, out)
    # period 2 no more knows event 1; period 5 knows nothing older
    assert out[:, 0].tolist() == [0, 1, 1, 2, 4, 6]


def test_running_argmax_keeps_cells_apart_and_ignores_what_is_not_positive():
    h = np.array([[5.0], [1.0], [-1.0], [2.0]], np.float32)
    cell = np.array([0, 1, 2, 1])
    out = np.empty((4, 1), np.int64)
    running_argmax(h, np.ones(4, bool), cell, np.zeros(4, np.int64), out)
    assert out[:, 0].tolist() == [0, 1, 4, 3]
