# SPDX-License-Identifier: Apache-2.0
"""True states of a recorded flight, for benchmarks that look at it with other sensors."""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.evaluation.series import Run, load_run
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.model.envelope import team_shape
from skyhaul.model.state import CableState, TeamState
from skyhaul.plant.api import Truth
from skyhaul.types import LOAD_P, LOAD_Q, LOAD_V, LOAD_W
from skyhaul.world.load import load_config
from skyhaul.world.motion import obstacle_field


def flight(about: str) -> tuple[Run, argparse.Namespace]:
    """A flight of `paper`, seed 0, or the one that `--run` names; and the flags."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--quick", action="store_true", help="few frames; writes nothing")
    parser.add_argument("--run", type=Path, help="a run folder; default: fly paper, seed 0")
    args = parser.parse_args()
    if args.run is not None:
        return load_run(args.run), args
    with tempfile.TemporaryDirectory() as folder:
        config = load_config(RunConfig, "paper")
        recorder = RunRecorder(Path(folder), config, 0)
        fly(config, 0, recorder)
        return load_run(folder), args


def truths(run: Run) -> Callable[[int], Truth]:
    """Truth at a row of a run."""
    s, scenario = run.series, run.scenario
    n = scenario.team.count
    field = obstacle_field(scenario.world, run.origin.seed, team_shape(scenario.team, 0.0))

    def truth(k: int) -> Truth:
        t_us, load = int(s["t"][k]), s["load"][k]
        team = TeamState(
            load[LOAD_P].copy(), load[LOAD_Q].copy(), load[LOAD_V].copy(), load[LOAD_W].copy(),
            s["vehicle_p"][k].copy(), s["vehicle_q"][k].copy(),
            s["vehicle_v"][k].copy(), s["vehicle_w"][k].copy(),
        )  # fmt: skip
        tension, length = s["cable_tension"][k].copy(), s["cable_length"][k].copy()
        return Truth(
            stamp_us=t_us, team=team,
            cables=CableState(s["cable_dir"][k].copy(), s["cable_w"][k].copy(), tension, length),
            attached=s["cable_attached"][k] > 0, alive=s["vehicle_alive"][k] > 0,
            rotor_thrust=s["vehicle_rotor"][k].copy(), accel_W=np.zeros((1 + n, 3)),
            obstacles=field.shapes_at(t_us), v_WO=field.velocities_at(t_us),
            present=field.present(t_us, team.p_WL), wind_W=np.zeros(3), clearance_m=np.inf,
            contacts=(),
        )  # fmt: skip

    return truth
