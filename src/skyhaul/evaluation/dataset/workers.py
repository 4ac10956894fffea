# SPDX-License-Identifier: Apache-2.0
"""Jobs in worker processes, with their progress."""

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from skyhaul.errors import PlatformError

Job = TypeVar("Job")
Work = Callable[[Job, Callable[[float], None]], None]
"""Does a job and tells the share that is done, 0..1."""

_LOOK_S = 0.2

_shares: Any = None
"""In a worker: the shares of all jobs, in memory that all processes see."""


def run_all(
    work: Work[Job], jobs: Sequence[Job], workers: int, show: Callable[[float], None]
) -> None:
    """Do all jobs, in this process if one worker is enough.

    Args:
        work: A function of a module.
        jobs: What to do.
        workers: Processes at most.
        show: Told the mean share of all jobs.

    Raises:
        PlatformError: When a worker was killed.
        Exception: What a job raises; the other jobs are stopped.
    """
    if min(workers, len(jobs)) <= 1:
        for k, job in enumerate(jobs):
            work(job, _part_of(show, k, len(jobs)))
        show(1.0)
        return
    context = multiprocessing.get_context("spawn")
    shares = context.Array("d", len(jobs), lock=False)
    before = set(multiprocessing.active_children())  # of the host; only ours are stopped
    pool = ProcessPoolExecutor(min(workers, len(jobs)), context, _begin, (shares,))
    try:
        futures = [pool.submit(_work, work, job, k) for k, job in enumerate(jobs)]
        _watch(futures, shares, show)
    except BrokenProcessPool as fault:
        raise PlatformError(
            "a worker process was killed, perhaps for want of memory; give the same command "
            "again to go on, with fewer --workers"
        ) from fault
    except BaseException:
        for process in multiprocessing.active_children():
            if process not in before:
                process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
    show(1.0)


def _watch(
    futures: Sequence["Future[None]"], shares: Sequence[float], show: Callable[[float], None]
) -> None:
    """Until all are done or one has failed."""
    while True:
        done, waiting = wait(futures, timeout=_LOOK_S, return_when=FIRST_EXCEPTION)
        for future in done:
            future.result()
        show(sum(shares) / len(shares))
        if not waiting:
            return


def _part_of(show: Callable[[float], None], k: int, count: int) -> Callable[[float], None]:
    return lambda share: show((k + share) / count)


def _begin(shares: object) -> None:
    """In a worker: interrupts are the parent's business."""
    global _shares
    _shares = shares
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _work(work: Work[Job], job: Job, k: int) -> None:
    def show(share: float) -> None:
        _shares[k] = share

    work(job, show)
    _shares[k] = 1.0
