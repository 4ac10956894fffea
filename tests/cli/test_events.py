# SPDX-License-Identifier: Apache-2.0
import json
import os
from pathlib import Path

import numpy as np
import pytest

import skyhaul.cli.event_picture as pictures
from skyhaul.cli.main import main
from skyhaul.perception.events.graph import GraphParams
from skyhaul.perception.events.weights import random_weights, save_weights

DATA = Path(os.environ.get("SKYHAUL_DATA", "../shared/data"))
real = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"no recordings at {DATA}; name their folder in SKYHAUL_DATA"
)


def numbers(capsys, *argv):
    assert main(["events", *map(str, argv), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.fixture
def crossing(tmp_path):
    """A text recording: a patch crosses, points flicker here and there."""
    rng, rows = np.random.default_rng(0), []
    for t in range(0, 300_000, 500):
        x = 10 + 3e-4 * t
        rows += [(t, x + rng.integers(0, 3), 30 + rng.integers(0, 20), 1) for _ in range(4)]
        rows.append((t, rng.integers(0, 128), rng.integers(0, 96), 0))
    path = tmp_path / "events.txt"
    path.write_text("".join(f"{1e-6 * t:.6f} {int(x)} {y} {p}\n" for t, x, y, p in rows))
    return path


both = pytest.mark.parametrize("kind", ["network", "timestamp"])


@both
def test_a_crossing_patch_is_one_track(crossing, capsys, kind):
    found = numbers(capsys, crossing, "--kind", kind)
    assert found["classifier"] == kind
    assert found["events"] == 3000
    assert found["confirmed_tracks"] == 1
    assert found["longest_track_fraction"] > 0.8
    assert found["noise_fraction"] > 0.1
    assert found["events_per_s"] > 0.0
    assert (found["skipped_fraction"] > 0.0) == (kind == "network")
    assert found["lens"].startswith("assumed")


def test_files_beside_the_events_are_taken_and_options_win(crossing, capsys):
    (crossing.parent / "calib.txt").write_text("100 100 64 48 0 0 0 0 0")
    (crossing.parent / "motion.txt").write_text("0 0 0.5")
    found = numbers(capsys, crossing)
    assert found["lens"] == str(crossing.parent / "calib.txt")
    assert found["rate"] == str(crossing.parent / "motion.txt")
    assert numbers(capsys, crossing, "--rate", 0, 0, 0)["rate"] == "--rate"


def test_a_network_is_used_when_its_weights_are_given(crossing, tmp_path, capsys):
    save_weights(random_weights(GraphParams(), has_table=False), tmp_path / "w.npz")
    found = numbers(capsys, crossing, "--weights", tmp_path / "w.npz")
    assert found["classifier"] == "network"
    assert 0.0 < found["skipped_fraction"] < 1.0


def test_text_says_the_same_and_a_picture_is_written(crossing, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(pictures, "find_spec", lambda _: None)
    assert main(["events", str(crossing), "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "3,000 events" in out
    assert "confirmed tracks     1" in out
    assert (tmp_path / "out" / "movers.png").read_bytes().startswith(b"\x89PNG")


def test_a_video_is_written_where_pyav_is(crossing, tmp_path, capsys):
    av = pytest.importorskip("av", reason="PyAV is not installed")
    found = numbers(capsys, crossing, "--out", tmp_path / "out")
    with av.open(found["picture"]) as video:
        frames = [f.to_ndarray(format="rgb24") for f in video.decode(video=0)]
    assert len(frames) == 30
    assert np.ptp(frames[-1]) > 150


@pytest.mark.parametrize(
    ("content", "part"),
    [(b"", "empty"), (b"\x00\x01", "binary"), (b"no events here", "no `t x y p` text")],
)
def test_a_wrong_file_is_one_sentence(tmp_path, capsys, content, part):
    (tmp_path / "x.txt").write_bytes(content)
    assert main(["events", str(tmp_path / "x.txt")]) == 1
    err = capsys.readouterr().err
    assert err.startswith("skyhaul: ")
    assert err.count("\n") == 1
    assert part in err


def test_a_missing_file_and_missing_weights_are_one_sentence(crossing, tmp_path, capsys):
    for argv in ([tmp_path / "gone.es"], [crossing, "--weights", tmp_path / "gone.npz"],
                 [crossing, "--calib", tmp_path / "gone.txt"]):  # fmt: skip
        assert main(["events", *map(str, argv)]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert "no such file" in err


@real
@both
def test_a_real_aeroplane_is_one_track_almost_throughout(capsys, kind):
    found = numbers(capsys, DATA / "events" / "dvs.es", "--kind", kind)
    (track,) = found["tracks"]
    assert found["longest_track_fraction"] >= 0.95
    assert track["largest_box_fraction"] <= 0.5
    assert track["held_fraction"] >= 0.9


@real
@both
@pytest.mark.parametrize("clip", ["poster_rotation", "shapes_rotation"])
def test_a_real_turn_has_no_movers(capsys, clip, kind):
    found = numbers(capsys, DATA / "ijrr" / clip / "events.txt", "--kind", kind)
    assert found["mover_fraction"] <= 0.03
    assert found["confirmed_tracks"] == 0
