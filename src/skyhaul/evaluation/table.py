# SPDX-License-Identifier: Apache-2.0
"""The result table of a run."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

Check = Callable[[Any, Mapping[str, Any]], bool]


@dataclass(frozen=True)
class Row:
    """One line: a metric, what it is called, its unit, its format and what it must satisfy."""

    key: str
    label: str
    unit: str = ""
    form: str = ".3g"
    check: Check | None = None
    """None: informs, judges nothing."""
    rule: str = ""
    """The check in words; `{limit}` stands for the run's own limit."""


def _below(limit: str) -> Check:
    return lambda value, m: m.get(limit) is None or value <= m[limit]


def _above(limit: str) -> Check:
    return lambda value, m: m.get(limit) is None or value >= m[limit]


def _zero(value: float, m: Mapping[str, Any]) -> bool:
    return value == 0


def _positive(value: float, m: Mapping[str, Any]) -> bool:
    return value > 0.0


def _hits(value: int, m: Mapping[str, Any]) -> bool:
    return value <= (m.get("collisions_lost_vehicle") or 0)


GROUPS: tuple[tuple[str, tuple[Row, ...]], ...] = (
    (
        "Mission",
        (
            Row("mission_time_s", "time", "s", ".2f", _below("limit_mission_time_s"), "<= {limit}"),
            Row("distance_to_goal_m", "distance to the goal", "m", ".3f",
                _below("limit_distance_to_goal_m"), "<= {limit}"),
            Row("payload_path_m", "path of the payload", "m", ".2f"),
            Row("path_ratio", "path, flown / shortest clear", "", ".3f"),
        ),
    ),
    (
        "Safety",
        (
            Row("collisions", "contacts after lift-off", "", "d", _hits,
                "= 0 (lost one aside)"),
            Row("collisions_lost_vehicle", "... of a lost vehicle with the floor", "", "d"),
            Row("min_clearance_m", "least clearance", "m", ".3f", _positive, "> 0"),
            Row("min_quad_distance_m", "least distance of two vehicles, centres", "m", ".3f",
                _above("limit_min_quad_distance_m"), ">= {limit}"),
            Row("min_tension_n", "least tension", "N", ".3f", _positive, "> 0"),
            Row("max_tension_n", "largest tension", "N", ".2f"),
            Row("slack_time_s", "time with a slack cable", "s", ".3f", _zero, "= 0"),
            Row("max_thrust_ratio", "largest thrust / limit", "", ".3f", lambda v, m: v <= 1.0,
                "<= 1"),
        ),
    ),
    (
        "Tracking",
        (
            Row("tracking_rmse_m", "position error, RMS", "m", ".4f"),
            Row("tracking_max_m", "position error, largest", "m", ".4f",
                _below("limit_tracking_max_m"), "<= {limit}"),
            Row("attitude_rmse_deg", "attitude error, RMS", "deg", ".2f"),
            Row("payload_swing_rms_deg", "cables off their flat reference, RMS", "deg", ".2f"),
        ),
    ),
    (
        "Planning and control",
        (
            Row("replans", "calls of the planner", "", "d"),
            Row("plan_ms_p50", "... median", "ms", ".1f"),
            Row("plan_ms_p99", "... 99th percentile", "ms", ".1f"),
            Row("nmpc_solves", "solves", "", "d"),
            Row("nmpc_solves_per_s", "... per second of flight", "1/s", ".2f"),
            Row("nmpc_solve_ms_p50", "... median", "ms", ".2f"),
            Row("nmpc_solve_ms_p99", "... 99th percentile", "ms", ".2f"),
            Row("nmpc_failures", "... that failed", "", "d", _zero, "= 0"),
            Row("nmpc_slack_max_m", "... deepest cut into a clearance", "m", ".3f"),
        ),
    ),
    (
        "Reaction",
        (
            Row("reaction_mover_ms_p50", "to a mover, median", "ms", ".0f"),
            Row("reaction_mover_ms_p99", "to a mover, 99th percentile", "ms", ".0f"),
            Row("reaction_static_ms_p50", "to a static obstacle, median", "ms", ".0f"),
            Row("reaction_static_ms_p99", "to a static obstacle, 99th percentile", "ms", ".0f"),
        ),
    ),
    (
        "Cost",
        (
            Row("rotor_energy_j", "rotors", "J", ".1f"),
            Row("compute_energy_j", "computing", "J", ".2f"),
            Row("radio_energy_j", "radio", "J", ".4f"),
            Row("messages", "messages", "", "d"),
            Row("bytes_sent", "bytes sent", "", "d"),
            Row("real_time_factor", "simulated / wall time", "", ".2f"),
        ),
    ),
    (
        "Perception",
        (
            Row("vio_ate_m", "odometry error", "m", ".3f"),
            Row("vio_ate_percent", "odometry error", "%", ".2f"),
            Row("map_precision", "map precision", "", ".3f"),
            Row("map_recall", "map recall", "", ".3f"),
            Row("detection_recall", "detection recall", "", ".3f"),
            Row("detection_latency_ms", "detection latency", "ms", ".0f"),
            Row("track_rmse_m", "track error, RMS", "m", ".3f"),
            Row("events_total", "events", "", "d"),
            Row("gnn_events_per_s", "events through the network", "1/s", ".3g"),
            Row("gnn_skipped_fraction", "events skipped", "", ".3f"),
        ),
    ),
)  # fmt: skip
"""Every metric that the table shows, in its order; families follow their group."""

