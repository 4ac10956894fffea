# SPDX-License-Identifier: Apache-2.0
"""The data behind `report.html`: small enough to inline, with no extreme lost."""

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyhaul.evaluation.messages import LOAD_COLOR, MOVER_COLOR, STATIC_COLOR, VEHICLE_COLORS
from skyhaul.evaluation.metrics import Metrics, attitude_error, position_error, swing
from skyhaul.evaluation.series import Run
from skyhaul.evaluation.table import table_lines
from skyhaul.geometry.shapes import Shape, shape_size
from skyhaul.jit import njit
from skyhaul.types import Array, IntArray
from skyhaul.world.scenario import GoTo

FRAME_S = 0.04
"""Time between two frames of the 3-D view; the viewer interpolates [s]."""
CHART_BUCKETS = 1200
"""A chart shows the least and the largest value of each bucket of time."""
PATH_POINTS = 150
"""Most points of one planned path."""

Data = dict[str, Any]


def report_data(run: Run, metrics: Metrics) -> Data:
    """Everything the report shows."""
    return {
        "scenario": run.scenario.name,
        "description": run.scenario.description,
        "done": metrics["mission_success"],
        "outcome": metrics["outcome"],
        "origin": vars(run.origin),
        "tiles": _tiles(metrics),
        "table": [
            {"title": title, "lines": [vars(line) for line in lines]}
            for title, lines in table_lines(metrics)
        ],
        "colors": {
            "vehicles": [_hex(c) for c in VEHICLE_COLORS[: run.layout.n]],
            "load": _hex(LOAD_COLOR),
            "still": _hex(STATIC_COLOR),
            "mover": _hex(MOVER_COLOR),
        },
        "scene": _scene(run),
        "frames": _frames(run),
        "charts": _charts(run),
        "chart_t": _pack(_bucket_times(run.t_s)),
        "phases": [{"name": a, "t0": b, "t1": c} for a, b, c in run.phase_spans],
        "events": _events(run),
        "end_s": float(run.t_s[-1]) if len(run.t_s) else 0.0,
    }


def _tiles(metrics: Metrics) -> list[Data]:
    """The figures on top of the page."""
    wanted = (
        ("mission_time_s", "mission time", "s", ".1f", 1.0),
        ("min_clearance_m", "least clearance", "cm", ".1f", 100.0),
        ("tracking_rmse_m", "tracking error, RMS", "cm", ".2f", 100.0),
        ("min_tension_n", "least tension", "N", ".2f", 1.0),
        ("collisions", "contacts", "", ".0f", 1.0),
        ("replans", "replans", "", ".0f", 1.0),
        ("nmpc_solves_per_s", "solves per second", "", ".1f", 1.0),
        ("real_time_factor", "times real time", "", ".1f", 1.0),
    )
    lines = []
    for key, label, unit, form, scale in wanted:
        value = metrics.get(key)
        text = "-" if value is None else format(float(value) * scale, form)
        lines.append({"label": label, "value": text, "unit": unit if value is not None else ""})
    return lines


def _scene(run: Run) -> Data:
    """What does not change during the flight."""
    s, moving = run.scenario, set(run.layout.movers)
    team, task, obstacles = s.team, s.task, s.world.obstacles
    payload: Data = {"kind": team.payload.kind}
    if team.payload.kind == "rigid":
        payload["size"] = list(team.payload.size_m)
    else:
        payload["size"] = [2.0 * team.payload.radius_m] * 3
    return {
        "room": [list(s.world.room.min_m), list(s.world.room.max_m)],
        "goal": list(task.goal_m) if isinstance(task, GoTo) else None,
        "goal_radius": task.within_m if isinstance(task, GoTo) else 0.0,
        "payload": payload,
        "vehicle": {
            "arm": team.vehicle.arm_m,
            "rotor": team.vehicle.rotor_radius_m,
            "half_height": team.vehicle.half_height_m,
        },
        "hooks": team.hooks_L().tolist(),
        "still": [
            _solid(o.name, o.shape) | {"p": list(o.center_m)}
            for j, o in enumerate(obstacles)
            if j not in moving
        ],
        "movers": [_solid(obstacles[j].name, obstacles[j].shape) for j in run.layout.movers],
    }


