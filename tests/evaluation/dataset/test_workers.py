# SPDX-License-Identifier: Apache-2.0
"""Jobs in this process and in others: progress, failures, workers that are killed."""

import multiprocessing
import os
import signal
import time
from pathlib import Path

import pytest

from skyhaul.errors import FileError, PlatformError
from skyhaul.evaluation.dataset.workers import run_all


def write_half_and_whole(job: Path, show) -> None:
    show(0.5)
    job.write_text("done")


def refuse(job: Path, show) -> None:
    raise FileError(f"{job} cannot be written")


def sleep(job: Path, show) -> None:
    time.sleep(600)


def die(job: Path, show) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_one_worker_does_all_in_this_process_and_tells_the_share(tmp_path) -> None:
    shares: list[float] = []
    jobs = [tmp_path / "a", tmp_path / "b"]
    run_all(write_half_and_whole, jobs, 1, shares.append)
    assert [job.read_text() for job in jobs] == ["done", "done"]
    assert shares == [0.25, 0.75, 1.0]


def test_nothing_to_do_is_done(tmp_path) -> None:
    shares: list[float] = []
    run_all(refuse, [], 4, shares.append)
    assert shares == [1.0]


def test_what_a_job_raises_comes_through(tmp_path) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        run_all(refuse, [tmp_path / "a"], 1, lambda share: None)


@pytest.mark.slow
def test_processes_do_all_and_tell_the_share(tmp_path) -> None:
    shares: list[float] = []
    jobs = [tmp_path / name for name in "abc"]
    run_all(write_half_and_whole, jobs, 2, shares.append)
    assert all(job.read_text() == "done" for job in jobs)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.slow
def test_a_failure_in_a_process_comes_through(tmp_path) -> None:
    with pytest.raises(FileError, match="cannot be written"):
        run_all(refuse, [tmp_path / "a", tmp_path / "b"], 2, lambda share: None)


@pytest.mark.slow
def test_an_interrupt_stops_the_workers_and_no_other_process(tmp_path) -> None:
    other = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600,))
    other.start()

    def interrupt(share: float) -> None:
        raise KeyboardInterrupt

    try:
        with pytest.raises(KeyboardInterrupt):
            run_all(sleep, [tmp_path / "a", tmp_path / "b"], 2, interrupt)
        assert multiprocessing.active_children() == [other]
        assert other.is_alive()
    finally:
        other.kill()
        other.join()


@pytest.mark.slow
def test_a_killed_process_is_one_sentence(tmp_path) -> None:
    with pytest.raises(PlatformError, match="was killed, perhaps for want of memory"):
        run_all(die, [tmp_path / "a", tmp_path / "b"], 2, lambda share: None)
