# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from skyhaul.perception.events.graph import (
    EVALUATED,
    LONELY,
    REFRACTORY,
    GraphParams,
    event_graph,
    spiral,
)

PARAMS = GraphParams(window_us=8_000, max_neighbours=6, per_pixel=2)


def by_hand(params, lens, events, turn_C):
    """Status and edges by looking through all older events, one by one."""
    nodes, status, edges = [], [], []
    for i, (t, x, y, p) in enumerate(
        zip(events.t_us, events.x.astype(int), events.y.astype(int), events.p, strict=True)
    ):
        here = [j for j in nodes if events.x[j] == x and events.y[j] == y]
        fresh = bool(here) and t - events.t_us[here[-1]] < params.refractory_us
        if fresh and events.p[here[-1]] == p:
            status.append(REFRACTORY)
            continue
        found = []
        for k, (dx, dy) in enumerate(spiral(params.radius_px)):
            at = [j for j in nodes if events.x[j] == x + dx and events.y[j] == y + dy]
            newest = at[::-1][: params.per_pixel]
            found += [(j, k) for j in newest if t - events.t_us[j] <= params.window_us]
        for j, k in found[: params.max_neighbours]:
            d = np.array([x - events.x[j], y - events.y[j]], float)
            d -= lens.turn_flow[y, x].astype(float) @ (turn_C[i] - turn_C[j])
            e = [*(d / params.radius_px), (t - events.t_us[j]) / params.window_us, p * events.p[j]]
            edges.append((j, i, k, e))
        status.append(LONELY if len(found) < params.min_neighbours else EVALUATED)
        nodes.append(i)
    return status, edges


@pytest.mark.parametrize(
    "change", [{}, {"per_pixel": 1}, {"refractory_us": 3_000}, {"radius_px": 1}]
)
def test_graph_is_what_a_search_through_all_older_events_finds(lens, stream, change):
    params = replace(PARAMS, **change)
    events, turn_C = stream
    graph = event_graph(params, lens, events, turn_C)
    status, edges = by_hand(params, lens, events, turn_C)
    np.testing.assert_array_equal(graph.status, status)
    assert [(e[0], e[1], e[2]) for e in edges] == list(
        zip(graph.source, graph.target, graph.offset, strict=True)
    )
    np.testing.assert_allclose(graph.edge, [e[3] for e in edges], atol=1e-6)
    assert {LONELY, EVALUATED} <= set(status)


def test_edges_run_from_older_to_newer_events_inside_radius_and_window(lens, stream):
    events, turn_C = stream
    g = event_graph(PARAMS, lens, events, turn_C)
    assert np.all(g.source < g.target)
    age = events.t_us[g.target] - events.t_us[g.source]
    assert np.all((age >= 0) & (age <= PARAMS.window_us))
    far = np.hypot(
        events.x[g.target].astype(int) - events.x[g.source],
        events.y[g.target].astype(int) - events.y[g.source],
    )
    assert far.max() <= PARAMS.radius_px
    degree = np.bincount(g.target)
    assert degree.max() == PARAMS.max_neighbours


def test_spiral_goes_outward_and_covers_the_disc():
    offsets = spiral(3)
    assert len(offsets) == 29
    assert tuple(offsets[0]) == (0, 0)
    assert np.all(np.diff(np.sum(offsets**2, axis=1)) >= 0)
    assert len({tuple(o) for o in offsets}) == 29


def test_a_refractory_event_is_no_node_and_names_the_one_before(lens, stream):
    events, turn_C = stream
    params = replace(PARAMS, refractory_us=3_000)
    g = event_graph(params, lens, events, turn_C)
    late = np.flatnonzero(g.status == REFRACTORY)
    assert len(late) > 10
    assert not np.isin(late, g.source).any()
    assert not np.isin(late, g.target).any()
    before = g.same_as[late]
    for field in (events.x, events.y, events.p):
        np.testing.assert_array_equal(field[before], field[late])
    assert np.all(events.t_us[late] - events.t_us[before] < 3_000)


def test_a_point_that_stands_has_no_way_left_on_edges_of_a_turning_camera(lens):
    """Two events of one world point, seen before and after a turn: e_ij has no displacement."""
    from skyhaul.geometry.camera import project_points
    from skyhaul.geometry.so3 import so3_exp
    from skyhaul.sensors.api import EventReading

    ray, turn = lens.rays_C[20, 30], np.array([0.012, -0.03, 0.05])
    after, _ = project_points(lens.model, (so3_exp(turn).T @ ray)[None])
    x, y = np.round(after[0]).astype(int)
    assert (x, y) != (30, 20)
    events = EventReading(
        np.array([0, 5_000]), np.array([30, x], np.int16), np.array([20, y], np.int16),
        np.array([1, 1], np.int8),
    )  # fmt: skip
    turns = np.stack([np.zeros(3), turn])
    params = GraphParams(radius_px=6)
    moved, still = (event_graph(params, lens, events, w).edge[0, :2] for w in (turns, 0 * turns))
    rounding = np.abs(after[0] - [x, y])
    assert np.all(np.abs(moved) * 6 <= rounding + 0.1)
    assert np.linalg.norm(still) > 3 * np.linalg.norm(moved)
