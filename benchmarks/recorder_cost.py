# SPDX-License-Identifier: Apache-2.0
"""Claim: recording a flight of four vehicles takes at most 0.1 CPU seconds per simulated second.

Ten seconds of ticks at 500 Hz among six movers, twenty solves a second and fifty messages a
second, into a run folder; CPU time, with a calibration loop timed in the same run (5e6 iterations
of pure Python).
"""

import json
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from provenance import provenance
from provenance import write_report as save

from skyhaul.comms.api import Envelope
from skyhaul.control.api import ForcePlan, Solution, SolveStatus, VehicleCommand
from skyhaul.evaluation.metrics import evaluate
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.evaluation.report import write_report
from skyhaul.mission.api import Outcome, Phase, Solve, Tick
from skyhaul.perception.api import TeamEstimate
from skyhaul.plant.api import PLANT_STEP_US, Truth
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.world.load import load_config
from skyhaul.world.scenario import AirStart, HoverTask, Scenario

SPAN_US, REPEATS = 10_000_000, 5


def tick_of(truth: Truth) -> Tick:
    """What a flight would tell about this truth."""
    n = truth.team.n
    force = -truth.cables.tension[:, None] * truth.cables.dir_W
    thrust = truth.rotor_thrust.sum(axis=1)
    estimate = TeamEstimate(
        truth.stamp_us, truth.team, truth.cables, truth.attached, thrust, np.zeros((12, 12))
    )
    command = VehicleCommand(thrust, np.zeros((n, 3)), force, np.zeros((n, 3)))
    return Tick(
        truth, estimate, Phase.HOVER, truth.team.load, command, truth.rotor_thrust, force, thrust,
        truth.cables.dir_W,
    )  # fmt: skip


def solve_at(t_us: int, n: int) -> Solve:
    """A plan of 21 nodes with gains."""
    k, rng = 21, np.random.default_rng(t_us)
    plan = ForcePlan(
        t_us, np.linspace(0.0, 2.0, k), rng.normal(size=(k, 13)), rng.normal(size=(k, 3)),
        rng.normal(size=(k, n, 3)), rng.normal(size=(k, n, 3)), rng.normal(size=(k, n, 3, 12)),
        rng.normal(size=(k, n)), np.ones(n, dtype=np.bool_),
    )  # fmt: skip
    return Solve(t_us, "period", Solution(SolveStatus.OK, plan, 1e-6, 8, 0.0, 2.0))


def record(folder: Path, scenario: Scenario) -> float:
    """CPU seconds per simulated second of the recorder alone."""
    plant = MujocoPlant(scenario, 0)
    rotors = plant.truth().rotor_thrust
    recorder, spent, truth = RunRecorder(folder, scenario, 0), 0.0, plant.truth()
    for t_us in range(0, SPAN_US, PLANT_STEP_US):
        tick = tick_of(replace(truth, contacts=()))
        begin = time.process_time()
        recorder.tick(tick)
        if t_us % 20_000 == 0:
            recorder.message(Envelope("heartbeat", 0, t_us, t_us, 100, None))
        if t_us % 50_000 == 0:
            recorder.solve(solve_at(t_us, scenario.team.count))
        spent += time.process_time() - begin
        truth = plant.step(rotors)
    begin = time.process_time()
    recorder.close(Outcome(False, "end of the benchmark", SPAN_US, {}, 1.0))
    return 1e6 * (spent + time.process_time() - begin) / SPAN_US


def main() -> None:
    """Measure and write the result."""
    paper = load_config(Scenario, "paper")
    scenario = replace(paper, start=AirStart(payload_m=(5.0, 5.0, 5.0)), task=HoverTask())
    rows, sizes = [], {}
    report_s = 0.0
    with tempfile.TemporaryDirectory() as root:
        record(Path(root) / "warm-up", scenario)
        for k in range(REPEATS):
            folder = Path(root) / str(k)
            rows.append(record(folder, scenario))
            evaluate(folder)
            begin = time.process_time()
            write_report(folder)
            report_s = time.process_time() - begin
            sizes = {p.name: p.stat().st_size for p in sorted(folder.iterdir())}
    result = {
        "claim": "recording 4 vehicles at 500 Hz: <= 0.1 CPU s per simulated s",
        "rows": [
            {
                "measure": "recorder, 4 vehicles, 6 movers, 20 solves a second",
                "value": statistics.median(rows),
                "unit": "CPU s per simulated s",
                "bar": "<= 0.1",
            }
        ],
        "min": min(rows),
        "max": max(rows),
        "bytes_of_10_s": sizes,
        "report_cpu_s": report_s,
        **provenance(),
    }
    save("recorder_cost", result)
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
