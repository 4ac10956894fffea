# SPDX-License-Identifier: Apache-2.0
"""`skyhaul run` with a flight that is only told, not flown."""

import argparse
import errno
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numba
import pytest

import skyhaul.cli.run as command
from skyhaul.cli.main import main
from skyhaul.cli.overrides import run_overrides
from skyhaul.cli.progress import FlightBar
from skyhaul.errors import ConfigError, FileError
from skyhaul.evaluation.folder import (
    FolderTakenError,
    create,
    origin,
    read_config,
    remove,
)
from skyhaul.jit import told_of_compiling
from skyhaul.mission.api import Outcome, Phase
from skyhaul.mission.config import RunConfig
from skyhaul.mission.flight import FlightProgress
from skyhaul.mission.triggers import PeriodicTrigger
from skyhaul.world.scenario import Scenario


class Folder:
    """Stands in for the recorder: makes the folder and one file, and knows whether it flew."""

    def __init__(self, folder: Path, config: RunConfig, seed: int) -> None:
        self._made = create(folder, config, origin(seed))
        self.folder, self.flown = folder, False

    def withdraw(self) -> bool:
        if not self.flown:
            remove(self.folder, self._made)
        return not self.flown


def told(outcome: Outcome | BaseException, flown: bool = True) -> Callable[..., Outcome]:
    """A flight that ends as told."""

    def fly(
        config: RunConfig, seed: int, recorder: Folder, progress: Callable[[FlightProgress], None]
    ) -> Outcome:
        recorder.flown = flown
        for t_us in (0, 100_000):
            progress(FlightProgress(t_us, 10_000_000, Phase.CARRY, 0.5, 3.0))
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    return fly


def outcome(success: bool, reason: str) -> Outcome:
    return Outcome(success=success, reason=reason, end_us=100_000, cpu_s={}, wall_s=0.1)


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An empty working folder; what judges and reports is replaced."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "RunRecorder", Folder)
    monkeypatch.setattr(command, "load_run", lambda folder: folder)
    monkeypatch.setattr(command, "rehearse", lambda config, recorder, seed: None)
    monkeypatch.setattr(command, "evaluate", lambda folder: {"mission_success": True})
    monkeypatch.setattr(command, "print_table", lambda metrics: None)
    monkeypatch.setattr(command, "write_report", lambda folder, video: None)
    return tmp_path


