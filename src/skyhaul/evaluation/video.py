# SPDX-License-Identifier: Apache-2.0
"""`flight.mp4`: the flight from two sides, with its curves; needs the extra `video`."""

from dataclasses import dataclass
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skyhaul.errors import FileError, PlatformError
from skyhaul.evaluation.folder import VIDEO
from skyhaul.evaluation.raster import Pixels
from skyhaul.evaluation.series import Run, load_run
from skyhaul.evaluation.stage import Look, Stage
from skyhaul.types import Array
from skyhaul.whole import whole

if TYPE_CHECKING:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

WIDTH, HEIGHT, PANEL = 1280, 720, 400
"""Size of the video and of the panel with the curves at its right [px]."""
_INSET = 300, 225


@dataclass(frozen=True, eq=False)
class Panel:
    """The curves, drawn once, and where their time axis lies."""

    pixels: Pixels
    left: int
    right: int
    """Columns of the first and the last time [px]."""
    digits: dict[str, Pixels]
    """Pictures of single characters, all of one height."""
    names: dict[str, Pixels]
    """Pictures of the names of the phases."""


def write_video(folder: Path | str, speed: float = 1.0, rate_hz: int = 25) -> Path:
    """Write `flight.mp4` into a run folder; returns the file.

    Args:
        folder: Run folder.
        speed: Seconds of flight per second of video.
        rate_hz: Frames per second of video.

    Raises:
        PlatformError: when the packages of the extra `video` are not installed.
        FileError: when the folder holds no run, or a run without rows.
    """
    missing = [name for name in ("av", "matplotlib") if find_spec(name) is None]
    if missing:
        raise PlatformError(
            f"a video needs {' and '.join(missing)}: install skyhaul with `pip install "
            "'skyhaul[video]'`"
        )
    run = load_run(folder)
    if not len(run.t_s):
        raise FileError(f"{run.folder} holds no rows to draw: the run ended at once")
    path = run.folder / VIDEO
    times = np.arange(0.0, run.t_s[-1] + 1e-9, speed / rate_hz)
    rows = np.minimum(np.searchsorted(run.t_s, times - 1e-9), len(run.t_s) - 1)
    with whole(path) as part:
        _encode(part, run, rows, rate_hz)
    return path


def _encode(path: Path, run: Run, rows: np.ndarray, rate_hz: int) -> None:
    import av

    panel, stage = _panel(run), Stage(run)
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate_hz))
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.options = {"crf": "21", "preset": "veryfast"}
        for row in rows:
            frame = av.VideoFrame.from_ndarray(_frame(run, stage, panel, int(row)), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _frame(run: Run, stage: Stage, panel: Panel, row: int) -> Pixels:
    """One picture of the video, (HEIGHT, WIDTH, 3)."""
    out = np.empty((HEIGHT, WIDTH, 3), dtype=np.uint8)
    scene = WIDTH - PANEL
    out[:, :scene] = stage.draw(row, stage.overview(row), scene, HEIGHT, Look()).pixels()
    w, h = _INSET
    small = stage.draw(row, stage.overview(), w, h, Look(line_px=1.0)).pixels()
    out[HEIGHT - h - 12 : HEIGHT - 12, 12 : 12 + w] = small
    out[HEIGHT - h - 13, 12 : 12 + w] = out[HEIGHT - 12, 12 : 12 + w] = 170
    out[HEIGHT - h - 13 : HEIGHT - 11, 11] = out[HEIGHT - h - 13 : HEIGHT - 11, 12 + w] = 170
    out[:, scene:] = panel.pixels
    share = run.t_s[row] / max(run.t_s[-1], 1e-9)
    at = scene + round(panel.left + share * (panel.right - panel.left))
    out[70:, at] = (52, 120, 222)
    _write_status(out, run, panel, row, scene + 16)
    return out


def _write_status(out: Pixels, run: Run, panel: Panel, row: int, left: int) -> None:
    """Time and phase on top of the panel."""
    at = left
    for c in f"{run.t_s[row]:.2f} s":
        glyph = panel.digits[c]
        h, w, _ = glyph.shape
        out[14 : 14 + h, at : at + w] = glyph
        at += w
    name = panel.names[run.phases[int(run.series["phase"][row])]]
    h, w, _ = name.shape
    out[14 : 14 + h, WIDTH - 16 - w : WIDTH - 16] = name


def _panel(run: Run) -> Panel:
    """Draw the curves."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PANEL / 100, HEIGHT / 100), dpi=100, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    grid = figure.subplots(4, 1, sharex=True, gridspec_kw={"hspace": 0.38})
    figure.subplots_adjust(left=0.12, right=0.94, top=0.87, bottom=0.06)
    for axes, (title, values, bound) in zip(grid, _curves(run), strict=True):
        _draw_curves(axes, run, title, values, bound)
    grid[-1].set_xlim(0.0, max(run.t_s[-1], 1e-3))
    canvas.draw()  # type: ignore[no-untyped-call]
    pixels = _pixels(canvas)
    box = grid[-1].get_window_extent()
    digits = {c: _text(c, 19) for c in "0123456789. s-"}
    names = {name: _text(name, 13) for name in run.phases}
    return Panel(pixels, round(box.x0), round(box.x1), digits, names)


def _draw_curves(axes, run: Run, title: str, values: Array, bound: float | None) -> None:  # type: ignore[no-untyped-def]  # noqa: ANN001
    from skyhaul.evaluation.messages import VEHICLE_COLORS

    many = values.ndim == 2
    for i in range(values.shape[1] if many else 1):
        color = VEHICLE_COLORS[i] if many else (0.72, 0.54, 0.0)
        axes.plot(run.t_s, values[:, i] if many else values, lw=1.0, color=color)
    if bound is not None:
        axes.axhline(bound, lw=0.8, ls="--", color="#c2362f")
    axes.set_title(title, fontsize=8.5, loc="left", color="#1b2330", pad=3)
    axes.tick_params(labelsize=7, colors="#5d6878", length=0)
    axes.grid(color="#e9ecf1", lw=0.7)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))


def _curves(run: Run) -> list[tuple[str, Array, float | None]]:
    """Title, values and bound of each curve."""
    from skyhaul.evaluation.metrics import position_error

    s = run.series
    tension = np.where(run.carrying, s["cable_tension"], np.nan)
    limit = float(run.scenario.team.arrays().thrust_max.max())
    return [
        ("tracking error [cm]", 100.0 * position_error(run), None),
        ("clearance [m]", s["clearance_min"], 0.0),
        ("cable tension [N]", tension, None),
        ("thrust [N]", s["vehicle_rotor"].sum(axis=2), limit),
    ]


def _text(text: str, size_pt: float) -> Pixels:
    """A picture of a text, as wide as the text."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.0, 0.36), dpi=100, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    label = figure.text(0.0, 0.22, text.replace(" ", "\N{NO-BREAK SPACE}"), size=size_pt)
    canvas.draw()  # type: ignore[no-untyped-call]
    width = max(1, round(label.get_window_extent().width))
    return _pixels(canvas)[:, :width]


def _pixels(canvas: "FigureCanvasAgg") -> Pixels:
    """What a canvas shows, (height, width, 3)."""
    return np.array(canvas.buffer_rgba())[:, :, :3]  # type: ignore[no-untyped-call]
