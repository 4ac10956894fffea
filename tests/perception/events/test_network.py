# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan
from skyhaul.perception.events.batch import counts, evaluate
from skyhaul.perception.events.classifier import EventNetwork
from skyhaul.perception.events.graph import EDGE, GraphParams, event_graph
from skyhaul.perception.events.lens import event_lens
from skyhaul.perception.events.recordings import read_calibration, read_rate, read_recording
from skyhaul.perception.events.rotation import TurnMemory, turn_at
from skyhaul.perception.events.surface import INPUTS, PLANE_EDGE, PLANE_NODE
from skyhaul.perception.events.weights import WIDTH, random_weights
from skyhaul.sensors.api import EventReading

from .conftest import part

GRAPH = GraphParams(refractory_us=1_500)
both = pytest.mark.parametrize("has_table", [False, True], ids=["shared", "table"])


def in_chunks(network, lens, events, turn_C, cuts):
    """Scores of a stream that arrives in chunks, the last cells, and the memory."""
    memory, p_mover = network.init(lens), []
    for a, b in zip([0, *cuts], [*cuts, len(events.t_us)], strict=True):
        memory, scores = network.step(memory, part(events, a, b), turn_C[a:b])
        p_mover.append(scores.p_mover)
    return np.concatenate(p_mover), scores.objectness, memory


def relative(got, wanted):
    """Largest difference over the largest value."""
    return np.max(np.abs(got - wanted)) / np.max(np.abs(wanted))