_FAMILIES = {
    "Planning and control": ("triggers_", "trigger ", ""),
    "Cost": ("compute_cpu_s_", "CPU time, ", "s"),
}


@dataclass(frozen=True)
class Line:
    """One line as it is shown."""

    label: str
    value: str
    unit: str
    good: bool | None
    """None: nothing is asked of it."""
    rule: str


def table_lines(metrics: Mapping[str, Any]) -> list[tuple[str, list[Line]]]:
    """Groups of lines for the metrics that apply; a group without any is left out."""
    groups = []
    for title, rows in GROUPS:
        lines = [_line(row, metrics) for row in rows if metrics.get(row.key) is not None]
        lines += _family(title, metrics)
        if lines:
            groups.append((title, lines))
    return groups


def print_table(metrics: Mapping[str, Any], console: Console | None = None) -> None:
    """Print the metrics, grouped, with marks where the run has a criterion."""
    out = console or Console()
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_column(style="dim")
    table.add_column()
    for title, lines in table_lines(metrics):
        table.add_row(Text(title, style="bold"))
        for line in lines:
            table.add_row("  " + line.label, line.value, line.unit, _mark(line))
    out.print(_headline(metrics))
    out.print(table)


def _headline(metrics: Mapping[str, Any]) -> Text:
    done = bool(metrics.get("mission_success"))
    head = Text(f"{metrics.get('scenario', '')}, seed {metrics.get('seed', '')}: ")
    head.append("mission done" if done else "mission failed", "bold green" if done else "bold red")
    return head.append(f" ({metrics['outcome']})" if metrics.get("outcome") else "")


def _mark(line: Line) -> Text:
    if line.good is None:
        return Text("")
    mark, style = ("ok", "green") if line.good else ("BAD", "bold red")
    return Text(f"{mark}  ", style=style).append(line.rule, style="dim")


def _line(row: Row, metrics: Mapping[str, Any]) -> Line:
    value = metrics[row.key]
    good = None if row.check is None else row.check(value, metrics)
    limit = metrics.get(f"limit_{row.key}")
    if limit is None and "{limit}" in row.rule:
        good = None
    rule = row.rule.format(limit=f"{limit:g}" if limit is not None else "")
    return Line(row.label, format(value, row.form), row.unit, good, rule)


def _family(title: str, metrics: Mapping[str, Any]) -> list[Line]:
    if title not in _FAMILIES:
        return []
    prefix, label, unit = _FAMILIES[title]
    form = "d" if not unit else ".2f"
    return [
        Line(label + key[len(prefix) :].replace("_", " "), format(value, form), unit, None, "")
        for key, value in metrics.items()
        if key.startswith(prefix) and value is not None
    ]
