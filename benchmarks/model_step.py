# SPDX-License-Identifier: Apache-2.0
"""Claim: `model.step` is exact to 1e-8 over 10 ms, held inputs, and takes less than 100 us.

The reference is SciPy's DOP853 at a relative tolerance of 1e-13 on the same equations, which
`tests/model/test_dynamics.py` ties to a model in maximal coordinates. Random states with load
rates of 3 rad/s, cable rates of 2 rad/s and body rates of 6 rad/s; random thrusts and moments.
"""

import time
from collections.abc import Callable

import numpy as np
from provenance import provenance, write_report
from scipy.integrate import solve_ivp

from skyhaul.geometry.quaternion import quat_normalize
from skyhaul.model import PointPayload, RigidPayload, TautState, Team, flat_outputs, step
from skyhaul.model.dynamics import pack, taut_derivative, taut_work
from skyhaul.types import Array

DT_S = 0.01
SEEDS = range(10)
TRIALS = 20  # per seed


def random_case(rng: np.random.Generator, team: Team) -> tuple[TautState, Array]:
    """State and wrenches at the largest rates of the claim."""
    n, rigid = team.count, team.payload.kind == "rigid"
    cable_dir = unit(np.array([0.0, 0.0, -1.0]) + 0.5 * rng.normal(size=(n, 3)))
    state = TautState(
        p_WL=rng.uniform(-10.0, 10.0, 3),
        q_WL=quat_normalize(rng.normal(size=4)) if rigid else np.array([1.0, 0.0, 0.0, 0.0]),
        v_WL=rng.uniform(-2.0, 2.0, 3),
        w_WL_L=3.0 * unit(rng.normal(size=3)) if rigid else np.zeros(3),
        cable_dir_W=cable_dir,
        cable_w_W=2.0 * unit(np.cross(cable_dir, rng.normal(size=(n, 3)))),
        q_WB=quat_normalize(rng.normal(size=(n, 4))),
        w_WB_B=6.0 * unit(rng.normal(size=(n, 3))),
    )
    moments = rng.uniform(-1.0, 1.0, (n, 3)) * [0.15, 0.15, 0.03]
    return state, np.column_stack([rng.uniform(0.2, 4.24, n), moments])


def unit(v: Array) -> Array:
    """Vectors of the same directions, unit length."""
    scaled: Array = v / np.linalg.norm(v, axis=-1, keepdims=True)
    return scaled


def reference(team: Team, state: TautState, wrenches: Array) -> Array:
    """Packed state after `DT_S` by DOP853."""
    arrays, work = team.arrays(), taut_work(team.count)

    def rate(_: float, x: Array) -> Array:
        dx = np.empty_like(x)
        taut_derivative(arrays, x, wrenches, work, dx)
        return dx

    span = (0.0, DT_S)
    result = solve_ivp(rate, span, pack(state), method="DOP853", rtol=1e-13, atol=1e-14)
    return np.asarray(result.y[:, -1])


def micros(call: Callable[[], object], repeats: int) -> float:
    """Median time of a call [us]."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e6 * float(np.median(times))


def measure(team: Team) -> dict[str, float]:
    """Errors over all seeds and median times of one team."""
    worst = []
    for seed in SEEDS:
        rng, errors = np.random.default_rng(seed), []
        for _ in range(TRIALS):
            state, wrenches = random_case(rng, team)
            got = pack(step(team, state, wrenches, DT_S))
            errors.append(np.max(np.abs(got - reference(team, state, wrenches))))
        worst.append(max(errors))
    state, wrenches = random_case(np.random.default_rng(0), team)
    return {
        "max_error": float(np.max(worst)),
        "median_over_seeds_of_max_error": float(np.median(worst)),
        "step_10ms_us": micros(lambda: step(team, state, wrenches, DT_S), 1000),
        "step_2ms_us": micros(lambda: step(team, state, wrenches, 0.002), 1000),
        "dop853_10ms_us": micros(lambda: reference(team, state, wrenches), 20),
    }


def flatness_us() -> float:
    """Time of `flat_outputs` at 60 times, four vehicles [us]."""
    rng, team, k = np.random.default_rng(0), Team(), 60
    R = np.zeros((k, 7, 3, 3))
    R[:, 0] = np.eye(3)
    p = 0.3 * rng.normal(size=(k, 7, 3))
    flat_outputs(team, p, R, np.zeros((4, 3)))
    return micros(lambda: flat_outputs(team, p, R, np.zeros((4, 3))), 200)


def main() -> None:
    """Measure all teams and write the result."""
    cases = {}
    for n in (1, 2, 3, 4, 8):
        for payload in (PointPayload(), RigidPayload()):
            cases[f"{n}_{payload.kind}"] = case = measure(Team(count=n, payload=payload))
            print(f"{n} {payload.kind:5s}", {k: f"{v:.3g}" for k, v in case.items()})
    claimed = [c for name, c in cases.items() if name[0] in "234"]
    worst = max(c["max_error"] for c in claimed)
    slowest = max(c["step_10ms_us"] for c in claimed)
    flat = flatness_us()
    rows = [
        ("`model.step`, 10 ms, N = 2, 3, 4: largest error of any entry", worst, "", "<= 1e-8"),
        ("the same: slowest median time", slowest, "us", "<= 100"),
        ("flatness at 60 times, N = 4", 1e-3 * flat, "ms", "<= 5"),
    ]
    report = {
        "claim": "model.step over 10 ms with held inputs: error <= 1e-8, time <= 100 us",
        "rows": [dict(zip(("measure", "value", "unit", "bar"), r, strict=True)) for r in rows],
        "dt_s": DT_S,
        "seeds": list(SEEDS),
        "trials_per_seed": TRIALS,
        "cases": cases,
        "flat_outputs_60_times_us": flat,
        **provenance(),
    }
    write_report("model_step", report)


if __name__ == "__main__":
    main()