def holds_batch(weights, lens, events, turn_C):
    """Asynchronous against batch, one event after the other in odd chunks."""
    cuts = [1, 2, 5, len(events.t_us) // 3, len(events.t_us) - 1]
    p_mover, cells, memory = in_chunks(EventNetwork(weights), lens, events, turn_C, cuts)
    graph = event_graph(weights.graph, lens, events, turn_C)
    wanted = evaluate(weights, lens, events, graph, int(events.t_us[-1]))
    assert np.ptp(wanted.p_mover[wanted.p_mover > 0]) > 0.05
    assert relative(p_mover, wanted.p_mover) <= 1e-5
    assert relative(cells, wanted.objectness) <= 1e-5
    return memory, graph


@both
def test_asynchronous_is_batch_on_a_made_up_stream(lens, stream, has_table):
    memory, graph = holds_batch(random_weights(GRAPH, has_table=has_table), lens, *stream)
    done = EventNetwork(random_weights(GRAPH, has_table=has_table)).work(memory)
    assert (done.lonely, done.refractory) == counts(graph)
    assert min(done.lonely, done.refractory) > 5
    assert done.edges == len(graph.edge)


@both
@pytest.mark.parametrize("clip", ["poster_rotation", "shapes_rotation", "dvs"])
def test_asynchronous_is_batch_on_a_real_stream(data, clip, has_table):
    if clip == "dvs":
        recording = read_recording(data / "events" / "dvs.es")
        lens = event_lens(RadTan.from_fov((recording.width, recording.height), 60.0))
        events, rate = part(recording.events, 76_800, 82_000), np.zeros(3)
    else:
        folder = data / "ijrr" / clip
        lens = event_lens(read_calibration(folder / "calib.txt", (240, 180)))
        events = part(read_recording(folder / "events.txt").events, 2_000, 7_000)
        rate = read_rate(folder / "motion.txt")
    _, turn_C = turn_at(TurnMemory(), events.t_us[:1], rate[None], events.t_us)
    holds_batch(random_weights(GraphParams(), has_table=has_table, seed=5), lens, events, turn_C)


@both
def test_chunks_change_no_bit(lens, stream, has_table):
    network = EventNetwork(random_weights(GRAPH, has_table=has_table))
    whole, cells, memory = in_chunks(network, lens, *stream, [])
    cuts = np.sort(np.random.default_rng(0).integers(0, len(whole), 60))
    parts, cells_of_parts, of_parts = in_chunks(network, lens, *stream, list(cuts))
    assert whole.tobytes() == parts.tobytes()
    assert cells.tobytes() == cells_of_parts.tobytes()
    assert network.work(memory) == network.work(of_parts)


@both
def test_output_changes_when_time_is_scaled_and_only_through_what_measures_it(
    lens, stream, has_table
):
    """Blind is a network without the edge term whose nodes start with polarity and 1 only."""
    events, turn_C = stream
    slow = EventReading(3 * events.t_us, events.x, events.y, events.p)
    # a window, a period and no refractory time, so that the graph and the pooling stay the same
    graph = GraphParams(window_us=10**6, refractory_us=0)
    weights = replace(random_weights(graph, has_table=has_table), period_us=10**7)
    layers = [replace(layer, edge=np.zeros((EDGE, WIDTH), np.float32)) for layer in weights.layers]
    known = (np.arange(INPUTS) < 2).astype(np.float32)[:, None]
    first = replace(layers[0], root=layers[0].root * known)
    if has_table:
        first = replace(first, table=first.table * known)
    else:
        first = replace(first, mix=first.mix * known)
    blind = replace(weights, layers=(first, *layers[1:]))

    def change(w):
        a, b = (in_chunks(EventNetwork(w), lens, e, turn_C, [])[0] for e in (events, slow))
        return np.max(np.abs(a - b))

    assert change(weights) > 1e-3
    assert change(blind) == 0.0


def test_scores_do_not_depend_on_later_events(lens, stream):
    events, turn_C = stream
    network = EventNetwork(random_weights(GRAPH, has_table=False))
    whole = in_chunks(network, lens, events, turn_C, [])[0]
    early = in_chunks(network, lens, part(events, 0, 700), turn_C[:700], [])[0]
    np.testing.assert_array_equal(whole[:700], early)


def test_pruning_saves_work_and_changes_no_bit(lens, stream):
    weights = random_weights(GRAPH, has_table=False)
    pruned, full = EventNetwork(weights), EventNetwork(weights, prune=False)
    p_pruned, cells_pruned, m_pruned = in_chunks(pruned, lens, *stream, [400])
    p_full, cells_full, m_full = in_chunks(full, lens, *stream, [400])
    assert p_pruned.tobytes() == p_full.tobytes()
    assert cells_pruned.tobytes() == cells_full.tobytes()
    a, b = pruned.work(m_pruned), full.work(m_full)
    assert a.pool_prunes > 0
    assert b.pool_prunes == 0
    assert a.pool_updates + a.pool_prunes == a.evaluated == b.pool_updates
    assert b.multiply_adds - a.multiply_adds == a.pool_prunes * WIDTH * (WIDTH + 1)


@both
def test_multiply_adds_are_those_of_the_equations(lens, stream, has_table):
    """Layer sizes times the nodes and edges that were evaluated, and the plane through times."""
    network = EventNetwork(random_weights(GRAPH, has_table=has_table), prune=False)
    _, _, memory = in_chunks(network, lens, *stream, [])
    done = network.work(memory)
    graph = event_graph(GRAPH, lens, *stream)
    edges = np.isin(graph.target, np.flatnonzero(graph.status == 0)).sum()
    inputs = 4 * WIDTH
    node = (inputs + 4 * EDGE) * WIDTH + (WIDTH + 1) * WIDTH + 2 * WIDTH
    per_edge = inputs * WIDTH if has_table else inputs
    nodes = done.events - done.refractory
    surface = nodes * PLANE_NODE + len(graph.source) * PLANE_EDGE
    wanted = done.evaluated * node + edges * per_edge + surface
    if not has_table:
        wanted += done.evaluated * inputs * WIDTH
    assert done.multiply_adds == wanted


def test_without_skipping_every_event_is_evaluated(lens, stream):
    graph = replace(GRAPH, min_neighbours=0, refractory_us=0)
    network = EventNetwork(random_weights(graph, has_table=False))
    p_mover, _, memory = in_chunks(network, lens, *stream, [])
    done = network.work(memory)
    assert done.evaluated == done.events == len(p_mover)
    assert done.skipped_fraction == 0.0
    assert np.all(p_mover > 0.0)


def test_a_cell_forgets_after_two_pooling_periods(lens, stream):
    events, turn_C = stream
    network = EventNetwork(random_weights(GRAPH, has_table=False))
    memory = network.init(lens)
    memory, busy = network.step(memory, events, turn_C)
    far = EventReading(
        events.t_us[-1:] + 1_000_000, np.array([47], np.int16), np.array([35], np.int16),
        np.array([1], np.int8),
    )  # fmt: skip
    _, calm = network.step(memory, far, turn_C[-1:])
    empty = network.step(network.init(lens), part(events, 0, 0), turn_C[:0])[1].objectness
    assert np.ptp(busy.objectness) > 0.0
    np.testing.assert_array_equal(calm.objectness, empty)
