# SPDX-License-Identifier: Apache-2.0
import base64
import json
import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skyhaul.errors import FileError, PlatformError
from skyhaul.evaluation import report_data, video
from skyhaul.evaluation.energy import EnergyModel
from skyhaul.evaluation.figures import png, write_figure
from skyhaul.evaluation.metrics import evaluate, run_metrics
from skyhaul.evaluation.recorder import RunRecorder
from skyhaul.evaluation.report import write_report
from skyhaul.evaluation.series import Run, load_run
from skyhaul.evaluation.video import write_video
from skyhaul.mission.api import Outcome
from skyhaul.world.scenario import Scenario


@pytest.fixture(scope="module")
def run(run_folder: Path) -> Run:
    return load_run(run_folder)


@pytest.fixture(scope="module")
def page(run_folder: Path) -> str:
    return write_report(run_folder).read_text(encoding="utf-8")


def unpacked(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


def test_the_report_needs_nothing_from_outside(page: str, run_folder: Path) -> None:
    ours = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    assert re.findall(r"(?:src|href)\s*=", ours) == []
    assert page.count("<script") >= page.count("</script>") == 3
    assert "@@" not in ours
    assert (run_folder / "report.html").stat().st_size < 15e6
    assert (run_folder / "flight.png").stat().st_size > 10_000


def test_the_data_in_the_report_can_be_parsed(page: str, run: Run) -> None:
    text = re.search(r'id="data">(.*?)</script>', page, flags=re.DOTALL).group(1)
    data = json.loads(text)
    assert data["done"] is True
    assert data["scenario"] == "made-up"
    frames = data["frames"]
    np.testing.assert_allclose(unpacked(frames["t"])[[0, 1, -1]], [0.0, 0.04, 7.0], atol=1e-6)
    load = unpacked(frames["load"]).reshape(frames["count"], 7)
    np.testing.assert_allclose(load[-1], run.series["load"][-1, 0:7], atol=1e-6)
    assert [p["name"] for p in data["phases"]] == ["tauten", "lift", "carry", "hover"]
    assert len(data["events"]["triggers"]) == 14
    assert len(data["scene"]["still"]) == 2
    assert len(data["scene"]["movers"]) == 1


def test_charts_keep_the_extremes_of_the_series() -> None:
    rng = np.random.default_rng(0)
    t_s, values = 0.01 * np.arange(30_011), rng.normal(size=30_011)
    values[12_345] = np.nan
    shown = report_data._envelope(t_s, values, values)
    assert len(shown) == 2 * report_data.CHART_BUCKETS == len(report_data._bucket_times(t_s))
    assert np.nanmax(shown) == np.nanmax(values)
    assert np.nanmin(shown) == np.nanmin(values)
    rising = report_data._envelope(t_s, t_s, t_s)
    np.testing.assert_array_equal(rising, np.sort(rising))
    falling = report_data._envelope(t_s, -t_s, -t_s)
    np.testing.assert_array_equal(falling, -rising)


def test_a_hostile_name_cannot_leave_its_place_in_the_page(run: Run) -> None:
    from skyhaul.evaluation.report import _page

    data = report_data.report_data(run, run_metrics(run, EnergyModel()))
    bad = "</script><script>alert(1)</script>"
    opening = "@@DATA@@<!--<script>@@TITLE@@"  # a comment in a script hides its end
    page = _page(data | {"scenario": bad, "outcome": opening}, "a: <b>& @@DATA@@")
    assert page.count("</script>") == 3
    assert "</script><script>alert" not in page
    assert "a: &lt;b&gt;&amp; @@DATA@@</pre>" in page
    text = re.search(r'id="data">(.*?)</script>', page, flags=re.DOTALL).group(1)
    assert "<" not in text
    assert (json.loads(text)["scenario"], json.loads(text)["outcome"]) == (bad, opening)


def test_png_holds_the_pixels() -> None:
    pixels = np.random.default_rng(2).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    data = png(pixels)
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", data[16:24])
    start = data.index(b"IDAT") + 4
    size = struct.unpack(">I", data[start - 8 : start - 4])[0]
    rows = np.frombuffer(zlib.decompress(data[start : start + size]), np.uint8)
    assert (width, height) == (7, 5)
    np.testing.assert_array_equal(rows.reshape(5, 22)[:, 1:].reshape(5, 7, 3), pixels)


def test_the_figure_can_be_read_by_others(run: Run) -> None:
    image = pytest.importorskip("matplotlib.image")
    pixels = image.imread(write_figure(run, exposures=2))
    assert pixels.shape == (1000, 1600, 3)
    assert pixels.std() > 0.02


def test_the_video_has_the_length_of_the_flight(run_folder: Path) -> None:
    av = pytest.importorskip("av")
    pytest.importorskip("matplotlib")
    path = write_video(run_folder, speed=7.0, rate_hz=5)
    with av.open(str(path)) as container:
        frames = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    assert len(frames) == 6
    assert frames[0].shape == (720, 1280, 3)
    assert np.abs(frames[0].astype(int) - frames[-1]).mean() > 1.0


@pytest.mark.parametrize("end_s", [0.3, 1000.0])
def test_the_last_label_of_the_curves_keeps_off_the_edge(run: Run, end_s: float) -> None:
    pytest.importorskip("matplotlib")
    t_us = run.series["t"] * end_s / run.t_s[-1]
    panel = video._panel(replace(run, series=run.series | {"t": t_us}))
    drawn = np.flatnonzero((panel.pixels.min(axis=2) < 235).any(axis=0))
    assert video.PANEL - drawn.max() > 10


def test_a_run_without_a_single_row_has_a_report(tmp_path: Path) -> None:
    folder = tmp_path / "empty"
    RunRecorder(folder, Scenario(), 0).close(Outcome(False, "broken at once", 0, {}, 0.1))
    metrics = evaluate(folder)
    assert metrics["mission_success"] is False
    assert metrics["tracking_rmse_m"] is None
    assert "broken at once" in write_report(folder).read_text(encoding="utf-8")
    with pytest.raises(FileError, match="holds no rows to draw"):
        write_video(folder)


def test_eight_vehicles_have_a_report(fly_into: Callable[..., Path], tmp_path: Path) -> None:
    folder = fly_into(tmp_path / "r", n=8)
    assert load_run(folder).series["cable_tension"].shape == (701, 8)
    assert write_report(folder).stat().st_size < 15e6


def test_a_missing_extra_is_one_sentence(run_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "find_spec", lambda name: None if name == "av" else object())
    with pytest.raises(PlatformError, match=r"a video needs av: install skyhaul with"):
        write_video(run_folder)
