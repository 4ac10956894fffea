# SPDX-License-Identifier: Apache-2.0
"""Writes the tables of the README and of docs/results.md from benchmarks/results/*.json.

A result file is {"claim": one sentence, "rows": [{"measure", "value", "unit", "bar"}, ...],
"commit", "machine", "seeds", ...}; files without `rows` are left out. The README's part between
the two marks is replaced by the rows of `HEADLINES`, misses among them; docs/results.md holds all
rows, by file.
"""

import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"


HEADLINES = {
    "paper_seeds": (
        "`paper`, seeds 0-9: missions done",
        "`paper`, seeds 0-9: least clearance",
        "`paper`, seeds 0-9: payload RMSE, worst",
        "`paper`, seeds 0-9: time / without movers, wait at the goal aside, worst",
    ),
    "paper_held_out": (
        "`paper`, seeds never used before: missions done",
        "`paper`, seeds never used before: time / without movers, wait at the goal aside, worst",
    ),
    "paper_metres": ("`paper-metres`: missions done",),
    "circle_tracking": (
        "`circle`: payload RMSE over two laps",
        "`circle-fast`: payload RMSE over two laps",
    ),
    "lost_vehicle": ("`lost-vehicle`: ends at the goal, whichever vehicle dies",),
    "fleet_sizes": ("`paper`, N = 8",),
    "nmpc": ("NMPC, N = 4, six movers, no compiler: median",),
    "astar": ("A*, 100^3, 30 % clutter of boxes, median of 12",),
    "plant_oracle": ("plant vs `model.step`, 5 s driven: largest payload difference",),
    "images": (
        "camera range against mj_multiRay, median",
        "camera images of 320x240, scaled to a calibration loop of 0.12 s",
        "cameras of four vehicles, scaled likewise",
    ),
    "tag": ("tag on the load found, within 3 cm and 3 deg, of all down frames",),
    "event_camera": ("event camera against a DAVIS240: net count of each pixel",),
    "imu": ("IMU without noise: dead reckoning over 15 s, worst body and window",),
    "vio_tracks": ("EuRoC V1_01 clip, smoother, begun at rest: ATE (SE3, 581 pairs)",),
    "vio_flights": (
        "paper, ekf: ATE without alignment, worst vehicle",
        "paper, ekf: seconds with mean NEES in 3 .. 9",
        "paper, ekf: four vehicles together, median",
    ),
    "team_state_estimated": (
        "`paper`, odometry estimated: load position RMSE, worst flight",
        "`paper`, odometry estimated: cable direction RMS, worst flight",
    ),
    "loop_closure": (
        "there and back, 60 m: final error over that without loops, RMS over the flights",
    ),
    "run_speed": (
        "`skyhaul run paper --perception truth`, one core: simulated s / CPU s of the flight, "
        "median (range)",
    ),
}
"""What a stranger wants to know first: measures, by result file."""


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown table of rows."""
    lines = ["| Measure | Value | Bar |", "|---|---|---|"]
    for row in rows:
        value = f"{_number(row['value'])} {row.get('unit', '')}".strip()
        lines.append(f"| {row['measure']} | {value} | {row.get('bar', '')} |")
    return "\n".join(lines)


def headlines(results: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of the README; those of a file that has not been made are left out.

    Raises:
        KeyError: when a file is there and does not hold a measure.
    """
    rows = []
    for name, measures in HEADLINES.items():
        if name in results:
            by_measure = {row["measure"]: row for row in results[name]["rows"]}
            rows += [by_measure[measure] for measure in measures]
    return rows


def everything(results: dict[str, dict[str, Any]]) -> str:
    """docs/results.md: every file's claim, commit, remarks and rows."""
    parts = [
        "# Results\n\nAll rows of `benchmarks/results/`, made by the benchmarks of the same names."
    ]
    for name, result in results.items():
        about = f"{result['claim']}. Measured at `{result['commit']}`."
        remarks = [f"{remark}." for remark in result.get("remarks", ())]
        if result.get("not_flown_yet"):
            remarks.append(f"Not flown yet: {', '.join(result['not_flown_yet'])}.")
        text = "\n\n".join([about, *remarks, table(result["rows"])])
        parts.append(f"## {name}\n\n{text}")
    return "\n\n".join(parts) + "\n"


def insert(readme: str, text: str) -> str:
    """The README with the text between its two marks."""
    head, rest = readme.split(BEGIN)
    _, tail = rest.split(END)
    return f"{head}{BEGIN}\n{text}\n{END}{tail}"


def read_results(folder: Path) -> dict[str, dict[str, Any]]:
    """Every result that has rows, by the name of its file."""
    results = {
        path.stem: json.loads(path.read_text("utf-8")) for path in sorted(folder.glob("*.json"))
    }
    return {k: r for k, r in results.items() if isinstance(r, dict) and r.get("rows")}


def main() -> None:
    """Rewrite the README's table and docs/results.md."""
    readme, results = ROOT / "README.md", read_results(ROOT / "benchmarks" / "results")
    text = insert(readme.read_text("utf-8"), table(headlines(results)))
    readme.write_text(text, "utf-8")
    (ROOT / "docs" / "results.md").write_text(everything(results), "utf-8")
    print(table(headlines(results)))


def _number(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
