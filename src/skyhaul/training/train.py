# SPDX-License-Identifier: Apache-2.0
"""Training of the event network: scenes -> samples -> weights, each step resumable.

Everything is drawn from the seed and the number of the scene or of the step, so that a training
that was broken off goes on to the same weights.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from skyhaul.perception.events.classifier import EventNetwork
from skyhaul.perception.events.graph import GraphParams
from skyhaul.perception.events.weights import NetworkWeights, Record, random_weights
from skyhaul.training.data import SceneSet
from skyhaul.training.kernels import running_argmax
from skyhaul.training.model import EventNet
from skyhaul.training.samples import Sample, sample
from skyhaul.training.scenes import MOVES, STANDS, TEAM
from skyhaul.training.score import Score, classified, score
from skyhaul.whole import whole

Show = Callable[[str, int, int, str], None]
"""What is done, how much of it, of how much, and a word on how it goes."""

CHECKPOINT = "checkpoint.pt"


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How a network is trained."""

    seed: int = 0
    scenes: int = 110
    """Scenes that are learned from."""
    held_out: int = 16
    """Scenes of other flights that it is judged by."""
    updates: int = 4_000
    """Steps of the optimiser."""
    part_events: int = 12_000
    """Events of a step, one stretch of one scene."""
    cold_events: int = 1_500
    """First events of a stretch that do not count: what came before them is not known."""
    keep_events: int = 150_000
    """Events of a scene that are kept, one stretch of it."""
    rate: float = 4e-3
    """Largest learning rate; it falls to a hundredth along half a cosine."""
    objectness: float = 0.2
    """Weight of the cells' loss against that of the events."""
    average: float = 0.998
    """What the averaged weights, which are the result, keep of themselves in a step."""
    edge_term: bool = True
    """False leaves e_ij out: an ablation."""
    graph: GraphParams = field(default_factory=GraphParams)

    def __post_init__(self) -> None:
        for name in ("scenes", "held_out", "updates", "part_events", "keep_events"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be >= 1, got {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class Trained:
    """What came of it."""

    weights: NetworkWeights
    held_out: Score


def train(recipe: Recipe, scenes: SceneSet, folder: Path, show: Show) -> Trained:
    """Train and judge; scenes and checkpoints are kept in a folder."""
    torch.set_num_threads(1)
    begin = time.process_time()
    start = random_weights(recipe.graph, has_table=False, seed=recipe.seed)
    samples = _samples(recipe, scenes, start, show)
    checked, learned = samples[::10], [s for i, s in enumerate(samples) if i % 10]
    net, curve = _fit(recipe, start, learned or samples, checked, folder / CHECKPOINT, show)
    _centre(net, checked)
    record: Record = {
        "trained": 1, "seed": recipe.seed, "scenes": recipe.scenes, "updates": recipe.updates,
        "flights": ", ".join(scenes.names("train")), "events": sum(map(len, samples)),
        "recipe": str(recipe), "scene_recipe": str(scenes.recipe),
        "curve_updates_loss_f1": [v for row in curve for v in row],
    }  # fmt: skip
    weights = net.weights(record)
    found = judge(weights, scenes, recipe.held_out, show)
    record |= {
        "held_out_flights": ", ".join(scenes.names("test")), "held_out_scenes": recipe.held_out,
        "precision": found.events.precision, "recall": found.events.recall,
        "f1": found.events.f1, "object_f1": found.object_f1, "false_share": found.false_share,
        "cpu_s": time.process_time() - begin,
    }  # fmt: skip
    return Trained(replace(weights, record=record), found)


def judge(weights: NetworkWeights, scenes: SceneSet, count: int, show: Show) -> Score:
    """Score of a network, event by event, on the held-out scenes."""
    network, total = EventNetwork(weights), Score()
    for i in range(count):
        stream = scenes.stream("test", i)
        total += score(stream, classified(network, stream)[0])
        show("judging", i + 1, count, f"F1 {total.events.f1:.3f}")
    return total


def _samples(recipe: Recipe, scenes: SceneSet, start: NetworkWeights, show: Show) -> list[Sample]:
    """A stretch of each scene."""
    out = []
    for i in range(recipe.scenes):
        show("flying scenes", i, recipe.scenes, "")
        stream = scenes.stream("train", i)
        room = max(1, len(stream.label) - recipe.keep_events)
        first = int(np.random.default_rng([recipe.seed, 2, i]).integers(room))
        stretch = stream.part(first, first + recipe.keep_events)
        out.append(sample(stretch, recipe.graph, start.cell_px, start.period_us))
    show("flying scenes", recipe.scenes, recipe.scenes, "")
    return out


def _fit(
    recipe: Recipe, start: NetworkWeights, learned: list[Sample], checked: list[Sample],
    checkpoint: Path, show: Show,
) -> tuple[EventNet, list[tuple[float, float, float]]]:  # fmt: skip
    """The trained module, and its curve: updates, loss, F1 on scenes that are not learned."""
    net, slow = (EventNet(start, edge_term=recipe.edge_term) for _ in range(2))
    free = [p for p in net.parameters() if p.requires_grad]
    optimiser, first = torch.optim.Adam(free, lr=recipe.rate), 0
    curve: list[tuple[float, float, float]] = []
    if checkpoint.is_file():
        kept = torch.load(checkpoint)
        if kept["recipe"] == str(recipe):
            net.load_state_dict(kept["net"])
            slow.load_state_dict(kept["slow"])
            optimiser.load_state_dict(kept["optimiser"])
            first, curve = kept["update"], kept["curve"]
    running = curve[-1][1] if curve else math.nan
    for update in range(first, recipe.updates):
        for group in optimiser.param_groups:
            turn = math.cos(math.pi * update / recipe.updates)
            group["lr"] = recipe.rate * (0.5 * (1.0 + turn) + 0.01)
        now = _update(recipe, net, free, optimiser, learned, update)
        keep = min(recipe.average, update / (update + 10.0))
        with torch.no_grad():
            for mean, p in zip(slow.parameters(), net.parameters(), strict=True):
                mean.lerp_(p, 1.0 - keep)
        running = now if math.isnan(running) else 0.99 * running + 0.01 * now
        done = update + 1
        if done % max(1, recipe.updates // 20) == 0:
            curve.append((float(done), running, _f1(*_logits(slow, checked), 0.0)))
            with whole(checkpoint) as part:
                torch.save({"recipe": str(recipe), "net": net.state_dict(), "update": done,
                            "slow": slow.state_dict(), "optimiser": optimiser.state_dict(),
                            "curve": curve}, part)  # fmt: skip
        word = f"loss {running:.3f}" + (f", F1 {curve[-1][2]:.3f}" if curve else "")
        show("training", done, recipe.updates, word)
    return slow, curve


def _update(
    recipe: Recipe, net: EventNet, free: list[nn.Parameter], optimiser: torch.optim.Adam,
    learned: list[Sample], update: int,
) -> float:  # fmt: skip
    """One step on a stretch of one scene, seen in a mirror: its loss."""
    rng = np.random.default_rng([recipe.seed, 3, update])
    size = np.sqrt([len(s) for s in learned])
    while True:
        whole = learned[int(rng.choice(len(learned), p=size / size.sum()))]
        a = int(rng.integers(max(1, len(whole) - recipe.part_events)))
        part = whole.part(a, min(len(whole), a + recipe.part_events))
        part = part.mirrored(recipe.graph.radius_px, rng)
        value = loss(net, part, recipe.cold_events, recipe.objectness)
        if value is not None:
            break
    optimiser.zero_grad()
    value.backward()
    nn.utils.clip_grad_norm_(free, 1.0)
    optimiser.step()
    return float(value.detach())


def loss(net: EventNet, part: Sample, cold: int, objectness: float) -> Tensor | None:
    """Cross entropy of events and of their cells; None when no event counts."""
    counts = (part.label != TEAM) & part.runs
    counts[:cold] = False
    if counts.sum() < 10:
        return None
    z, logits = net(part)
    mask = torch.from_numpy(counts)
    wanted = torch.from_numpy((part.label == MOVES).astype(np.float32))
    of_events = binary_cross_entropy_with_logits(logits[mask], wanted[mask])
    in_cell = torch.from_numpy(mover_in_cell(part))
    of_cells = binary_cross_entropy_with_logits(net.objectness(z)[mask], in_cell[mask])
    total: Tensor = of_events + objectness * of_cells
    return total


def mover_in_cell(part: Sample) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Whether a cell has held an event of a mover in this pooling period or the last, (k,)."""
    moves = (part.label == MOVES).astype(np.float32)[:, None]
    newest = np.empty(moves.shape, np.int64)
    running_argmax(moves, part.runs, part.cell, part.period, newest)
    return (newest[:, 0] < len(part)).astype(np.float32)


def _logits(net: EventNet, samples: list[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """Logits and whether a mover's, of the events of samples that count."""
    logits, wanted = [], []
    with torch.no_grad():
        for s in samples:
            counts = s.label != TEAM
            z = np.where(s.runs, net(s)[1].numpy(), -np.inf)
            logits.append(z[counts])
            wanted.append(s.label[counts] == MOVES)
    return np.concatenate(logits), np.concatenate(wanted)


def _f1(logits: np.ndarray, wanted: np.ndarray, threshold: float) -> float:
    called = logits >= threshold
    return 2.0 * float((called & wanted).sum()) / max(float(called.sum() + wanted.sum()), 1.0)


def _centre(net: EventNet, samples: list[Sample]) -> None:
    """Shift the events' bias so that a probability of 1/2 is where F1 is best."""
    logits, wanted = _logits(net, samples)
    thresholds = np.linspace(-2.0, 3.0, 51)
    best = thresholds[int(np.argmax([_f1(logits, wanted, t) for t in thresholds]))]
    with torch.no_grad():
        net.head.event_bias -= float(best)


__all__ = ["MOVES", "STANDS", "Recipe", "Trained", "judge", "loss", "mover_in_cell", "train"]