def _solid(name: str, shape: Shape) -> Data:
    _, size, R = shape_size(shape)
    return {"name": name, "kind": shape.kind, "size": size.tolist(), "R": np.ravel(R).tolist()}


def _frames(run: Run) -> Data:
    """Poses at the frame rate, as packed arrays."""
    s = run.series
    step = max(1, round(FRAME_S / 0.01))
    rows = np.unique(np.append(np.arange(0, len(run.t_s), step), max(0, len(run.t_s) - 1)))
    rows = rows[: len(run.t_s)]
    vehicles = np.concatenate([s["vehicle_p"], s["vehicle_q"]], axis=2)
    return {
        "count": len(rows),
        "t": _pack(run.t_s[rows]),
        "load": _pack(s["load"][rows, 0:7]),
        "speed": _pack(np.linalg.norm(s["load"][rows, 7:10], axis=1)),
        "vehicles": _pack(vehicles[rows]),
        "tension": _pack(s["cable_tension"][rows]),
        "thrust": _pack(s["vehicle_rotor"][rows].sum(axis=2)),
        "clearance": _pack(s["clearance_min"][rows]),
        "attached": _pack(s["cable_attached"][rows], np.uint8),
        "movers": _pack(s["obstacle_p"][rows]),
        "present": _pack(s["obstacle_present"][rows], np.uint8),
    }


def _events(run: Run) -> Data:
    e = run.events
    return {
        "triggers": [vars(x) for x in e.triggers],
        "contacts": [vars(x) for x in e.contacts if x.airborne],
        "replans": [
            {"t_s": r.t_s, "cause": r.cause, "status": r.status, "accepted": r.accepted}
            for r in e.replans
        ],
        "references": [
            {"t_s": r.t_s, "points": _pack(_thinned(r.p_WD)), "count": len(_thinned(r.p_WD))}
            for r in e.references
        ],
    }


def _thinned(points: Array) -> Array:
    """At most `PATH_POINTS` of them, first and last included."""
    if len(points) <= PATH_POINTS:
        return points
    return points[np.linspace(0, len(points) - 1, PATH_POINTS).round().astype(np.int64)]


def _charts(run: Run) -> list[Data]:
    """Charts over time; a line is (name, colour, values), a bound a level."""
    s, team = run.series, run.scenario.team
    n = run.layout.n
    load, ref = s["load"], s["ref"]
    bound = float(team.arrays().thrust_max.max())
    tilt = np.degrees(np.arccos(np.clip(-s["cable_dir"][:, :, 2], -1.0, 1.0)))
    carrying = run.carrying
    speed = np.linalg.norm(load[:, 7:10], axis=1)
    wanted = np.linalg.norm(ref[:, 7:10], axis=1)
    charts = [
        _chart("Tracking error", "cm", [_line(run, "position", 0, 100.0 * position_error(run))]),
        _chart("Speed of the payload", "m/s", [
            _line(run, "flown", 0, speed), _line(run, "reference", -1, wanted, dash=True)],
            [(run.scenario.limits.v_max_mps, "limit")]),
        _chart("Clearance to obstacles", "m", [_line(run, "least", 0, s["clearance_min"])],
            [(0.0, "touch")]),
        _chart("Cable tension", "N", [
            _band(run, i, np.where(carrying[:, i], s["cable_tension_min"][:, i], np.nan),
                  np.where(carrying[:, i], s["cable_tension_max"][:, i], np.nan))
            for i in range(n)], [(team.tension_min_n, "least commanded")]),
        _chart("Thrust", "N", [
            _line(run, f"vehicle {i}", i + 1, s["vehicle_rotor"][:, i].sum(axis=1))
            for i in range(n)], [(bound, "limit")]),
        _chart("Cables from the vertical", "deg", [
            _line(run, f"cable {i}", i + 1, np.where(carrying[:, i], tilt[:, i], np.nan))
            for i in range(n)], [(float(np.degrees(team.cable_angle_rad)), "formation")]),
        _chart("Cables off their flat reference", "deg", [
            _line(run, f"cable {i}", i + 1, np.degrees(swing(run)[:, i])) for i in range(n)]),
        _chart("Attitude error of the payload", "deg", [
            _line(run, "angle", 0, np.degrees(attitude_error(run)))]),
    ]  # fmt: skip
    solves = run.events.solves
    if solves:
        charts.append(_calls("Solve time", solves))
    if run.events.replans:
        charts.append(_calls("Planning time", run.events.replans))
    return charts


