# SPDX-License-Identifier: Apache-2.0
"""Claims: exact IMU samples lead back to the flown way; a day at rest gives the data sheet back.

Dead reckoning within 10 mm in 15 s: strapdown integration, each sample held over its period, of
the default IMUs of the load (100 Hz) and of four vehicles (500 Hz) in `paper`, over every window of
15 s that begins at a multiple of 2.5 s; beside it the same with samples of the truth at the
instants of the steps, held and by the trapezoidal rule. Noise density and random walk within 15 %:
Allan deviation of 24 h at 500 Hz, default parameters, overlapping, from means over 0.1 s. Cost: all
IMUs of a team of four, the load's included, readings made, at most 20 us a step where the
calibration loop takes 0.12 s.
"""

import argparse
import json
import os
import platform
import sys
import time
from pathlib import Path
from typing import Any

import numba
import numpy as np
from calibration import calibration_s
from provenance import commit

from skyhaul.evaluation.allan import fit_noise
from skyhaul.geometry.kernels import quat_exp, quat_mul, quat_rotate
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.mission.api import Outcome, Tick
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import fly
from skyhaul.mission.replay import TrackRecorder
from skyhaul.sensors.config import SensorsConfig
from skyhaul.sensors.imu import Imu, imu_bank, without_errors
from skyhaul.sensors.imu_kernel import imu_still
from skyhaul.sensors.suite import motion_of
from skyhaul.sensors.truth_track import TruthTrack
from skyhaul.types import GRAVITY_MPS2, Array
from skyhaul.world.load import load_config

RESULT = Path(__file__).parent / "results" / "imu.json"
STEP_S, WINDOW = 0.002, 7_500
G_W = np.array([0.0, 0.0, GRAVITY_MPS2])
NAMES = ["payload", "vehicle 0", "vehicle 1", "vehicle 2", "vehicle 3"]


