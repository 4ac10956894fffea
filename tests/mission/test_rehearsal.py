# SPDX-License-Identifier: Apache-2.0
"""After a rehearsal a flight compiles nothing and loads nothing, and it flies as without one."""

import subprocess
import sys

import numpy as np

from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import Flight
from skyhaul.mission.rehearsal import rehearse
from skyhaul.world.load import load_config

NEW_KERNELS = """
import gc
from tempfile import TemporaryDirectory
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.mission.rehearsal import rehearse
from skyhaul.world.load import load_config

def kernels():
    found = [d for d in gc.get_objects() if isinstance(d, Dispatcher)]
    return {(d.py_func.__name__, str(sig)) for d in found for sig in d.overloads}

config = load_config(RunConfig, "paper", ["time_limit_s=9"])
with TemporaryDirectory() as root:
    rehearse(config, lambda short: RunRecorder(Path(root) / str(short.time_limit_s), short, 0), 0)
    before = kernels()
    outcome = fly(config, 0, RunRecorder(Path(root) / "run", config, 0))
assert len(before) > 50, len(before)
print("time limit" in outcome.reason, sorted(name for name, _ in kernels() - before))
"""


def test_a_rehearsal_calls_every_kernel_of_the_flight() -> None:
    run = subprocess.run([sys.executable, "-c", NEW_KERNELS], capture_output=True, text=True)
    assert run.stdout.strip() == "True []", run.stdout + run.stderr


class Way:
    """Keeps the places of the load."""

    def __init__(self):
        self.p_WL, self.closed = [], False

    def tick(self, tick):
        self.p_WL.append(tick.truth.team.p_WL)

    def close(self, outcome):
        self.closed = True

    def __getattr__(self, name):
        return lambda *_: None


def test_a_flight_does_not_depend_on_the_rehearsal():
    config = load_config(RunConfig, "paper", ["time_limit_s=0.2", "control.payload.kind=geometric"])
    ways, recorders = [], []

    def recorder(_):
        recorders.append(Way())
        return recorders[-1]

    for rehearsed in (False, True):
        if rehearsed:
            rehearse(config, recorder, 1)
        way = Way()
        Flight(config, 1, way).run(None)
        ways.append(np.array(way.p_WL))
    assert all(r.closed for r in recorders)
    assert len(recorders) == 2
    np.testing.assert_array_equal(*ways)


def test_a_start_without_room_above_it_is_rehearsed_on_the_floor_only():
    low = [
        "control.payload.kind=geometric",
        "world.room.max_m=[20, 20, 1.6]",
        "world.obstacles=[]",
        "task.goal_m=[9, 9, 0.4]",
    ]
    config = load_config(RunConfig, "paper", low)
    heights = []

    def recorder(_):
        heights.append(Way())
        return heights[-1]

    rehearse(config, recorder, 1)
    assert max(p[2] for way in heights for p in way.p_WL) < 0.5
