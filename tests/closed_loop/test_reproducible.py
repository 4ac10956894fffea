# SPDX-License-Identifier: Apache-2.0
"""A flight repeats itself to the byte in another process."""

import os
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.mark.parametrize("scenario", ["paper", "gust"])
def test_two_processes_write_the_same_series(tmp_path, scenario):
    series = []
    for salt in ("1", "2"):
        folder = tmp_path / salt
        command = [sys.executable, "-m", "skyhaul", "run", scenario, "--seed", "5"]
        command += ["--set", "time_limit_s=15", "--out", str(folder)]
        env = os.environ | {"PYTHONHASHSEED": salt}
        result = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
        assert result.returncode in (0, 3), result.stderr
        series.append((folder / "states.parquet").read_bytes())
    assert series[0] == series[1]
