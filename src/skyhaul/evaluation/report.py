# SPDX-License-Identifier: Apache-2.0
"""`report.html`: one file that shows a run, without a network."""

import json
import re
from html import escape
from importlib.resources import files
from pathlib import Path

from skyhaul.evaluation.energy import EnergyModel
from skyhaul.evaluation.figures import write_figure
from skyhaul.evaluation.folder import CONFIG, REPORT, write_text
from skyhaul.evaluation.metrics import run_metrics
from skyhaul.evaluation.report_data import Data, report_data
from skyhaul.evaluation.series import Run, load_run

_SCRIPTS = ("data.js", "math.js", "meshes.js", "renderer.js", "scene.js", "charts.js", "player.js")
"""Our scripts, in the order in which they are loaded."""


def write_report(run: Run | Path | str, video: bool = False) -> Path:
    """Write `report.html` and `flight.png` of a run, and `flight.mp4` if asked for.

    Raises:
        FileError: when the folder holds no run.
        PlatformError: when a video is wanted and its packages are not installed.
    """
    run = run if isinstance(run, Run) else load_run(run)
    data = report_data(run, run_metrics(run, EnergyModel()))
    config = (run.folder / CONFIG).read_text(encoding="utf-8")
    path = run.folder / REPORT
    write_text(path, _page(data, config))
    if len(run.t_s):
        write_figure(run)
    if video:
        from skyhaul.evaluation.video import write_video

        write_video(run.folder)
    return path


def _page(data: Data, config: str) -> str:
    """The page: template, styles, plotly.js, data and our scripts, all in one text."""
    title = f"{data['scenario']}, seed {data['origin']['seed']}"
    parts = {
        "TITLE": escape(title),
        "STYLE": _template("report.css"),
        "CONFIG": escape(config),
        "DATA": json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "SCRIPT": "\n".join(_template(name) for name in _SCRIPTS),
        "PLOTLY": _plotly(),
    }
    return re.sub("@@([A-Z]+)@@", lambda place: parts[place[1]], _template("report.html"))


def _template(name: str) -> str:
    return (files("skyhaul.evaluation") / "templates" / name).read_text(encoding="utf-8")


def _plotly() -> str:
    """plotly.js as it ships with the Python package."""
    text = (files("plotly") / "package_data" / "plotly.min.js").read_text(encoding="utf-8")
    return text.replace("</script", "<\\/script")
