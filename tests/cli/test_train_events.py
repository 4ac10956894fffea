# SPDX-License-Identifier: Apache-2.0
import importlib.util

import pytest

from skyhaul.cli.main import main
from skyhaul.mission.api import Outcome
from skyhaul.perception.events.weights import load_weights
from skyhaul.training import flights


def test_without_torch_one_sentence_says_what_to_do(monkeypatch, capsys):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "skyhaul.cli.train_events.find_spec",
        lambda name: None if name == "torch" else found(name),
    )
    assert main(["train-events"]) == 1
    said = capsys.readouterr().err
    assert "skyhaul[train]" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("option", ["--scenes", "--held-out", "--updates"])
def test_a_number_out_of_range_is_named(option, capsys, monkeypatch):
    pytest.importorskip("torch", reason="torch is not installed: pip install skyhaul[train]")
    assert main(["train-events", option, "0"]) == 1
    said = capsys.readouterr().err
    assert option.removeprefix("--").replace("-", "_") in said
    assert "got 0" in said


def test_half_a_flight_is_not_kept_for_the_next_time(tmp_path, monkeypatch):
    flown = Outcome(success=False, reason="interrupted", end_us=0, cpu_s={}, wall_s=0.0)
    monkeypatch.setattr(flights, "fly", lambda *_: flown)
    with pytest.raises(KeyboardInterrupt):
        flights.flight("hover", 0, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_small_training_goes_on_where_it_stopped_and_gives_the_same_file(tmp_path, capsys):
    pytest.importorskip("torch", reason="torch is not installed: pip install skyhaul[train]")
    work, options = tmp_path / "work", ["--scenes", "2", "--held-out", "1", "--updates", "20"]
    files = []
    for name in ("a.npz", "b.npz"):
        out = tmp_path / name
        assert main(["train-events", "--work", str(work), "--out", str(out), *options]) == 0
        files.append(load_weights(out))
        (work / "checkpoint.pt").unlink()
    assert "F1" in capsys.readouterr().out
    for name, array in files[0].arrays().items():
        assert array.tobytes() == files[1].arrays()[name].tobytes()
    assert files[0].record["trained"] == 1
    assert len(files[0].record["curve_updates_loss_f1"]) == 60