def _chart(
    title: str, unit: str, lines: list[Data], bounds: list[tuple[float, str]] | None = None
) -> Data:
    levels = [{"y": y, "name": name} for y, name in bounds or []]
    return {"title": title, "unit": unit, "lines": lines, "bounds": levels}


def _line(run: Run, name: str, color: int, values: Array, dash: bool = False) -> Data:
    """A line; colour 0 is the payload's, i + 1 that of vehicle i, -1 neutral."""
    y = _pack(_envelope(run.t_s, values, values))
    return {"name": name, "color": color, "dash": dash, "y": y}


def _band(run: Run, i: int, low: Array, high: Array) -> Data:
    y = _pack(_envelope(run.t_s, low, high))
    return {"name": f"cable {i}", "color": i + 1, "dash": False, "y": y}


def _calls(title: str, calls: list[Any]) -> Data:
    """One point per call, cause and status as hover text; logarithmic when some stand out."""
    wall_ms = [max(c.wall_ms, 1e-3) for c in calls]
    dots = {
        "name": title,
        "color": 0,
        "x": [round(c.t_s, 4) for c in calls],
        "points": [round(w, 3) for w in wall_ms],
        "text": [f"{c.cause.replace('_', ' ')}: {c.status}" for c in calls],
    }
    spread = max(wall_ms) > 20.0 * float(np.median(wall_ms))
    return _chart(title, "ms", [dots]) | {"log": spread}


def _edges(t_s: Array) -> NDArray[np.int64]:
    """First rows of the buckets."""
    count = min(CHART_BUCKETS, len(t_s))
    return np.linspace(0, len(t_s), count, endpoint=False).astype(np.int64)


def _bucket_times(t_s: Array) -> Array:
    """Two times for each bucket: its begin and its middle."""
    edges = _edges(t_s)
    if not len(edges):
        return np.zeros(0)
    ends = np.append(edges[1:], len(t_s)) - 1
    begin = t_s[edges]
    return np.column_stack([begin, 0.5 * (begin + t_s[ends])]).ravel()


def _envelope(t_s: Array, low: Array, high: Array) -> Array:
    """Least and largest value of each bucket, in the order in which they occur."""
    edges = _edges(t_s)
    if not len(edges):
        return np.zeros(0)
    out = np.empty((len(edges), 2))
    _fill_envelope(edges, np.array(low, float), np.array(high, float), out)
    return out.ravel()


@njit
def _fill_envelope(edges: IntArray, low: Array, high: Array, out: Array) -> None:
    """Kernel of `_envelope`: nan where a bucket, `edges[k]` to `edges[k + 1]`, has no number."""
    for k in range(len(edges)):
        end = edges[k + 1] if k + 1 < len(edges) else len(low)
        i = j = -1
        for r in range(edges[k], end):
            if not np.isnan(low[r]) and (i < 0 or low[r] < low[i]):
                i = r
            if not np.isnan(high[r]) and (j < 0 or high[r] > high[j]):
                j = r
        out[k, 0] = out[k, 1] = np.nan
        if i >= 0 and j >= 0:
            out[k, 0], out[k, 1] = (low[i], high[j]) if i <= j else (high[j], low[i])


def _pack(values: NDArray[Any], dtype: type = np.float32) -> str:
    """Values as base64 of a little-endian array."""
    data = np.ascontiguousarray(values, dtype=np.dtype(dtype).newbyteorder("<"))
    return base64.b64encode(data.tobytes()).decode("ascii")


def _hex(color: tuple[float, float, float]) -> str:
    return "#" + "".join(f"{round(255 * c):02x}" for c in color)
