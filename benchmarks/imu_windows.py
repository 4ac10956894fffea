# SPDX-License-Identifier: Apache-2.0
"""Claim: from the true state, a real IMU alone stays within 3 cm, 5 cm/s, 0.15 deg for a second.

EuRoC V1_02: windows of 1 s, 0.25 s apart, over the whole flight, started from the recorded truth
(pose, velocity, biases); medians of the errors at the end. The folder comes from `--data`.
"""

import argparse
import json
import platform
import sys
from pathlib import Path

import numpy as np
from calibration import calibration_s
from provenance import RESULTS, commit

from skyhaul.geometry.quaternion import quat_conj, quat_log, quat_mul, quat_normalize
from skyhaul.perception.vio.api import NavState
from skyhaul.perception.vio.imu import ImuNoise, advance, segments, since
from skyhaul.sensors.api import ImuReading
from skyhaul.types import Array

EPOCH_NS = 1403715523912143104
WINDOW, EVERY = 200, 50  # rows of the truth, 5 ms each
BARS = {"position_m": 0.03, "velocity_mps": 0.05, "attitude_deg": 0.15}


def read(file: Path) -> tuple[Array, Array]:
    """Times [us] from the first IMU sample, and the other columns."""
    stamps = np.loadtxt(file, delimiter=",", comments="#", usecols=0, dtype=np.int64)
    rows = np.loadtxt(file, delimiter=",", comments="#")
    return (stamps - EPOCH_NS) // 1000, rows[:, 1:].copy()


def window_errors(imu: ImuReading, stamps: Array, truth: Array) -> Array:
    """Errors after each window: position [m], velocity [m/s], attitude [deg], (n, 3)."""
    noise, errors = ImuNoise().densities(), []
    for i in range(0, len(stamps) - WINDOW, EVERY):
        j = i + WINDOW
        a, b = truth[i], truth[j]
        state = NavState(a[:3], quat_normalize(a[3:7]), a[7:10], a[10:13], a[13:16])
        first, last = int(stamps[i]), int(stamps[j])
        end, _, _ = advance(state, segments(since(imu, first), first, last), noise)
        turn = quat_log(quat_mul(quat_conj(quat_normalize(b[3:7])), end.q_WI))
        both = (end.p_WI - b[:3], end.v_WI - b[7:10], np.degrees(turn))
        errors.append([float(np.linalg.norm(e)) for e in both])
    return np.array(errors)


def main() -> None:
    """Print the medians and write `results/imu_windows.json`."""
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=default, help="folder of the recordings")
    folder = parser.parse_args().data / "euroc"
    if not folder.is_dir():
        print(f"skipped: no recordings in {folder}; give --data DIR")
        return
    imu_us, imu = read(folder / "V1_02_medium_imu.csv")
    stamps, truth = read(folder / "V1_02_medium_truth.csv")
    reading = ImuReading(imu_us, imu[:, :3].copy(), imu[:, 3:].copy())
    errors = window_errors(reading, stamps, truth)
    rows = {}
    for column, (name, bar) in zip(errors.T, BARS.items(), strict=True):
        p50, p90 = (float(np.percentile(column, q)) for q in (50, 90))
        rows[name] = {"median": p50, "p90": p90, "bar": bar, "met": p50 <= bar}
        print(f"{name}: median {p50:.4f}, 90 % {p90:.4f}  [bar {bar}]")
    report = {
        "claim": (__doc__ or "").splitlines()[0],
        "windows": len(errors),
        **rows,
        "calibration_5e6_python_iterations_s": calibration_s(),
        "machine": platform.platform(),
        "python": sys.version.split()[0],
        "commit": commit(),
    }
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / "imu_windows.json"
    path.write_text(json.dumps(report, indent=2) + "\n", "utf-8")
    print(f"-> {path}")


if __name__ == "__main__":
    main()