class Nothing:
    """A recorder that takes nothing down."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return lambda *_: None

    def tick(self, tick: Tick) -> None:
        """Ignored."""

    def close(self, outcome: Outcome) -> None:
        """Ignored."""


@numba.njit
def strapdown(
    q: Array, p: Array, v: Array, gyro: Array, accel: Array, step_s: float, trapezoid: bool
) -> Array:
    """Places (m + 1, 3) from rates and specific forces; held, or trapezoidal between samples."""
    out = np.empty((gyro.shape[0] + 1, 3))
    qa, pa, va = (q[0], q[1], q[2], q[3]), p.copy(), v.copy()
    out[0] = pa
    for k in range(gyro.shape[0]):
        w, f = gyro[k].copy(), accel[k]
        if trapezoid and k + 1 < gyro.shape[0]:
            w = 0.5 * (w + gyro[k + 1])
        turned = quat_mul(qa, quat_exp(w * step_s))
        if trapezoid:
            first = quat_rotate(qa, f)
            last = quat_rotate(turned, accel[min(k + 1, gyro.shape[0] - 1)])
            a = ((first[0] + last[0]) / 2, (first[1] + last[1]) / 2, (first[2] + last[2]) / 2)
        else:
            a = quat_rotate(quat_mul(qa, quat_exp(0.5 * w * step_s)), f)
        for c in range(3):
            ac = a[c] - (GRAVITY_MPS2 if c == 2 else 0.0)
            pa[c] += step_s * va[c] + 0.5 * step_s * step_s * ac
            va[c] += step_s * ac
        qa = turned
        out[k + 1] = pa
    return out


def flown_track() -> TruthTrack:
    """The truth of `paper`, seed 0."""
    recorder = TrackRecorder(Nothing())
    fly(load_config(RunConfig, "paper"), 0, recorder)
    return recorder.track()


def samples(track: TruthTrack, imus: list[Imu]) -> list[tuple[Array, Array]]:
    """Exact samples, gyro and accelerometer (k, 3), of IMUs on the load and the vehicles."""
    bank = imu_bank([without_errors(imu) for imu in imus], range(len(imus)))
    memory, got = bank.init(0), [([], []) for _ in imus]
    for truth in track.truths():
        memory, readings = bank.step(memory, truth.stamp_us, motion_of(truth))
        for (gyro, accel), reading in zip(got, readings, strict=True):
            gyro.extend(reading.gyro_I)
            accel.extend(reading.accel_I)
    return [(np.array(gyro), np.array(accel)) for gyro, accel in got]


def drifts(track: TruthTrack) -> dict[str, dict[str, float]]:
    """Largest distance from the true way at the end of a window [mm], by body and by sampling."""
    imus = [SensorsConfig().payload_imu] + [Imu()] * 4
    exact = samples(track, imus)
    out: dict[str, dict[str, float]] = {}
    for b, name in enumerate(NAMES):
        q = track.q_WL if b == 0 else track.q_WB[:, b - 1]
        p = track.p_WL if b == 0 else track.p_WB[:, b - 1]
        v = track.v_WL if b == 0 else track.v_WB[:, b - 1]
        w = track.w_WL_L if b == 0 else track.w_WB_B[:, b - 1]
        R, arm = quat_to_R(q), np.array(imus[b].p_BI_m)
        at_arm, arm_v = p + R @ arm, v + np.einsum("kij,kj->ki", R, np.cross(w, arm))
        force = np.einsum("kji,kj->ki", R, track.accel_W[:, b] + G_W)
        (gyro, accel), every = exact[b], round(1.0 / (STEP_S * imus[b].rate_hz))
        worst = {"mean over the period": 0.0, "instants, held": 0.0, "instants, trapezoid": 0.0}
        for i in range(0, len(track) - WINDOW - 1, 1250):
            rows, end = slice(i, i + WINDOW), i + WINDOW
            means = slice(i // every, end // every)
            start, held = (q[i], p[i], v[i]), (w[rows].copy(), force[rows], STEP_S)
            ways = {
                "mean over the period": strapdown(
                    q[i], at_arm[i], arm_v[i], gyro[means], accel[means], every * STEP_S, False
                )[-1] - at_arm[end],
                "instants, held": strapdown(*start, *held, False)[-1] - p[end],
                "instants, trapezoid": strapdown(*start, *held, True)[-1] - p[end],
            }  # fmt: skip
            for how, gap in ways.items():
                worst[how] = max(worst[how], 1e3 * float(np.linalg.norm(gap)))
        out[name] = worst
    return out


def day_at_rest(hours: float) -> list[dict[str, float]]:
    """Noise density and random walk found in a record at rest, against those put in, by axis."""
    imu = Imu()
    bank = imu_bank([imu], [1])
    memory = bank.init(0)
    state, rng, means = memory.state[0].copy(), np.random.default_rng(24), []
    rest, chunk = np.array([0.0, 0.0, 0.0, 0.0, 0.0, GRAVITY_MPS2]), np.empty((180_000, 6))
    for _ in range(round(hours * 10)):
        noise = rng.standard_normal((len(chunk), 12))
        imu_still(bank.arrays, memory.errors, rest, noise, state, chunk)
        means.append(chunk.reshape(-1, 50, 6).mean(axis=1))
    record, out = np.concatenate(means), []
    for axis in range(6):
        fit = fit_noise(record[:, axis], 0.1)
        white = imu.gyro_noise_radps_per_sqrt_hz if axis < 3 else imu.accel_noise_mps2_per_sqrt_hz
        walk = imu.gyro_walk_radps2_per_sqrt_hz if axis < 3 else imu.accel_walk_mps3_per_sqrt_hz
        out.append({"white_ratio": fit.white / white, "walk_ratio": fit.walk / walk})
    return out


def cost_us(track: TruthTrack) -> float:
    """CPU time of a step of five IMUs, readings made, best of five runs [us]."""
    bank = imu_bank([SensorsConfig().payload_imu] + [Imu()] * 4, range(5))
    truths = [(t.stamp_us, motion_of(t)) for t in (track.truth(k) for k in range(3000))]
    best = np.inf
    for _ in range(5):
        memory, begin = bank.init(0), time.process_time()
        for t_us, motion in truths:
            memory, _ = bank.step(memory, t_us, motion)
        best = min(best, time.process_time() - begin)
    return 1e6 * best / len(truths)


def main() -> None:
    """Measure, print and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two hours at rest; writes nothing")
    quick = parser.parse_args().quick
    track = flown_track()
    drift = drifts(track)
    day = day_at_rest(2.0 if quick else 24.0)
    before, cost = calibration_s(), cost_us(track)
    loop_s = min(before, calibration_s())
    worst = {how: max(d[how] for d in drift.values()) for how in drift["payload"]}
    drift_mm = worst["mean over the period"]
    white = max(abs(a["white_ratio"] - 1.0) for a in day)
    walk = max(abs(a["walk_ratio"] - 1.0) for a in day)
    rows = [
        (
            "IMU without noise: dead reckoning over 15 s, worst body and window",
            drift_mm,
            "mm",
            "<= 10",
        ),
        ("the same from samples at instants, held", worst["instants, held"], "mm", ""),
        ("the same, trapezoidal", worst["instants, trapezoid"], "mm", ""),
        ("noise density, 24 h at rest, worst axis off by", 100.0 * white, "%", "<= 15"),
        ("random walk, 24 h at rest, worst axis off by", 100.0 * walk, "%", "<= 15"),
        ("five IMUs, one step", cost, "us", ""),
        ("the same where the calibration loop takes 0.12 s", cost * 0.12 / loop_s, "us", "<= 20"),
    ]
    for measure, value, unit, bar in rows:
        print(f"{measure}: {value:.4g} {unit}  [{bar}]")
    print(f"calibration loop: {loop_s:.3f} s")
    if quick:
        return
    result = {
        "claim": __doc__,
        "rows": [
            {"measure": m, "value": v, "unit": u, "bar": b}
            for m, v, u, b in rows
        ],
        "drift_mm": drift,
        "at_rest": day,
        "calibration_5e6_python_iterations_s": loop_s,
        "load_average": os.getloadavg()[0],
        "machine": platform.platform(),
        "python": sys.version.split()[0],
        "commit": commit(),
    }  # fmt: skip
    RESULT.write_text(json.dumps(result, indent=2) + "\n", "utf-8")
    print(f"-> {RESULT}")


if __name__ == "__main__":
    main()
