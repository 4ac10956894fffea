# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan
from skyhaul.perception.events.lens import event_lens
from skyhaul.perception.obstacles.clusters import ClusterRules, Clusters, directions
from skyhaul.perception.obstacles.image_tracks import ImageTracker
from skyhaul.sensors.api import EventReading

LENS = event_lens(RadTan.from_fov((160, 120), 80.0))
STEP_US = 10_000


def reading(x, y):
    k = len(x)
    return EventReading(np.arange(k), np.asarray(x, np.int16), np.asarray(y, np.int16),
                        np.ones(k, np.int8))  # fmt: skip


def patch(x, y, half, count, rng):
    """Events uniform in a square."""
    return (np.round(rng.uniform(x - half, x + half, count)),
            np.round(rng.uniform(y - half, y + half, count)))  # fmt: skip


def patches(rows, noise, rng):
    """Events of several squares and of noise everywhere."""
    parts = [patch(*row, rng) for row in rows]
    parts.append((rng.integers(0, 160, noise), rng.integers(0, 120, noise)))
    return reading(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]))


def test_each_dense_patch_is_a_cluster_and_noise_is_none():
    rng = np.random.default_rng(0)
    events = patches([(30, 40, 10, 300), (100, 80, 6, 120), (130, 20, 4, 60)], 60, rng)
    found = ClusterRules(margin=0.0).find(LENS, events, 7)
    assert found.stamp_us == 7
    np.testing.assert_allclose(found.middle, [[30, 40], [100, 80], [130, 20]], atol=2.5)
    np.testing.assert_allclose(found.half_size[:, 0], [10, 6, 4], atol=3.0)
    assert np.all(np.diff(found.count) <= 0)


def test_labels_are_the_connected_components_of_dense_cells():
    """Against a flood fill over cells, for random points."""
    rng, rules = np.random.default_rng(1), ClusterRules(join_cells=0, dense_count=3.0)
    x, y = rng.integers(0, 160, 900), rng.integers(0, 120, 900)
    names = rules.labels(LENS, reading(x, y))
    cells = {}
    for i, cell in enumerate(zip(y // 4, x // 4, strict=True)):
        cells.setdefault(cell, []).append(i)

    def around(cell):
        return [(cell[0] + a, cell[1] + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]

    dense = {c for c in cells if sum(len(cells.get(n, [])) for n in around(c)) >= 3}
    groups, left = [], set(dense)
    while left:
        group, todo = set(), [left.pop()]
        while todo:
            cell = todo.pop()
            group.add(cell)
            near = [n for n in around(cell) if n in left]
            left -= set(near)
            todo += near
        groups.append({i for c in group for i in cells[c]})
    found = [set(np.flatnonzero(names == n)) for n in range(1, names.max() + 1)]
    assert sorted(map(sorted, found)) == sorted(map(sorted, groups))
    assert len(groups) > 3


def test_a_change_of_light_over_the_whole_image_is_no_obstacle():
    rng = np.random.default_rng(2)
    found = ClusterRules().find(LENS, patches([], 20_000, rng), 0)
    assert len(found.count) == 0


def test_bearing_and_extent_are_those_of_a_ball():
    """A ball off the axis: its outline's box gives its direction and its half angle."""
    from skyhaul.geometry.camera import project_points

    center, radius = np.array([0.5, -0.3, 3.0]), 0.25
    rng = np.random.default_rng(3)
    shell = rng.normal(size=(4000, 3))
    uv, _ = project_points(
        LENS.model, center + radius * shell / np.linalg.norm(shell, axis=1, keepdims=True)
    )
    low, high = uv.min(axis=0), uv.max(axis=0)
    dir_C, half = directions(LENS, 0.5 * (low + high)[None], 0.5 * (high - low)[None])
    distance = np.linalg.norm(center)
    assert np.arccos(dir_C[0] @ center / distance) < np.radians(0.3)
    assert half[0] == pytest.approx(np.arcsin(radius / distance), rel=0.04)


def clusters(stamp_us, rows):
    """Clusters from rows (u, v, half size)."""
    a = np.array(rows, dtype=np.float64).reshape(-1, 3)
    half = np.repeat(a[:, 2:], 2, axis=1)
    dir_C, angle = directions(LENS, a[:, :2], half)
    return Clusters(stamp_us, a[:, :2], half, np.full(len(a), 50), np.zeros(len(a)), dir_C, angle)


def track(rows_at, steps, tracker=None):
    """Tracks after each step."""
    tracker = tracker or ImageTracker()
    memory, out = tracker.init(), []
    for k in range(steps):
        memory, tracks = tracker.step(memory, clusters(STEP_US * k, rows_at(k)))
        out.append(tracks)
    return out


def test_crossing_clusters_keep_their_names():
    def rows(k):
        return [(20 + 2 * k, 40, 8), (140 - 2 * k, 75, 8)][:: 1 if k % 2 else -1]

    out = track(rows, 50)
    assert [len(t.name) for t in out[3:]] == [2] * 47
    left = [t.name[np.argmin(np.abs(t.middle[:, 1] - 40))] for t in out[3:]]
    assert len(set(left)) == 1


def test_time_to_contact_is_that_of_what_comes_straight_on():
    """Size a / (c - t): it meets the camera at c = 0.8 s."""
    rng = np.random.default_rng(4)

    def rows(k):
        return [(80, 60, 4.0 / (0.8 - 0.01 * k) * np.exp(0.03 * rng.normal()))]

    out = track(rows, 45)
    assert out[-1].time_to_contact_s()[0] == pytest.approx(0.8 - 0.44, rel=0.25)
    same = track(lambda k: [(80, 60, 8.0)], 45)[-1].time_to_contact_s()[0]
    assert same > 2.0


def test_one_flash_is_no_track_and_a_lost_one_dies_after_coasting():
    out = track(lambda k: [(50, 50, 8)] if k == 3 or 10 <= k < 30 else [], 60)
    assert not any(t.confirmed.any() for t in out[:12])
    assert out[35].confirmed.any()
    assert len(out[45].name) == 0


def test_a_fragment_inside_a_tracks_box_begins_no_other():
    out = track(lambda k: [(60, 60, 20)] + ([(66, 66, 4)] if k > 10 else []), 30)
    assert len(out[-1].name) == 1
