# SPDX-License-Identifier: Apache-2.0
"""Claim: from the events of four vehicles, movers become confirmed 3-D tracks before they matter.

Flights on truth are replayed through the event cameras of all vehicles; the chain (noise filter,
classifier, clusters every 10 ms, directions in the world by the true poses, tracker of the team)
runs over the streams as it would in flight, and its tracks are compared with the truth.

`--classifier labels` takes the label channel instead of a classifier: an upper bound, which shows
what the chain after the classifier can do. `--classifier timestamp` or `network` is what there is.

Each flight's figures are kept in the folder; what is there already is not done again.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from calibration import calibration_s
from mover_chain import mover_labels, sights, team_watch
from mover_score import NEAR_M, Followed, score
from mover_streams import streams
from mover_truth import seen
from provenance import provenance, write_report

from skyhaul.perception.events.classifier import NetworkParams
from skyhaul.perception.events.timestamp import TimestampParams
from skyhaul.perception.obstacles.from_events import EventObstacles
from skyhaul.perception.obstacles.particles import ParticleFilter
from skyhaul.perception.obstacles.tracker import BearingTracker

BATCH_EVENTS = 1_500
"""Events of one camera in 10 ms at 150 k a second."""


def params_of(args: argparse.Namespace) -> EventObstacles:
    """The estimator that the flags ask for."""
    tracker = (
        BearingTracker(filter=ParticleFilter()) if args.filter == "particles" else BearingTracker()
    )
    weights = str(args.weights) if args.weights else None
    classifier = (
        TimestampParams() if args.classifier == "timestamp" else NetworkParams(weights=weights)
    )
    return EventObstacles(tracker=tracker, classifier=classifier)


def one_flight(args: argparse.Namespace, scenario: str, seed: int) -> dict[str, Any]:
    """Run the chain over a flight and score it."""
    folder = args.folder
    flight = streams(scenario, seed, folder)
    movers = mover_labels(flight)
    truth_seen = seen(flight, movers, folder / f"{scenario}-{seed}.seen.npz")
    watch = team_watch(flight, params_of(args), labels=args.classifier == "labels")
    memory, steps, cost = watch.init(), [], []
    for row, sight in sights(flight):
        begin = time.process_time()
        memory, estimate = watch.step(memory, sight)
        spent = time.process_time() - begin
        cost.append((spent, *(len(v.events.t_us) for v in sight.vehicles)))
        steps.append(Followed(row, estimate.tracks))
    found = score(steps, flight.truth, movers, truth_seen)
    return {
        "scenario": scenario, "seed": seed, **found, **_cost(np.array(cost), len(flight.vehicles)),
        "events": int(sum(len(v.label) for v in flight.vehicles)),
        "calibration_s": calibration_s(),
    }  # fmt: skip


def _cost(cost: Any, vehicles: int) -> dict[str, float]:  # noqa: ANN401
    """CPU time of a step of one vehicle: c0 + c1 events, fitted over the steps [ms]."""
    spent, events = 1e3 * cost[50:, 0] / vehicles, cost[50:, 1:].mean(axis=1)
    A = np.column_stack([np.ones(len(events)), events])
    c0, c1 = np.linalg.lstsq(A, spent, rcond=None)[0]
    return {
        "step_ms_median": float(np.median(spent)),
        "step_ms_p99": float(np.quantile(spent, 0.99)),
        "step_ms_at_150k": float(c0 + c1 * BATCH_EVENTS),
    }


def rows(done: list[dict[str, Any]]) -> list[tuple[str, Any, str, str]]:
    """The lines of the table."""
    counted = [a for f in done for a in f["approaches"] if a["counts"]]
    close = [a for a in counted if a["least_m"] < 2.0]
    near = [e for f in done for e in f["near"]]
    late = [x for f in done for x in f["latency_ms"]]
    looks = {k: sum(f["coverage"][k] for f in done) for k in ("looks", "one", "two")}
    held = [h for f in done for h in f["tube_held"]]
    p = _rms([e["p_m"] for e in near])
    two = [e for e in near if e["cameras"] >= 2]
    known = [x if x is not None else np.inf for x in late]
    quick = float(np.mean(np.array(known) <= 80.0)) if known else None
    return [
        ("movers that came within 3 m and were seen before", len(counted), "", ""),
        ("of these that came within 2 m", len(close), "", ""),
        ("of these confirmed before 2 m (mover in the tube)", sum(a["found"] for a in close), "",
         f"{len(close)}"),
        ("of these also within 0.5 m of the truth", sum(a["placed"] for a in close), "", ""),
        (f"position RMSE at {NEAR_M:.0f} m", p, "m", "<= 0.25"),
        (f"velocity RMSE at {NEAR_M:.0f} m", _rms([e["v_mps"] for e in near]), "m/s", "<= 0.3"),
        ("median of the position error there", _median([e["p_m"] for e in near]), "m", ""),
        ("median of the velocity error there", _median([e["v_mps"] for e in near]), "m/s", ""),
        ("position RMSE, two cameras in the last 0.5 s", _rms([e["p_m"] for e in two]), "m", ""),
        ("velocity RMSE, two cameras in the last 0.5 s", _rms([e["v_mps"] for e in two]), "m/s",
         ""),
        ("name changes of well-separated movers", sum(f["switches"] for f in done), "", "0"),
        ("movers within 4 m seen by an event camera", looks["one"] / max(looks["looks"], 1), "",
         ">= 0.8"),
        ("movers within 4 m seen by two", looks["two"] / max(looks["looks"], 1), "", ""),
        ("12 px -> confirmed, median", float(np.median(known)) if known else None, "ms", "<= 80"),
        ("12 px -> confirmed within 80 ms", quick, "", "1"),
        ("times that a mover came into view", len(known), "", ""),
        ("tube holds the mover over the next second", float(np.mean(held)) if held else None, "",
         "0.90-0.99"),
        ("tracks of nothing, a minute", 60.0 * sum(f["false_tracks"] for f in done)
         / sum(f["duration_s"] for f in done), "1/min", ""),
        ("CPU of a 10 ms batch at 150 k events/s, a vehicle and its share of the tracker, median",
         float(np.median([f["step_ms_at_150k"] for f in done])), "ms", "<= 3.5"),
        ("calibration beside it", float(np.median([f["calibration_s"] for f in done])), "s", ""),
    ]  # fmt: skip


def _rms(values: list[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


def arguments() -> argparse.Namespace:
    """Flags."""
    parser = argparse.ArgumentParser(description="tracks of movers from the events of a team")
    parser.add_argument(
        "--scenarios", default="crossing:10,paper:10", help="names, and how many seeds of each"
    )
    parser.add_argument(
        "--classifier", default="labels", choices=("labels", "timestamp", "network")
    )
    parser.add_argument("--weights", type=Path, help="of the network, instead of those that ship")
    parser.add_argument("--filter", default="kalman", choices=("kalman", "particles"))
    parser.add_argument("--folder", type=Path, default=Path("benchmarks/streams"))
    parser.add_argument("--name", help="of the result; default: no result is written")
    parser.add_argument("--again", action="store_true", help="score flights anew")
    return parser.parse_args()


def main() -> None:
    """Run, print, write."""
    args = arguments()
    tables = {}
    for case in args.scenarios.split(","):
        scenario, _, seeds = case.partition(":")
        done = []
        for seed in range(int(seeds or 1)):
            kept = args.folder / f"{scenario}-{seed}.{args.classifier}-{args.filter}.json"
            if args.again or not kept.exists():
                kept.parent.mkdir(parents=True, exist_ok=True)
                kept.write_text(json.dumps(one_flight(args, scenario, seed)), "utf-8")
            done.append(json.loads(kept.read_text("utf-8")))
            print(f"{scenario} {seed} done", flush=True)
        tables[scenario] = done
        for row in rows(done):
            value = "-" if row[1] is None else f"{row[1]:.4g}"
            print(f"{scenario}: {row[0]}: {value} {row[2]}  [{row[3]}]")
    if args.name:
        write_report(args.name, {
            "claim": "from the events of four vehicles movers become confirmed tracks in time",
            "classifier": args.classifier, "filter": args.filter,
            "rows": [dict(zip(("measure", "value", "unit", "bar"), (f"{s}: {r[0]}", *r[1:]),
                              strict=True)) for s, done in tables.items() for r in rows(done)],
            "flights": [{k: f[k] for k in ("scenario", "seed", "approaches", "switches",
                                           "false_tracks", "step_ms_median", "step_ms_p99")}
                        for done in tables.values() for f in done],
            **provenance([f["calibration_s"] for done in tables.values() for f in done]),
        })  # fmt: skip


if __name__ == "__main__":
    main()
