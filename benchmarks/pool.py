# SPDX-License-Identifier: Apache-2.0
"""Runs the jobs of a benchmark in processes of one thread each."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from fly import THREADS

Job = TypeVar("Job")
Result = TypeVar("Result")


def run_all(
    work: Callable[[Job], Result], jobs: Sequence[Job], workers: int
) -> Iterator[tuple[Job, Result]]:
    """Each job with its result, as they are done.

    Args:
        work: A function of a module, so that it can be sent.
        jobs: What it is called with.
        workers: Number of processes; with one everything runs in this process.
    """
    os.environ.update(dict.fromkeys(THREADS, "1"))
    if workers == 1 or len(jobs) < 2:
        for job in jobs:
            yield job, work(job)
        return
    context = multiprocessing.get_context("spawn")
    with context.Pool(min(workers, len(jobs))) as pool:
        numbered = [(work, k, job) for k, job in enumerate(jobs)]
        for k, result in pool.imap_unordered(_call, numbered):
            yield jobs[k], result


def _call(numbered: tuple[Callable[[Job], Result], int, Job]) -> tuple[int, Result]:
    work, k, job = numbered
    return k, work(job)
