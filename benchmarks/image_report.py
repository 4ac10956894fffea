# SPDX-License-Identifier: Apache-2.0
"""The result file of a benchmark of images: rows, notes, machine, calibration, commit."""

import json
import os
import platform
import statistics
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numba
from provenance import RESULTS, commit
from result_file import Row

GOOD_DAY_S = 0.12
"""CPU time of the calibration loop on the same machine when nothing else runs on it [s]."""


def publish(
    name: str,
    claim: str,
    rows: Sequence[Row],
    notes: Mapping[str, Any],
    calibration: Sequence[float],
    *,
    write: bool,
) -> None:
    """Print the rows and, unless this was a small case, write `results/<name>.json`."""
    for row in rows:
        value = f"{row.value:.4g}" if isinstance(row.value, float) else row.value
        print(f"{row.measure}: {value} {row.unit}  [{row.bar}]")
    print("calibration loop:", " ".join(f"{c:.3f}" for c in calibration), "s")
    if not write:
        return
    report = {
        "claim": claim,
        "rows": [vars(row) for row in rows],
        **notes,
        "calibration_5e6_python_iterations_s": {
            "median": statistics.median(calibration),
            "min": min(calibration),
            "max": max(calibration),
            "on_a_good_day": GOOD_DAY_S,
        },
        "load_average": os.getloadavg()[0],
        "machine": platform.platform(),
        "python": sys.version.split()[0],
        "numba": numba.__version__,
        "opencv": cv2.__version__,
        "commit": commit(),
    }
    path = RESULTS / f"{name}.json"
    path.write_text(json.dumps(report, indent=2) + "\n", "utf-8")
    print(f"-> {path}")
