# SPDX-License-Identifier: Apache-2.0
"""Claim: one core runs all of the event network on >= 400 k (shared) or 150 k (table) events/s.

16 channels, 4 layers, the graph included.

Events per CPU second of events that went through all layers, on real recordings and on dense made
up ones (16 neighbours each); the same computation event by event as for the whole stream at once
(largest relative difference); what skipping and pruning save, counted. Untrained weights: the work
does not depend on them but for pruning. A calibration loop of pure Python is timed beside each
rate, and the rate scaled to a machine on which it takes 0.12 s.
"""

import argparse
import json
import os
import platform
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from calibration import calibration_s
from provenance import RESULTS, commit

from skyhaul.geometry.camera import RadTan
from skyhaul.perception.events.api import Work
from skyhaul.perception.events.batch import evaluate
from skyhaul.perception.events.classifier import EventNetwork
from skyhaul.perception.events.graph import GraphParams, event_graph
from skyhaul.perception.events.lens import EventLens, event_lens
from skyhaul.perception.events.recordings import read_calibration, read_rate, read_recording
from skyhaul.perception.events.rotation import TurnMemory, turn_at
from skyhaul.perception.events.weights import NetworkWeights, random_weights
from skyhaul.sensors.api import EventReading
from skyhaul.types import Array

GOOD_DAY_S = 0.12
DATA = Path(os.environ.get("SKYHAUL_DATA", "../shared/data"))
REPEATS = 3
EXACT_EVENTS = 12_000
CHUNK = 1_500  # events, 10 ms at 150 k/s
Stream = tuple[EventLens, EventReading, Array]


def part(events: EventReading, a: int, b: int) -> EventReading:
    """Events a to b."""
    return EventReading(events.t_us[a:b], events.x[a:b], events.y[a:b], events.p[a:b])


