# SPDX-License-Identifier: Apache-2.0
"""The module that is trained is the operator that flies."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.camera import RadTan
from skyhaul.perception.events.batch import evaluate
from skyhaul.perception.events.classifier import EventNetwork
from skyhaul.perception.events.graph import GraphParams, event_graph
from skyhaul.perception.events.lens import event_lens
from skyhaul.perception.events.weights import load_weights, random_weights, save_weights
from skyhaul.sensors.api import EventReading
from skyhaul.training.samples import sample
from skyhaul.training.scenes import MOVES, STANDS, LabelledStream

torch = pytest.importorskip("torch", reason="torch is not installed: pip install skyhaul[train]")
from skyhaul.training.model import EventNet  # noqa: E402
from skyhaul.training.train import loss, mover_in_cell  # noqa: E402

MODEL = RadTan.from_fov((48, 36), 70.0, (-0.2, 0.05, 1e-3, -5e-4))
GRAPH = GraphParams(window_us=30_000)


@pytest.fixture(scope="module")
def stream():
    """A bar that moves over a slow pattern, seen by a camera that turns and moves."""
    rng, k = np.random.default_rng(3), 2500
    t = np.sort(rng.integers(0, 80_000, k))
    moves = rng.random(k) < 0.4
    x = np.where(moves, (t / 1500 + rng.integers(0, 3, k)) % 48, rng.integers(0, 12, k) * 4)
    y = np.where(moves, 8 + rng.integers(0, 10, k), rng.integers(0, 36, k))
    events = EventReading(
        t, x.astype(np.int16), y.astype(np.int16), rng.choice([-1, 1], k).astype(np.int8)
    )
    turn = np.outer(1e-6 * t, [0.7, -1.1, 2.0])
    v = np.tile([0.4, 0.1, -0.3], (k, 1))
    return LabelledStream(MODEL, events, turn, v, np.where(moves, MOVES, STANDS), moves + 0)


@pytest.mark.parametrize("edge_term", [True, False])
def test_torch_is_batch_is_asynchronous(stream, edge_term):
    weights = random_weights(GRAPH, has_table=False, seed=2)
    net = EventNet(weights, edge_term=edge_term)
    weights = net.weights({})
    lens, e = event_lens(MODEL), stream.events
    part = sample(stream, GRAPH, weights.cell_px, weights.period_us)
    with torch.no_grad():
        p = torch.sigmoid(net(part)[1]).numpy()
    graph = event_graph(GRAPH, lens, e, stream.turn_C, stream.v_WC_C)
    batch = evaluate(weights, lens, e, graph, int(e.t_us[-1]))
    network = EventNetwork(weights)
    _, scores = network.step(network.init(lens), e, stream.turn_C, stream.v_WC_C)
    assert part.runs.mean() > 0.5
    np.testing.assert_allclose(p[part.runs], batch.p_mover[part.runs], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(p[part.runs], scores.p_mover[part.runs], rtol=1e-5, atol=1e-7)


def test_trained_weights_come_back_from_their_file(stream, tmp_path):
    net = EventNet(random_weights(GRAPH, has_table=False))
    save_weights(net.weights({"trained": 1}), tmp_path / "w.npz")
    back = load_weights(tmp_path / "w.npz")
    assert set(back.arrays()) == set(net.state_dict())
    for name, array in back.arrays().items():
        np.testing.assert_array_equal(array, net.state_dict()[name].numpy())


def test_gradients_are_finite_differences(stream):
    torch.manual_seed(0)
    net = EventNet(random_weights(GRAPH, has_table=False, seed=1))
    part = sample(stream, GRAPH, 16, 10_000)
    loss(net, part, 100, 0.3).backward()
    for name, parameter in net.named_parameters():
        way = torch.randn_like(parameter)
        slope, step = float((parameter.grad * way).sum()), 1e-3 / float(way.norm())
        values = []
        for sign in (1.0, -1.0):
            with torch.no_grad():
                parameter += sign * step * way
                values.append(float(loss(net, part, 100, 0.3)))
                parameter -= sign * step * way
        assert (values[0] - values[1]) / (2 * step) == pytest.approx(slope, rel=0.1, abs=0.02), name


def test_some_steps_learn_something(stream):
    net = EventNet(random_weights(GRAPH, has_table=False))
    part = sample(stream, GRAPH, 16, 10_000)
    optimiser = torch.optim.Adam(net.parameters(), lr=1e-2)
    losses = []
    for _ in range(40):
        optimiser.zero_grad()
        value = loss(net, part, 100, 0.2)
        value.backward()
        optimiser.step()
        losses.append(float(value.detach()))
    assert losses[-1] < 0.6 * losses[0]


def test_a_table_is_refused():
    with pytest.raises(ValueError, match="look-up table"):
        EventNet(random_weights(GRAPH, has_table=True))


def test_a_mirrored_stream_has_the_mirrored_sample(stream):
    """Mirroring the graph is seeing the mirrored events, where no tie of distance decides."""
    graph = replace(GRAPH, max_neighbours=29)
    e, model = stream.events, RadTan.from_fov((48, 36), 70.0)
    flat = replace(stream, model=model, turn_C=0.0 * stream.turn_C)
    mirrored = replace(
        flat,
        events=EventReading(e.t_us, (47 - e.x).astype(np.int16), e.y, (-e.p).astype(np.int8)),
        v_WC_C=flat.v_WC_C * [-1.0, 1.0, 1.0],
    )

    class Draw:
        """x mirrored, polarity exchanged."""

        def choice(self, *_):
            return np.array([-1.0, 1.0, -1.0], np.float32)

        def random(self):
            return 0.9

    seen = sample(flat, graph, 16, 10_000).mirrored(3, Draw())
    wanted = sample(mirrored, graph, 16, 10_000)
    np.testing.assert_allclose(seen.inputs, wanted.inputs, atol=2e-3)
    np.testing.assert_allclose(seen.mean_edge, wanted.mean_edge, atol=1e-6)
    for i in range(len(seen)):
        rows = slice(seen.first[i], seen.first[i + 1])
        assert set(zip(seen.source[rows], seen.offset[rows], strict=True)) == set(
            zip(wanted.source[rows], wanted.offset[rows], strict=True)
        )


def test_cells_know_movers_for_two_periods(stream):
    part = sample(stream, GRAPH, 16, 10_000)
    held = mover_in_cell(part)
    assert np.all(held[(part.label == MOVES) & part.runs] == 1.0)
    assert 0.0 < held.mean() < 1.0
