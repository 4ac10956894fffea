# SPDX-License-Identifier: Apache-2.0
"""From a run folder to `metrics.json`. A key that does not apply is null."""

from pathlib import Path

import numpy as np

from skyhaul.evaluation.energy import EnergyModel, compute_energy_j
from skyhaul.evaluation.events import Events
from skyhaul.evaluation.folder import METRICS, write_json
from skyhaul.evaluation.judge import fault_of, goal_distance_m, limits
from skyhaul.evaluation.series import Run, load_run
from skyhaul.evaluation.shortest import shortest_clear_path_m
from skyhaul.geometry.quaternion import quat_conj, quat_log, quat_mul
from skyhaul.types import Array
from skyhaul.world.scenario import GoTo

Value = float | int | bool | str | None
Metrics = dict[str, Value]

NOT_YET = (
    *("reaction_mover_ms_p50", "reaction_mover_ms_p99"),
    *("reaction_static_ms_p50", "reaction_static_ms_p99"),
    *("vio_ate_m", "vio_ate_percent", "map_precision", "map_recall"),
    *("detection_recall", "detection_latency_ms", "track_rmse_m"),
    *("events_total", "gnn_events_per_s", "gnn_skipped_fraction"),
)
"""Keys of stages that a run on true perception does not have."""


def evaluate(run: Run | Path | str, energy: EnergyModel | None = None) -> Metrics:
    """Compute the metrics of a run, or of that in a folder; write its `metrics.json`.

    Raises:
        FileError: when the folder holds no run.
    """
    run = run if isinstance(run, Run) else load_run(run)
    metrics = run_metrics(run, energy or EnergyModel())
    write_json(run.folder / METRICS, metrics)
    return metrics


def run_metrics(run: Run, energy: EnergyModel) -> Metrics:
    """The metrics of a run, in the order of the table."""
    flight = _mission(run) | _safety(run) | _tracking(run)
    fault = fault_of(run, flight)
    costs = _solver(run) | _planning(run.events) | _costs(run, energy)
    head: Metrics = {"scenario": run.scenario.name, "seed": run.origin.seed}
    head |= {"mission_success": fault is None, "outcome": fault or _reason(run.events)}
    return head | flight | costs | dict.fromkeys(NOT_YET) | limits(run.scenario)


def _reason(events: Events) -> str:
    return events.outcome.reason if events.outcome else ""


def _mission(run: Run) -> Metrics:
    path_m, distance_m = _path_m(run), goal_distance_m(run)
    task = run.scenario.task
    arrived = isinstance(task, GoTo) and distance_m is not None and distance_m <= task.within_m
    shortest_m = shortest_clear_path_m(run) if arrived else None
    return {
        "mission_time_s": float(run.t_s[-1]) if len(run.t_s) else None,
        "distance_to_goal_m": distance_m,
        "payload_path_m": path_m,
        "path_ratio": path_m / shortest_m if path_m is not None and shortest_m else None,
    }


def _path_m(run: Run) -> float | None:
    """Way of the load after lift-off [m]."""
    p = run.series["load"][run.airborne, 0:3]
    return float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum()) if len(p) else None


def _safety(run: Run) -> Metrics:
    s, air = run.series, run.airborne
    hits = [c for c in run.events.contacts if c.airborne]
    thrust_limit = run.scenario.team.arrays().thrust_max
    slack = s["slack"][-1] if len(s["slack"]) else np.nan
    return {
        "collisions": len(hits),
        "collisions_lost_vehicle": sum(c.lost for c in hits),
        "min_clearance_m": _least(s["clearance_min"]),
        "min_quad_distance_m": _least(s["vehicle_distance_min"][air]),
        "min_tension_n": _least(s["cable_tension_min"][air]),
        "max_tension_n": _most(s["cable_tension_max"][air]),
        "slack_time_s": _number(slack) if air.any() else None,
        "max_thrust_ratio": _most(s["vehicle_thrust_max"][air] / thrust_limit),
    }


