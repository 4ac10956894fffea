# SPDX-License-Identifier: Apache-2.0
"""Whole flights, judged by their run folders."""

import pytest

from skyhaul.evaluation.metrics import evaluate
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.world.load import load_config


@pytest.fixture
def flown(tmp_path):
    """Metrics of a flight: `flown(scenario, entries, seed)`."""

    def run(scenario, entries=(), seed=0):
        config = load_config(RunConfig, scenario, entries)
        folder = tmp_path / f"{config.name}-{seed}"
        fly(config, seed, RunRecorder(folder, config, seed))
        return evaluate(folder)

    return run
