# SPDX-License-Identifier: Apache-2.0
"""Claim: the event network tells what moves by itself from what the flying camera makes move.

Labelled event streams of randomised scenes, seen from flights that no training scene is seen from,
with six degrees of freedom of ego-motion: precision, recall and F1 of the shipped weights per event
and per object and 50 ms, of the timestamp recipe on the same streams, and of the network with its
skipping on, off, and one at a time; each with its cost. Then where nothing moves but the camera:
scenes of 10 s without movers, and two real recordings; and the real aeroplane before a still one.

Scenes are made once and kept in a folder (`--work`), so that a run that was broken off goes on. The
training folder of `skyhaul train-events` serves.
"""

import argparse
import json
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from calibration import calibration_s
from event_network import DATA, recorded
from provenance import provenance, write_report

from skyhaul.perception.events.api import EventClassifier, Work
from skyhaul.perception.events.classifier import EventNetwork
from skyhaul.perception.events.noise_filter import KEPT, NoiseFilter, chosen
from skyhaul.perception.events.timestamp import TimestampParams
from skyhaul.perception.events.weights import load_weights, shipped_weights
from skyhaul.training.data import SceneSet
from skyhaul.training.scenes import SceneRecipe, scene_stream
from skyhaul.training.score import Score, classified, score

STILL = SceneRecipe(duration_s=10.0, movers=(0, 0), still_share=0.0, most_events=2_000_000)


@dataclass
class Sum:
    """Score, work and time of one classifier."""

    score: Score = field(default_factory=Score)
    events: int = 0
    evaluated: int = 0
    multiply_adds: int = 0
    cpu_s: float = 0.0
    work: list[Work] = field(default_factory=list)

    def row(self) -> dict[str, Any]:
        """Figures of a table."""
        s = self.score
        return {
            "precision": s.events.precision, "recall": s.events.recall, "f1": s.events.f1,
            "object_precision": s.clusters.precision, "object_recall": s.objects.recall,
            "object_f1": s.object_f1, "false_share": s.false_share, "events": self.events,
            "mover_share": s.events.wanted / max(s.events.wanted + s.standing, 1),
            "us_per_event": 1e6 * self.cpu_s / max(self.events, 1),
            "flops_per_event": 2.0 * self.multiply_adds / max(self.events, 1),
            "skipped_fraction": 1.0 - self.evaluated / max(self.events, 1),
            "lonely_fraction": sum(w.lonely for w in self.work) / max(self.events, 1),
            "refractory_fraction": sum(w.refractory for w in self.work) / max(self.events, 1),
            "pruned_fraction": sum(w.pool_prunes for w in self.work) / max(self.evaluated, 1),
        }  # fmt: skip


def networks(ablation: Path | None) -> dict[str, EventClassifier[Any]]:
    """All that are compared, by name."""
    weights = shipped_weights()
    lone = replace(weights, graph=replace(weights.graph, min_neighbours=0))
    rapid = replace(weights, graph=replace(weights.graph, refractory_us=0))
    whole = replace(weights, graph=replace(weights.graph, min_neighbours=0, refractory_us=0))
    made: dict[str, EventClassifier[Any]] = {
        "network": EventNetwork(weights),
        "network, nothing skipped, nothing pruned": EventNetwork(whole, prune=False),
        "network, nothing skipped, pruned": EventNetwork(whole),
        "network, only refractory skipped, pruned": EventNetwork(lone),
        "network, only lonely skipped, pruned": EventNetwork(rapid),
        "timestamp": TimestampParams(),
    }
    if ablation is not None:
        made["network without the edge term"] = EventNetwork(load_weights(ablation))
    return made


def compare(scenes: SceneSet, count: int, ablation: Path | None) -> dict[str, dict[str, Any]]:
    """Every classifier on every held-out scene."""
    made = networks(ablation)
    sums = {name: Sum() for name in made}
    for i in range(count):
        stream = scenes.stream("test", i)
        for name, classifier in made.items():
            if i == 0:
                classified(classifier, stream.part(0, 500))
            begin = time.process_time()
            p_mover, work = classified(classifier, stream)
            mine = sums[name]
            mine.cpu_s += time.process_time() - begin
            mine.score += score(stream, p_mover)
            mine.events += work.events
            mine.evaluated += work.evaluated
            mine.multiply_adds += work.multiply_adds
            mine.work.append(work)
        print(f"scene {i + 1} of {count}: F1 {sums['network'].score.events.f1:.3f}, timestamp "
              f"{sums['timestamp'].score.events.f1:.3f}", file=sys.stderr, flush=True)  # fmt: skip
    return {name: mine.row() for name, mine in sums.items()}


def camera_only(scenes: SceneSet) -> dict[str, float]:
    """Share of events called a mover's where only the camera moves."""
    found, network = {}, EventNetwork(shipped_weights())
    for k, name in enumerate(scenes.names("test")):
        stream = scene_stream(scenes.flight(name), STILL, 900_000 + k)
        mine = score(stream, classified(network, stream)[0])
        found[f"static scene, 10 s of {name}"] = mine.false_share
    if DATA.is_dir():
        for name in ("poster_rotation", "shapes_rotation"):
            lens, events, turn = recorded(name)
            noise = NoiseFilter()
            _, why = noise.step(noise.init(lens.width, lens.height), events)
            keep = why == KEPT
            _, scores = network.step(network.init(lens), chosen(events, keep), turn[keep])
            found[name] = float(scores.mover.mean())
    return found


def main() -> None:
    """Measure, print, write the result."""
    parser = argparse.ArgumentParser(description="the event network against what moves")
    parser.add_argument("--work", type=Path, default=Path("train-events"), help="folder of scenes")
    parser.add_argument("--scenes", type=int, default=16, help="held-out scenes")
    parser.add_argument("--ablation", type=Path, help="weights trained with --no-edge-term")
    parser.add_argument("--quick", action="store_true", help="two scenes; writes nothing")
    args = parser.parse_args()
    scenes = SceneSet(args.work)
    calibration = calibration_s()
    table = compare(scenes, 2 if args.quick else args.scenes, args.ablation)
    alone = {} if args.quick else camera_only(scenes)
    best, recipe = table["network"], table["timestamp"]
    rows = [
        ("F1 per event, held-out scenes, network", best["f1"], "", ">= 0.85"),
        ("F1 per object and 50 ms, network", best["object_f1"], "", ">= 0.9"),
        ("F1 per event, timestamp", recipe["f1"], "", "below the network"),
        ("F1 per object and 50 ms, timestamp", recipe["object_f1"], "", "below the network"),
        *((f"called movers, {name}", 100.0 * v, "%", "<= 3") for name, v in alone.items()),
    ]
    for name, row in table.items():
        print(name, json.dumps({k: round(v, 4) for k, v in row.items()}))
    for name, value, unit, bar in rows:
        print(f"{name}: {value:.3g} {unit}  [{bar}]")
    if args.quick:
        return
    report = {
        "claim": "the event network tells movers from ego-motion",
        "rows": [dict(zip(("measure", "value", "unit", "bar"), r, strict=True)) for r in rows],
        "table": table,
        "camera_only": alone,
        "training": shipped_weights().record,
        **provenance([calibration, calibration_s()]),
    }
    write_report("event_movers", report)


if __name__ == "__main__":
    main()