@pytest.mark.parametrize(("success", "code"), [(True, 0), (False, 3)])
def test_the_exit_code_tells_whether_the_mission_was_done(
    success: bool,
    code: int,
    written: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(command, "fly", told(outcome(success, "because")))
    monkeypatch.setattr(command, "evaluate", lambda folder: {"mission_success": success})
    assert main(["run", "hover", "--seed", "5", "--out", "mine"]) == code
    assert read_config(written / "mine")[1].seed == 5


def test_runs_without_out_get_folders_of_their_own(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "fly", told(outcome(True, "done")))
    for _ in range(3):
        assert main(["run", "hover"]) == 0
    folders = list((written / "runs").iterdir())
    assert len(folders) == 3
    assert all(f.name.startswith("hover-seed0-") for f in folders)


def test_no_name_leads_out_of_the_folder_of_runs() -> None:
    for name in ("../../etc", "/tmp/x", "a b/c", ".."):
        assert next(command.default_folders(name, 0)).parent == Path("runs")


def test_a_refused_flight_leaves_nothing(
    written: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    refusal = ConfigError("start: vehicle 1 stands in a wall")
    monkeypatch.setattr(command, "fly", told(refusal, flown=False))
    assert main(["run", "hover", "--out", "mine"]) == 1
    assert list(written.iterdir()) == []
    assert main(["run", "hover", "--out", "deep/down/mine"]) == 1
    assert main(["run", "hover"]) == 1
    assert list(written.iterdir()) == []
    (written / "mine").mkdir()
    assert main(["run", "hover", "--out", "mine"]) == 1
    assert list((written / "mine").iterdir()) == []
    assert "skyhaul: start: vehicle 1 stands in a wall\n" in capsys.readouterr().err


def test_a_crash_keeps_the_folder_as_evidence(
    written: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "fly", told(RuntimeError("odd")))
    assert main(["run", "hover", "--out", "mine"]) == 1
    assert (written / "mine" / "config.yaml").is_file()
    err = capsys.readouterr().err
    assert "a fault of ours: RuntimeError: odd; what was flown is kept in mine; run with" in err


@pytest.mark.parametrize(("fault", "code"), [(KeyboardInterrupt(), 130), (RuntimeError("odd"), 1)])
def test_what_breaks_off_the_rehearsal_leaves_nothing(
    fault: BaseException, code: int, written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def rehearse(*_: object) -> None:
        raise fault

    monkeypatch.setattr(command, "rehearse", rehearse)
    assert main(["run", "hover", "--out", "mine"]) == code
    assert list(written.iterdir()) == []


def test_an_interrupt_before_the_first_step_leaves_nothing(
    written: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "fly", told(outcome(False, "interrupted"), flown=False))
    assert main(["run", "hover", "--out", "mine"]) == 130
    assert list(written.iterdir()) == []
    assert "skyhaul: interrupted; nothing was written\n" in capsys.readouterr().err


def test_an_interrupted_flight_is_judged_and_kept(
    written: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    judged: list[Path] = []
    monkeypatch.setattr(command, "write_report", lambda folder, video: judged.append(folder))
    monkeypatch.setattr(command, "fly", told(outcome(False, "interrupted")))
    assert main(["run", "hover", "--out", "mine"]) == 130
    assert judged == [Path("mine")]
    err = capsys.readouterr().err
    assert "skyhaul: interrupted; what was flown is kept in mine, with its report\n" in err


def test_an_interrupt_while_a_flight_is_judged_says_how_to_go_on(
    written: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "fly", told(outcome(True, "done")))
    monkeypatch.setattr(command, "write_report", stop)
    assert main(["run", "hover", "--out", "mine"]) == 130
    assert (written / "mine" / "config.yaml").is_file()
    said = "interrupted; the flight is kept in mine, `skyhaul report` makes its report\n"
    assert said in capsys.readouterr().err


def test_a_flight_that_the_disk_breaks_off_has_failed_and_is_kept(
    written: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "fly", told(FileError("log.mcap cannot be written: full")))
    assert main(["run", "hover", "--out", "mine"]) == 3
    assert (written / "mine" / "config.yaml").is_file()
    assert "skyhaul: broken off: log.mcap cannot be written: full\n" in capsys.readouterr().err

    def full(folder: Path) -> dict[str, bool]:
        raise OSError(errno.ENOSPC, "No space left on device", "metrics.part")

    monkeypatch.setattr(command, "evaluate", full)
    assert main(["run", "hover", "--out", "other"]) == 3
    monkeypatch.setattr(command, "fly", told(outcome(True, "done")))
    assert main(["run", "hover", "--out", "third"]) == 1
    assert (
        "metrics.part: No space left on device; the flight is in third" in capsys.readouterr().err
    )


def test_a_run_that_another_process_began_is_left_alone(
    written: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both found no folder; the other one was faster to take it."""
    folder = written / "mine"
    make = Path.mkdir

    def late(path: Path, *args: object, **kwargs: object) -> None:
        monkeypatch.undo()
        make(folder)
        (folder / "config.yaml").write_text("other run")
        make(path, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.setattr(Path, "mkdir", late)
    assert main(["run", "hover", "--out", str(folder)]) == 1
    assert [f.read_text() for f in folder.iterdir()] == ["other run"]
    assert "is not empty; give a new or an empty folder" in capsys.readouterr().err


def test_of_two_who_found_an_empty_folder_one_gets_it(tmp_path: Path) -> None:
    config, found = RunConfig(), Path.iterdir
    with pytest.MonkeyPatch.context() as patch:

        def faster(path: Path) -> Iterator[Path]:
            yield from found(path)
            patch.undo()
            create(path, config, origin(1))

        patch.setattr(Path, "iterdir", faster)
        with pytest.raises(FolderTakenError):
            create(tmp_path, config, origin(0))
    assert read_config(tmp_path)[1].seed == 1


def test_default_names_are_taken_one_after_the_other(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "strftime", lambda form: "20260101-000000")
    monkeypatch.setattr(command, "fly", told(outcome(True, "done")))
    other = Folder(written / "runs" / "hover-seed0-20260101-000000", RunConfig(), 0)
    assert main(["run", "hover"]) == 0
    assert read_config(other.folder)[0] == Scenario()
    assert (written / "runs" / "hover-seed0-20260101-000000-2" / "config.yaml").is_file()


def test_a_used_folder_is_refused_and_left_alone(
    written: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "fly", told(outcome(True, "done")))
    (written / "mine").mkdir()
    (written / "mine" / "notes.txt").write_text("keep")
    assert main(["run", "hover", "--out", "mine"]) == 1
    assert main(["run", "hover", "--out", "mine/notes.txt"]) == 1
    err = capsys.readouterr().err
    assert "mine: is not empty; give a new or an empty folder" in err
    assert "notes.txt: is a file; give a folder" in err
    assert (written / "mine" / "notes.txt").read_text() == "keep"


def test_flags_become_entries_and_set_wins(written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[RunConfig] = []

    def fly(config: RunConfig, *_: object) -> Outcome:
        seen.append(config)
        return outcome(True, "done")

    monkeypatch.setattr(command, "fly", fly)
    flags = ["--trigger", "periodic", "--set", "mission.trigger.rate_hz=7", "limits.v_max_mps=1"]
    assert main(["run", "hover", "--out", "mine", *flags]) == 0
    assert seen[0].mission.trigger == PeriodicTrigger(rate_hz=7.0)
    assert seen[0].limits.v_max_mps == 1.0


def test_latency_none_changes_nothing() -> None:
    args = argparse.Namespace(perception="truth", trigger=None, latency="none", overrides=[])
    assert run_overrides(args) == []
    args.latency = "measured"
    assert run_overrides(args) == ["mission.latency=measured"]


def test_compiling_is_told_once_where_there_is_no_terminal(tmp_path: Path) -> None:
    with (tmp_path / "out").open("w+") as file:
        with FlightBar("hover", file) as bar, told_of_compiling(bar.compiling):
            for _ in range(2):
                numba.njit(lambda x: x + 1)(1)
        numba.njit(lambda x: x + 2)(1)
        file.seek(0)
        lines = file.read().splitlines()
    assert lines == ["hover: compiling, once; this takes some minutes"]


def test_without_a_terminal_progress_is_a_line_for_each_phase(tmp_path: Path) -> None:
    with (tmp_path / "out").open("w+") as file:
        with FlightBar("hover", file) as bar:
            for t_us, phase in ((0, Phase.TAUTEN), (50, Phase.TAUTEN), (2_000_000, Phase.CARRY)):
                bar.update(FlightProgress(t_us, 9_000_000, phase, 0.1, float("nan")))
        file.seek(0)
        lines = file.read().splitlines()
    assert lines == ["hover: t = 0.0 s, tauten", "hover: t = 2.0 s, carry"]
