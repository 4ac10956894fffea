# SPDX-License-Identifier: Apache-2.0
"""Where a figure comes from: machine, load, calibration and commit; and the file it goes into."""

import json
import os
import platform
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calibration import calibration_s

RESULTS = Path(__file__).parent / "results"


def provenance(calibrations_s: Sequence[float] = ()) -> dict[str, Any]:
    """The last entries of a result file; calibrates now where no timings are given [s]."""
    timed = list(calibrations_s) or [calibration_s()]
    return {
        "calibration_5e6_python_iterations_s": {
            "median": statistics.median(timed),
            "min": min(timed),
            "max": max(timed),
        },
        "load_average": os.getloadavg()[0],
        "machine": platform.platform(),
        "python": sys.version.split()[0],
        "commit": commit(),
    }


def commit() -> str:
    """The commit that is checked out, and whether files differ from it."""
    command = ["git", "describe", "--always", "--dirty"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def write_report(name: str, report: dict[str, Any]) -> Path:
    """Write `results/<name>.json`."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(report, indent=2) + "\n", "utf-8")
    return path