def _tracking(run: Run) -> Metrics:
    """Errors against the reference clock, no time-warping, after lift-off."""
    error = position_error(run)
    return {
        "payload_swing_rms_deg": _rms(np.degrees(swing(run))),
        "tracking_rmse_m": _rms(error),
        "tracking_max_m": _most(error),
        "attitude_rmse_deg": _rms(np.degrees(attitude_error(run))),
    }


def position_error(run: Run) -> Array:
    """Distance of the load to its reference, (k,) [m]; nan before lift-off."""
    error = np.linalg.norm(run.series["load"][:, 0:3] - run.series["ref"][:, 0:3], axis=1)
    return np.where(run.airborne, error, np.nan)


def attitude_error(run: Run) -> Array:
    """Angle of the load's attitude to its reference, (k,) [rad]; nan before lift-off."""
    out = np.full(len(run.t_s), np.nan)
    ok = run.airborne & np.isfinite(run.series["ref"]).all(axis=1)
    q, q_d = run.series["load"][ok, 3:7], run.series["ref"][ok, 3:7]
    out[ok] = np.linalg.norm(quat_log(quat_mul(quat_conj(q_d), q)), axis=-1)
    return out


def swing(run: Run) -> Array:
    """Angle of each carrying cable to its flat reference, (k, n) [rad]; nan where there is none."""
    a, b = run.series["cable_dir"], run.series["cable_dir_flat"]
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=2), np.sum(a * b, axis=2))
    return np.where(run.carrying & run.airborne[:, None], angle, np.nan)


def _solver(run: Run) -> Metrics:
    solves = run.events.solves
    wall = [x.wall_ms for x in solves]
    flown_s = 0.01 * int(run.airborne.sum())
    return {
        "nmpc_solves": len(solves),
        "nmpc_solves_per_s": len(solves) / flown_s if flown_s else None,
        "nmpc_solve_ms_p50": _percentile(wall, 50),
        "nmpc_solve_ms_p99": _percentile(wall, 99),
        "nmpc_failures": sum(x.status == "failed" for x in solves),
        "nmpc_slack_max_m": max((x.slack_m for x in solves), default=None),
    }


def _planning(events: Events) -> Metrics:
    wall = [r.wall_ms for r in events.replans]
    causes = sorted({t.cause for t in events.triggers})
    counts = {f"triggers_{c}": sum(t.cause == c for t in events.triggers) for c in causes}
    return {
        "replans": len(events.replans),
        "plan_ms_p50": _percentile(wall, 50),
        "plan_ms_p99": _percentile(wall, 99),
        **counts,
    }


def _costs(run: Run, model: EnergyModel) -> Metrics:
    events, end = run.events, run.events.outcome
    rotor = _number(run.series["rotor_energy"][-1]) if len(run.t_s) else None
    compute = compute_energy_j(model, end.cpu_s) if end and end.cpu_s else None
    radio = model.radio_j_per_byte * events.bytes_sent
    cpu_s = end.cpu_s if end else {}
    stages: Metrics = {f"compute_cpu_s_{k}": _number(v) for k, v in cpu_s.items()}
    total = None if rotor is None or compute is None else rotor + compute + radio
    return {
        "messages": events.messages,
        "bytes_sent": events.bytes_sent,
        "rotor_energy_j": rotor,
        "compute_energy_j": compute,
        "radio_energy_j": radio,
        "total_energy_j": total,
        **stages,
        "real_time_factor": end.t_s / end.wall_s if end and end.wall_s > 0.0 else None,
    }


def _finite(values: Array) -> Array:
    flat = np.ravel(values)
    return flat[np.isfinite(flat)]


def _least(values: Array) -> float | None:
    flat = _finite(values)
    return float(flat.min()) if len(flat) else None


def _most(values: Array) -> float | None:
    flat = _finite(values)
    return float(flat.max()) if len(flat) else None


def _rms(values: Array) -> float | None:
    flat = _finite(values)
    return float(np.sqrt(np.mean(flat**2))) if len(flat) else None


def _percentile(values: list[float], q: float) -> float | None:
    return float(np.percentile(values, q)) if values else None


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
