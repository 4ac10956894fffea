# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C in mid-flight."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from skyhaul.cli.main import main


@pytest.mark.slow
def test_ctrl_c_leaves_a_readable_run_folder(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    command = [sys.executable, "-m", "skyhaul", "run", "circle", "--out", str(folder)]
    flight = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert flight.stderr is not None
    begun = (line for line in flight.stderr if "t = 0.0 s" in line)
    assert next(begun)
    time.sleep(1.0)
    flight.send_signal(signal.SIGINT)
    out, err = flight.communicate(timeout=120)
    assert flight.returncode == 130, err
    assert "interrupted" in out
    said = err.splitlines()[-1]
    assert said == f"skyhaul: interrupted; what was flown is kept in {folder}, with its report"
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["mission_success"] is False
    assert not list(folder.glob("*.part"))
    assert main(["report", str(folder)]) == 0
    assert (folder / "report.html").stat().st_size > 10_000