def made_up(count: int, seed: int = 0) -> Stream:
    """Edges that sweep over 160 x 120 pixels at 150 k events/s: close to 16 neighbours each."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, int(count / 0.15), count))
    x = (t / 4000 + rng.integers(0, 4, count) * 40 + rng.integers(0, 2, count)) % 160
    y = rng.integers(0, 120, count)
    p = rng.choice([-1, 1], count)
    events = EventReading(t, x.astype(np.int16), y.astype(np.int16), p.astype(np.int8))
    lens = event_lens(RadTan.from_fov((160, 120), 80.0))
    return lens, events, np.outer(1e-6 * t, [0.3, -0.5, 0.2])


def recorded(name: str) -> Stream:
    """A real recording; of the aeroplane 150 k events after the image at its start."""
    if name == "dvs":
        made = read_recording(DATA / "events" / "dvs.es")
        first = made.width * made.height
        events = part(made.events, first, first + 150_000)
        lens = event_lens(RadTan.from_fov((made.width, made.height), 60.0))
        return lens, events, np.zeros((len(events.t_us), 3))
    folder = DATA / "ijrr" / name
    events = read_recording(folder / "events.txt").events
    lens = event_lens(read_calibration(folder / "calib.txt", (240, 180)))
    _, turn = turn_at(
        TurnMemory(), events.t_us[:1], read_rate(folder / "motion.txt")[None], events.t_us
    )
    return lens, events, turn


def timed(network: EventNetwork, stream: Stream) -> tuple[float, Work]:
    """CPU time of a stream in chunks [s], the best of some repeats, and what was done."""
    lens, events, turn = stream
    best, work = np.inf, Work()
    for _ in range(REPEATS):
        memory = network.init(lens)
        begin = time.process_time()
        for a in range(0, len(events.t_us), CHUNK):
            memory, _ = network.step(memory, part(events, a, a + CHUNK), turn[a : a + CHUNK])
        best = min(best, time.process_time() - begin)
        work = network.work(memory)
    return best, work


def difference(weights: NetworkWeights, stream: Stream) -> float:
    """Event by event against the whole stream at once: largest relative difference."""
    lens, events, turn = stream
    events, turn = part(events, 0, EXACT_EVENTS), turn[:EXACT_EVENTS]
    network = EventNetwork(weights)
    _, scores = network.step(network.init(lens), events, turn)
    graph = event_graph(weights.graph, lens, events, turn)
    wanted = evaluate(weights, lens, events, graph, int(events.t_us[-1]))
    pairs = (scores.p_mover, wanted.p_mover), (scores.objectness, wanted.objectness)
    return max(float(np.max(np.abs(a - b)) / np.max(np.abs(b))) for a, b in pairs)


def case(weights: NetworkWeights, stream: Stream, *, prune: bool) -> dict[str, Any]:
    """One network on one stream."""
    before = calibration_s()
    seconds, work = timed(EventNetwork(weights, prune=prune), stream)
    calibration = 0.5 * (before + calibration_s())
    rate = work.evaluated / seconds
    return {
        "events": work.events,
        "evaluated_per_cpu_s": rate,
        "calibration_s": calibration,
        "scaled_per_s": rate * calibration / GOOD_DAY_S,
        "skipped_fraction": work.skipped_fraction,
        "lonely": work.lonely,
        "refractory": work.refractory,
        "neighbours_per_event": work.edges / max(work.events - work.refractory, 1),
        "flops_per_event": 2.0 * work.multiply_adds / work.events,
        "pruned_fraction": work.pool_prunes / max(work.evaluated, 1),
    }


def main() -> None:
    """Measure, print, write the result."""
    parser = argparse.ArgumentParser(description="throughput of the event network")
    parser.add_argument("--quick", action="store_true", help="fewer events; writes nothing")
    quick = parser.parse_args().quick
    streams = {"made up, dense": made_up(30_000 if quick else 150_000)}
    if DATA.is_dir():
        streams |= {n: recorded(n) for n in ("dvs", "poster_rotation", "shapes_rotation")}
    found: dict[str, dict[str, Any]] = {}
    worst: dict[str, float] = {}
    every = replace(GraphParams(), min_neighbours=0, refractory_us=0)
    for kind in ("shared", "table"):
        weights = random_weights(GraphParams(), has_table=kind == "table")
        whole = replace(weights, graph=every)
        for name, stream in streams.items():
            worst[f"{kind}, {name}"] = difference(weights, stream)
            found[f"{kind}, {name}, all evaluated"] = case(whole, stream, prune=False)
            found[f"{kind}, {name}, pruned"] = case(whole, stream, prune=True)
            found[f"{kind}, {name}, skipped and pruned"] = case(weights, stream, prune=True)
    rows = [
        (
            "asynchronous against batch, largest relative difference",
            max(worst.values()),
            "",
            "<= 1e-5",
        )
    ]
    for kind, bar in (("shared", 400), ("table", 150)):
        mine = {k: v for k, v in found.items() if k.startswith(kind) and "all" in k}
        for name, c in mine.items():
            rows.append((f"{name}: events/s, now", 1e-3 * c["evaluated_per_cpu_s"], "k", ""))
            rows.append((f"{name}: the same, scaled", 1e-3 * c["scaled_per_s"], "k", f">= {bar}"))
    for row in rows:
        print(f"{row[0]}: {row[1]:.3g} {row[2]}  [{row[3]}]")
    if quick:
        return
    report = {
        "claim": "event network: >= 400 k events/s shared, >= 150 k look-up table, one core",
        "rows": [dict(zip(("measure", "value", "unit", "bar"), r, strict=True)) for r in rows],
        "cases": found,
        "relative_difference": worst,
        "good_day_calibration_s": GOOD_DAY_S,
        "weights": "random, seed 0: work is that of trained ones, scores mean nothing",
        "load_average": os.getloadavg()[0],
        "machine": platform.platform(),
        "python": sys.version.split()[0],
        "commit": commit(),
    }
    (RESULTS / "event_network.json").write_text(json.dumps(report, indent=2) + "\n", "utf-8")


if __name__ == "__main__":
    main()
