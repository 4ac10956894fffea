# SPDX-License-Identifier: Apache-2.0
import os
import subprocess
import sys
from pathlib import Path

import pytest

from skyhaul.cli.main import main
from skyhaul.mission.config import RunConfig
from skyhaul.world.load import load_config, scenario_names

HEAVY = ("numpy", "numba", "casadi", "mujoco", "pydantic", "plotly", "pyarrow", "rich", "yaml")


def one_line(text: str) -> str:
    """The sentence on stderr."""
    assert text.count("\n") == 1
    assert text.startswith("skyhaul: ")
    return text.removeprefix("skyhaul: ").rstrip("\n")


def test_parsing_imports_nothing_heavy() -> None:
    code = (
        "import sys; from skyhaul.cli.main import parser; parser().parse_args(['run', 'paper'])\n"
        f"print([m for m in {HEAVY} if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "argv",
    [
        [],
        ["fly"],
        ["run"],
        ["run", "paper", "--trigger", "sometimes"],
        ["run", "paper", "--seed", "-1"],
        ["run", "paper", "--seed", "x"],
        ["run", "paper", "--sed", "x=1"],
        ["report"],
    ],
)
def test_wrong_usage_exits_with_2(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(argv)
    assert caught.value.code == 2
    assert "usage: skyhaul" in capsys.readouterr().err


def test_scenarios_lists_every_name_with_its_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenarios"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert tuple(line.split()[0] for line in lines) == scenario_names()
    assert all(len(line.split()) > 3 for line in lines)


def test_config_prints_yaml_that_flies_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    overrides = ["limits.v_max_mps=1.25", "mission.trigger.kind=periodic"]
    assert main(["config", "circle", "--set", overrides[0], "--set", overrides[1]]) == 0
    path = tmp_path / "mine.yaml"
    path.write_text(capsys.readouterr().out)
    assert load_config(RunConfig, path) == load_config(RunConfig, "circle", overrides)


@pytest.mark.parametrize(
    "words",
    [
        ["circle", "--set", "limits.v_max_mps=1.25", "limits.a_max_mps2=0.9"],
        ["--set", "limits.v_max_mps=1.25", "limits.a_max_mps2=0.9", "circle"],
        ["--set", "limits.v_max_mps=1.25", "--set", "limits.a_max_mps2=0.9", "--debug", "circle"],
        ["--set=limits.v_max_mps=1.25", "circle", "--set", "limits.a_max_mps2=0.9"],
    ],
)
def test_entries_may_stand_before_or_after_the_scenario(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", *words]) == 0
    text = capsys.readouterr().out
    assert "v_max_mps: 1.25" in text
    assert "a_max_mps2: 0.9" in text


@pytest.mark.parametrize(
    ("argv", "part"),
    [
        (["run", "x" * 300], "cannot be read: File name too long"),
        (["run", "papr"], "papr: no such scenario or file; did you mean 'paper'?"),
        (["run", "nowhere/x.yaml"], "nowhere/x.yaml: no such file"),
        (["config", "paper", "--set", "team.cout=3"], "team.cout: unknown key; did you mean 'coun"),
        (["run", "paper", "--set", "team.vehicle.mass_kg=-1"], "mass_kg must be > 0, got -1"),
        (["run", "paper", "--set", "task.goal_m=[50, 0, 0]"], "lies outside the map"),
        (["run", "paper", "--perception", "full"], "fly with --perception truth"),
        (["run", "paper", "--set", "nonsense"], "write it as key.path=value"),
        (["report", "no/such/run"], "no/such/run: no such run folder"),
        (["doctor", "papr"], "no such scenario"),
    ],
)
def test_bad_input_is_one_sentence_exit_1_and_nothing_written(
    argv: list[str],
    part: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 1
    captured = capsys.readouterr()
    assert part in one_line(captured.err)
    assert captured.out == "" or argv[0] == "doctor"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("data", [b"", b"\x00\x01\x02", b"team: {vehicle: {mass: 1}}"])
def test_bad_files_leave_nothing_behind(
    data: bytes,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_bytes(data)
    assert main(["run", "mine.yaml", "--out", "out"]) == 1
    assert one_line(capsys.readouterr().err).startswith("mine.yaml: ")
    assert [p.name for p in tmp_path.iterdir()] == ["mine.yaml"]


def test_a_folder_that_is_no_run_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(tmp_path)]) == 1
    assert "is no run folder" in one_line(capsys.readouterr().err)


def test_a_fault_of_ours_is_one_line_without_debug_and_a_traceback_with(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(_: object) -> int:
        raise ZeroDivisionError("float\ndivision")

    monkeypatch.setattr("skyhaul.cli.main.command", lambda _: broken)
    assert main(["scenarios"]) == 1
    sentence = one_line(capsys.readouterr().err)
    assert sentence.startswith("a fault of ours: ZeroDivisionError: float division; run with --deb")
    with pytest.raises(ZeroDivisionError):
        main(["scenarios", "--debug"])


def test_doctor_tells_what_the_team_can_bear(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "paper"]) == 0
    out = capsys.readouterr().out
    rows = {line.strip()[:28].strip(): line.strip()[28:].strip() for line in out.splitlines()}
    assert rows["hover thrust / largest"] == "0.72"
    assert rows["vehicles that lift it alone"].startswith("0 of 4")
    assert [f"without vehicle {i}" in rows for i in range(5)] == [True] * 4 + [False]
    assert "calibration" in out
    assert "compiler" in out


def test_output_into_a_closed_pipe_ends_quietly() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "skyhaul", "scenarios"]
    result = subprocess.run(
        command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False, timeout=60
    )
    os.close(writer)
    assert result.stderr == ""
    assert result.returncode == 1


@pytest.mark.parametrize(
    ("argv", "name", "said"),
    [
        (["doctor"], "doctor", "nothing was written"),
        (["events", "x.es"], "events", "nothing was written"),
        (["vio", "x.csv"], "vio", "nothing was written"),
        (
            ["report", "runs/{a}"], "report",
            "the flight in runs/{a} is as it was; the same command makes its report",
        ),
        (
            ["record", "hover", "--dataset", "euroc", "--out", "set"], "record",
            "what is whole is kept in set; the same command goes on from there",
        ),
        (
            ["train-events", "--work", "w"], "train_events",
            "what is whole is kept in w; the same command goes on from there",
        ),
    ],
)  # fmt: skip
def test_ctrl_c_is_one_sentence_and_exit_130(argv, name, said, monkeypatch, capsys):
    def stop(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(f"skyhaul.cli.{name}.{name}", stop)
    assert main(argv) == 130
    assert capsys.readouterr() == ("", f"skyhaul: interrupted; {said}\n")
